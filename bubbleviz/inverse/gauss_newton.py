"""One frame: Gauss–Newton steps to the shape of the membrane and its contact pressure."""

from __future__ import annotations

import time
from copy import copy
from dataclasses import dataclass
from math import log

import numpy as np
from scipy import sparse

from bubbleviz.camera import IMAGE_ERRORS, UPPER_95, Measured, Misfit, RangeObserver, ShapeRanges
from bubbleviz.inverse.contact_problem import (
    ContactPressure,
    ContactProblem,
    Prior,
    Selection,
    significant_contact,
)
from bubbleviz.inverse.friction import contacts_seen_by_flow, friction_nuisances
from bubbleviz.inverse.measurements import (
    FlowResidual,
    FrameData,
    LinearisedFrame,
    Measurements,
    Noise,
    Nuisances,
)
from bubbleviz.inverse.plausibility import (
    IMPLAUSIBLE_MISFIT,
    IMPLAUSIBLE_SHARE,
    contradicts_measured_gas,
    gas_sigma,
)
from bubbleviz.inverse.resolution import sampled, universal_threshold
from bubbleviz.inverse.response import Bubble, Tangent
from bubbleviz.membrane import Gas, parts_with
from bubbleviz.result import FlowFit, Status, wrench_about

CONVERGED_MOTION, TANGENT_REUSE, LARGE_MOTION = 0.05, 0.2, 0.5
"""Motions of the nodes over the mesh edge. A frame has converged when a step moves it by less than
`CONVERGED_MOTION`, or the first step from a warm start by less than `TANGENT_REUSE`; a step is
large beyond `LARGE_MOTION`. A tangent is used again within `TANGENT_REUSE` of the shape that it was
computed at: the residual is always exact."""
_SETTLED_MOTION, _MAX_SETTLING = 0.02, 2
"""Steps are repeated until one moves the nodes by less than this, at most `_MAX_SETTLING` more once
below `CONVERGED_MOTION`, as they do not always shrink. On the real press the area of a frame then
differs by 3 instead of 7 % between ways of reaching it (nine of ten cases)."""
_MAX_STEPS, _MAX_LARGE_STEPS = 16, 8
"""Gauss–Newton steps of a frame, and how many of them may be large without being cut off at
`_MAX_STEP`: a frame that has not converged by then contradicts the model."""
_MAX_STALLED, _STALLED_SHARE = 3, 0.72
"""Consecutive large steps that leave more than this share of the smallest χ² so far, after which a
frame counts as failed. Steps of the largest length towards a contact reduce χ² more than this. Of
the converged frames of the real press, of rubber dragged and twisted by another solver, and of
presses of six objects, one (a plane 29 mm deep across a dome) had two such steps in a row, all
others one at most. A plate that presses 40 of 50 mm into a dome is refused by this. Images of no
membrane took up to 15 such steps, of 0.3 s each."""
_MAX_SELECTIONS, _SELECTION_ROUNDS = 2, 6
"""Selections of the support at a converged shape, and how often each may add nodes with a negative
gradient."""
MINIMUM_BLOCKS = 3
"""Blocks that a plane needs: with fewer, a dent cannot be distinguished from a shift of the
sensor."""
_MAX_EXCHANGE_NODES = 300
"""Most nodes of a contact whose support is optimised by its evidence: an exchange of one node costs
the square of their number, and the edge of a larger contact is a small part of it. Chosen."""
_MAX_STEP = 2.0
"""Longest step in mesh edges."""
MODEL_ERROR = 0.02
"""Relative standard deviation of the force due to mesh, material law and friction model. Chosen on
balls and pucks that stick to a membrane of another mesh and are dragged and twisted: forces are
off by 1.8 % in the median of 42 frames, by up to 9 % where a puck is twisted by 15° and dragged at
once; of frictionless presses by 1.4 % at most."""
IMAGE_ERROR = 1e-3
"""Standard deviation of the errors of a whole depth image over the depth: 0.1 mm at 100 mm; scaled
by the noise factor of a frame. Chosen on rubber dragged by another solver, whose
images have no such errors: with 1e-2 an offset and an opposite scale imitate a change of gas
pressure, and forces are 4 to 8 % off; with 1e-3 or less they are within 1 %. The prior is weak
against thousands of blocks: an offset of 1 mm is still found."""
_MIN_CONTACT_FREE = 0.5
"""Least share of the image outside the contact for errors of the whole image to be fitted: they
should mostly be determined by the contact-free membrane. Chosen."""
_NOISE_RATIO, _MAX_NOISES = 1.1, 8
"""Ratio of successive noise factors on the grid of those that frames are solved with, and how many
are tried in a frame. Without a grid, the result would depend on the first one. Half a step is about
a standard deviation: an image of correlated noise is worth some 650 samples, which determine it to
5 %. Factors below 1 are less certain, and their ratio is `UPPER_95`."""
_FLOW_RATIO = 1.3
"""The same for optical flow: by its two components in some forty squares, its noise factor is
determined to 14 %."""


_AS_EXPECTED = Noise(1.0)


@dataclass(frozen=True)
class State:
    """Solution of a frame, and a warm start of the next.

    Attributes
    ----------
    x : (n, 3) array
        Shape, m.
    pressure : (n,) array
        p_c, Pa.
    support : (n,) bool array
        Nodes that may touch.
    gas : float
        p_v, Pa.
    friction : (n, 3) array
        Force of friction on the nodes, N.
    image_errors : (4,) array
        Amplitudes of `IMAGE_ERRORS`, m, m, m and 1.
    """

    x: np.ndarray
    pressure: np.ndarray
    support: np.ndarray
    gas: float
    friction: np.ndarray
    image_errors: np.ndarray


@dataclass(frozen=True)
class Start:
    """What `Estimator.estimate` hands from one frame to the next.

    Attributes
    ----------
    state : State or None
        None: the frame had no contact, or was not solved.
    tangent : Tangent or None
        Last tangent used.
    noise : Noise
        Noise factors of the frame, a first guess for the next one.
    view : ShapeRanges or None
        Camera model at the last shape at which it was computed.
    """

    state: State | None = None
    tangent: Tangent | None = None
    noise: Noise = _AS_EXPECTED
    view: ShapeRanges | None = None


@dataclass(frozen=True)
class Step:
    """A Gauss–Newton step.

    Attributes
    ----------
    state : State
        State after it.
    balanced : bool
        Whether that is an equilibrium.
    motion : (n, 3) array
        m.
    normal_motion_m : float
        Largest motion of a node along the membrane's normals: a depth image does not show motion
        along the membrane.
    contact : ContactPressure
    tangent : Tangent
        Of the step.
    last_tangent : Tangent
        The last one computed, which may be nearer to the new shape.
    measurements : Measurements
    residual_m : (k,) array
        Errors of the ranges after it, to first order.
    solve_ms : float
    """

    state: State
    balanced: bool
    motion: np.ndarray
    normal_motion_m: float
    contact: ContactPressure
    tangent: Tangent
    last_tangent: Tangent
    measurements: Measurements
    residual_m: np.ndarray
    solve_ms: float

    @property
    def image_error_m(self) -> np.ndarray:
        """Range errors (k,) due to those of the whole image; 0 where these were not fitted."""
        return self.measurements.nuisances.error(self.contact.amplitudes)

    @property
    def motion_m(self) -> float:
        """Largest motion of a node along an axis."""
        return float(np.abs(self.motion).max())


@dataclass(frozen=True)
class SolvedFrame:
    """A solved frame.

    Attributes
    ----------
    step : Step
        The last one.
    view : ShapeRanges
        Camera model at the last shape at which it was computed.
    noise : float
        Noise factor: σ of the residual over that of the camera's noise.
    misfit : Misfit
    contradicts_gas : bool
        Whether its shape contradicts the measured p_v.
    contact : (n,) bool array
        Nodes under significant contact pressure, see `significant_contact`.
    wrench_covariance : (6, 6) array
        Of its force, N, and its torque about the origin of B, N·m.
    visible_share : float
        Share of the contact area visible to the camera; NaN without contact.
    flow : FlowFit or None
        None where flow saw no contact.
    solve_ms : float
        Of all steps.
    """

    step: Step
    view: ShapeRanges
    noise: Noise
    misfit: Misfit
    contradicts_gas: bool
    contact: np.ndarray
    wrench_covariance: np.ndarray
    visible_share: float
    flow: FlowFit | None
    solve_ms: float


class GaussNewton:
    """Solver of single frames, from a warm start or from rest.

    Parameters
    ----------
    observer : RangeObserver
    bubble : Bubble
    smoothness : (n, n) sparse array
        λ L of the H1 term.
    length_m : float
        Size of the membrane, m: ranges with larger errors are not of it.
    friction : float
        Standard deviation of the amplitudes of `friction_nuisances`; 0 for none.
    image_error : float
        Standard deviation of the errors of a whole image, see `IMAGE_ERROR`; 0 for none.

    Attributes
    ----------
    weight_density : float
        Weight of all ranges at rest over the membrane's area, 1/m⁴.
    """

    def __init__(
        self,
        observer: RangeObserver,
        bubble: Bubble,
        smoothness: sparse.csr_array,
        length_m: float,
        friction: float,
        image_error: float,
    ) -> None:
        self.mesh, self.observer, self.bubble = observer.mesh, observer, bubble
        self._smoothness, self._length_m, self._friction = smoothness, length_m, friction
        depth = float(observer.image_errors[:, 3].mean() / observer.image_errors[:, 0].mean())
        self._image_sigma = image_error * np.array([depth, depth, depth, 1.0])
        edge = self.mesh.edge_length
        self._converged_m, self._reuse_m = CONVERGED_MOTION * edge, TANGENT_REUSE * edge
        self._settled_m = _SETTLED_MOTION * edge
        self._large_m, self._max_step_m = LARGE_MOTION * edge, _MAX_STEP * edge
        rest = self.mesh.nodes
        nothing = np.zeros(len(rest))
        self._rest = State(
            rest, nothing, nothing > 0.0, 0.0, np.zeros_like(rest), np.zeros_like(self._image_sigma)
        )
        self._rest_tangent = {
            measured: bubble.linearised(rest, nothing, None if not measured else 0.0)
            for measured in (False, True)
        }
        self._view_at_rest = observer.around(rest)
        self._detection_at_rest()

    def with_gas(self, gas: Gas) -> GaussNewton:
        """The same solver for a gas pressure measured with another error."""
        other = copy(self)
        other.bubble = self.bubble.with_gas(gas)
        return other

    def _detection_at_rest(self) -> None:
        """τ of the L1 term, from the precision of the camera at rest."""
        mesh, view = self.mesh, self._view_at_rest
        weight = self.observer.observe_everything().weight[view.block]
        n = len(mesh.free)
        sample = mesh.free[sampled(n)]
        D = sparse.diags_array(np.sqrt(weight)) @ view.jacobian
        sigma = np.linalg.norm(D @ self._rest_tangent[False].responses(sample), axis=0)
        self._tau = universal_threshold(sigma / mesh.areas[sample], n) * mesh.areas
        self._weight = float(weight.sum())
        self.weight_density = float(weight.sum() / mesh.facet_areas.sum())

    def solve(self, data: FrameData, start: Start) -> SolvedFrame | Status:
        """Estimate shape and contact pressure of a frame by Gauss–Newton steps.

        1. Observe: model the image at the present shape and linearise the model there. Restart
           from rest if the rest shape fits the image better than the warm start does; give up if
           the image cannot be of this membrane, if the shape leaves its surroundings (`length_m`),
           or if large steps hardly reduce the misfit.
        2. Step: solve for contact pressure and nuisances, on a support that is selected anew as
           long as steps are large, and after a first guess of the noise factor. After a small step
           the support is kept, as the solution could alternate between two supports for ever.
           Errors of the whole image are fitted only near the solution, where they cannot explain
           errors of the linearisation. Optical flow counts only there, and only with a contact: no
           unknown but friction explains motion along the membrane.
        3. Once the shape has converged, select the support again, until it is complete.
        4. Update the noise factor, by which the image is weighted, from the residual of each step
           to an equilibrium; repeat from 1 until noise and solution agree, so that the result does
           not depend on the frames before. Whether there is contact is decided with at least the
           noise of the sensor. Without a warm start the first step to an equilibrium gives a first
           guess of the factor, unless it contradicts a measured gas pressure; until then, only the
           nodes with the steepest gradient are selected.

        Parameters
        ----------
        data : FrameData
        start : Start

        Raises
        ------
        RuntimeError, LinAlgError
            A singular tangent, or Hessian.
        """
        state, warm = start.state or self._rest, start.state is not None
        view, tangent = start.view, start.tangent
        noise = start.noise if data.flow is not None else start.noise._replace(flow=0.0)
        noises: list[Noise] = []  # factors solved with; inf: only used for a first guess
        selecting, selections, large_steps, steps, solve_ms = True, 0, 0, 0, 0.0
        following = self._observe(data, state, view, by_flow=True) if warm else None
        near = warm
        image_shows_rest = following is None or self._shows_rest(following, state.pressure)
        best_misfit, stalled, settling, large = np.inf, 0, 0, False
        while steps < _MAX_STEPS and stalled < _MAX_STALLED:
            steps += 1
            by_flow = near and bool(state.pressure.any())
            observed = following or self._observe(data, state, view, by_flow=by_flow)
            following = None
            if observed.flow is not None and not noise.flow:
                # Friction has not explained any of it yet: steps with too small a factor diverge.
                factor = observed.flow.noise_factor(np.zeros_like(state.x))
                noise = noise._replace(flow=_on_noise_grid(factor, _FLOW_RATIO))
            misfit = observed.misfit(observed.error_m)
            poor = large and misfit >= _STALLED_SHARE * best_misfit
            stalled = stalled + 1 if poor else 0
            best_misfit = min(best_misfit, misfit)
            if np.abs(state.x - self.mesh.nodes).max() > self._length_m:
                break
            first_warm = warm and steps == 1 and not noises
            if first_warm and self._restarts_from_rest(data, observed, noise.ranges):
                return self.solve(data, Start())
            if failure := self._reject_image(observed, state):
                return failure
            no_contact = state is self._rest and self._fits_without_contact(observed, data.gas_pa)
            near = near or no_contact
            noise_known = warm or bool(noises)
            rounds = _SELECTION_ROUNDS if noise_known else 1
            if no_contact or not selecting:
                rounds = 0
            fit_image = near and image_shows_rest
            step = self._step(tangent, state, observed, data.gas_pa, noise, rounds, fit_image)
            if step is None:
                break
            state, view, tangent = step.state, observed.view, step.last_tangent
            solve_ms += step.solve_ms
            large = step.motion_m > self._large_m
            large_steps += selecting and large and step.motion_m < 0.9 * self._max_step_m
            converged = near and step.balanced and step.normal_motion_m <= self._converged_m
            settling = settling + 1 if converged else 0
            settled = step.normal_motion_m <= self._settled_m or settling > _MAX_SETTLING
            converged = converged and settled
            near = near or not large
            if near:
                pressure = step.contact.pressure
                image_shows_rest = image_shows_rest and self._shows_rest(observed, pressure)
            small = self._settled_m < step.normal_motion_m <= self._reuse_m
            if first_warm and step.balanced and small:
                following = self._observe(data, state, view, by_flow=True)
                converged = self._was_linear(step, observed, following)
            converged = converged and fit_image == (near and image_shows_rest)
            if data.flow is not None and observed.flow is None:
                converged = converged and not step.contact.pressure.any()
            done = converged and (
                (selecting and step.contact.complete) or selections > _MAX_SELECTIONS
            )
            first_guess = (
                step.balanced and not noise_known and not self._contradicts(state.gas, data.gas_pa)
            )
            searched = rounds > 0 or no_contact or step.contact.pressure.any()
            known = step.balanced and noise_known and not large and searched
            if done or first_guess or known:
                updated = self._updated_noise(step, observed, noise, image_shows_rest)
                if done and _noise_converged(updated, noise, noises, int(warm)):
                    last = (following or observed).view
                    return self._result(step, observed, last, data.gas_pa, noise, solve_ms)
                if done or first_guess:
                    noises.append(noise if done else Noise(np.inf, np.inf))
                    selections, steps, stalled, settling = 0, 0, 0, 0
                noise = updated
            if converged:
                selecting, selections, settling = True, selections + 1, 0
            elif large_steps == _MAX_LARGE_STEPS:
                break
            else:
                selecting = large or first_guess
        implausible = stalled == _MAX_STALLED or noise.ranges > IMPLAUSIBLE_MISFIT
        return "implausible" if implausible else "not_converged"

    def _observe(
        self, data: FrameData, state: State, last: ShapeRanges | None, by_flow: bool = False
    ) -> LinearisedFrame:
        """Camera model and residual at a state, with those of the optical flow or without.

        `last` is a model at a shape nearby.
        """
        at_rest = state is self._rest
        view = self._view_at_rest if at_rest else self.observer.around(state.x, last)
        expected = view.model_m + self.observer.image_errors @ state.image_errors
        observation = self.observer.weigh(data.ranges, expected)
        error = observation.residual_m[view.block] - view.model_m[view.block]
        errors_m = self.observer.image_errors[view.block]
        used = data.flow if by_flow else None
        flow = None if used is None else FlowResidual.at(state.x, used)
        return LinearisedFrame(view, observation, error, errors_m, self._image_sigma, flow)

    def _shows_rest(self, observed: LinearisedFrame, pressure: np.ndarray) -> bool:
        """Whether enough of the image is outside the contact to fit errors of the whole image."""
        outside = np.count_nonzero(observed.weight) - _contact_blocks(observed, pressure)
        return bool(outside >= _MIN_CONTACT_FREE * len(self._view_at_rest.block))

    def _reject_image(self, observed: LinearisedFrame, state: State) -> Status | None:
        """Failure if the image does not fit the membrane, or None."""
        seen = observed.weight > 0.0
        if np.count_nonzero(seen) < MINIMUM_BLOCKS:
            return "no_data"
        error = observed.error_m[seen]
        # Contact only pushes inwards: a surface far outside the membrane at rest is not of it.
        outside = state is self._rest and np.sqrt(np.mean(np.maximum(error, 0.0) ** 2))
        if (
            outside > IMPLAUSIBLE_SHARE * self._length_m
            or np.median(np.abs(error)) > self._length_m
        ):
            return "implausible"
        return None

    def _restarts_from_rest(self, data: FrameData, observed: LinearisedFrame, noise: float) -> bool:
        """Whether a frame should be solved from rest instead of its warm start."""
        # With a noise factor below 1 a contact could persist that the sensor's own noise explains.
        at_rest = self._observe(data, self._rest, None) if noise < 1.0 else None
        if at_rest and self._fits_without_contact(at_rest, data.gas_pa):
            return True
        return observed.fits_rest_better(observed.error_m)

    def is_untouched(self, measured: Measured) -> bool:
        """Whether an image alone, without a gas pressure, is explained without contact."""
        observed = self._observe(FrameData(measured), self._rest, None)
        if self._reject_image(observed, self._rest):
            return False
        fits = self._fits_without_contact(observed, None)
        step = self._step(None, self._rest, observed, None, _AS_EXPECTED, int(not fits), fits)
        if step is None or not step.balanced:
            return False
        shows_rest = self._shows_rest(observed, step.contact.pressure)
        noise = self._updated_noise(step, observed, _AS_EXPECTED, shows_rest).ranges
        untouched = fits or self._fits_without_contact(observed, None, noise)
        return untouched and noise <= IMPLAUSIBLE_MISFIT

    def _fits_without_contact(
        self, at_rest: LinearisedFrame, gas: float | None, noise: float = 1.0
    ) -> bool:
        """Whether a depth image of the membrane at rest is explained without contact."""
        tangent = self._rest_tangent[gas is not None]
        measurements = self._measurements(tangent, self._rest, at_rest, gas, Noise(noise))
        return self._problem(tangent, measurements, self._rest, gas).zero_is_optimal()

    def _updated_noise(
        self, step: Step, observed: LinearisedFrame, noise: Noise, fit_image: bool
    ) -> Noise:
        """Noise factors by the residual of a step that assumed the factors `noise`."""
        touching = bool(step.contact.pressure.any())
        if step.contact.pivots and not touching:
            return noise  # no contact was found: the residual still has what it would explain
        left = observed.without_image_errors(step.residual_m) if fit_image else step.residual_m
        factor = self.observer.noise_factor(observed.observation, observed.view.block, left)
        by_ranges = _on_noise_grid(factor) if touching else max(_on_noise_grid(factor), 1.0)
        by_flow = noise.flow
        if observed.flow is not None:
            by_flow = _on_noise_grid(observed.flow.noise_factor(step.motion), _FLOW_RATIO)
        return Noise(by_ranges, by_flow)

    def _result(
        self,
        step: Step,
        observed: LinearisedFrame,
        last: ShapeRanges,
        gas: float | None,
        noise: Noise,
        solve_ms: float,
    ) -> SolvedFrame | Status:
        pressure = step.contact.pressure
        if _contact_blocks(observed, pressure) < np.count_nonzero(pressure):
            return "no_data"
        touching = pressure.any()
        if touching and observed.fits_rest_better(step.residual_m + step.image_error_m):
            return "implausible"  # contact does not improve the fit
        if not touching and noise.ranges > IMPLAUSIBLE_MISFIT:
            return "implausible"  # nor does the membrane at rest fit
        misfit = self.observer.misfit(observed.observation, observed.view.block, step.residual_m)
        contradicts = self._contradicts(step.state.gas, gas)
        contact = significant_contact(self.mesh, step.contact)
        covariance = self._wrench_covariance(step, observed, contact)
        share = self._visible_share(observed, contact)
        flow = self._flow_fit(step, observed, noise)
        return SolvedFrame(
            step, last, noise, misfit, contradicts, contact, covariance, share, flow, solve_ms
        )

    def _flow_fit(self, step: Step, observed: LinearisedFrame, noise: Noise) -> FlowFit | None:
        """How well the optical flow is fitted; None where it saw no contact."""
        contact, flow = step.contact, observed.flow
        seen = contacts_seen_by_flow(contact.pressure, self.mesh.rings, observed.seen_by_flow)
        if flow is None or not seen.any():
            return None
        rms_px = float(np.sqrt(np.mean(flow.after(step.motion) ** 2)))
        own = step.measurements.nuisances.motions[contact.nodes]
        pushed = step.tangent.responses(contact.nodes).reshape(len(seen), 3, -1)[contact.nodes]
        motions = np.concatenate([-pushed, own], axis=2).reshape(3 * len(own), -1)
        covariance = contact.covariance[: motions.shape[1], : motions.shape[1]]
        variance = np.einsum("ij,jk,ik->i", motions, covariance, motions, optimize=True)
        return FlowFit(rms_px, noise.flow, float(np.sqrt(variance.mean())))

    def _visible_share(self, observed: LinearisedFrame, contact: np.ndarray) -> float:
        """Share of the area of nodes (n,) bool whose facets are visible."""
        jacobian, visible = observed.view.jacobian, np.zeros(len(contact), bool)
        weighed = np.repeat(observed.weight > 0.0, np.diff(jacobian.indptr))
        visible[jacobian.indices[weighed] // 3] = True
        area = self.mesh.areas * contact
        return float(area @ visible / area.sum()) if contact.any() else np.nan

    # -- one step -------------------------------------------------------------------------------

    def _step(
        self,
        last: Tangent | None,
        state: State,
        observed: LinearisedFrame,
        gas: float | None,
        noise: Noise,
        rounds: int,
        fit_image: bool,
    ) -> Step | None:
        """A step from a state, or None if its problem was not solved.

        Its support is selected in so many rounds; errors of the whole image are fitted or zero.
        """
        tangent = self._tangent_at(state, gas, last)
        measurements = self._measurements(tangent, state, observed, gas, noise, fit_image)
        began = time.perf_counter()
        contact = self._contact(tangent, measurements, state, gas, rounds)
        solve_ms = 1e3 * (time.perf_counter() - began)
        if not contact.converged:
            return None
        after, balanced, last = self._advance(tangent, state, measurements.nuisances, contact, gas)
        motion = after.x - state.x
        residual = observed.error_m - observed.view.jacobian @ motion.ravel()
        residual -= measurements.nuisances.error(contact.amplitudes)
        size = np.maximum(np.linalg.norm(tangent.area_vectors, axis=1), np.finfo(float).tiny)
        along = np.einsum("ij,ij->i", motion, tangent.area_vectors) / size
        return Step(
            after,
            balanced,
            motion,
            float(np.abs(along).max()),
            contact,
            tangent,
            last,
            measurements,
            residual,
            solve_ms,
        )

    def _measurements(
        self,
        tangent: Tangent,
        state: State,
        observed: LinearisedFrame,
        gas: float | None,
        noise: Noise,
        fit_image: bool = True,
    ) -> Measurements:
        """Residual and weights of a frame with noise factors, and its nuisances."""
        # A noise factor above 1 is partly an error of the model: the priors of gas pressure and
        # image errors are widened by it, too, or they would pull the shape away from the image.
        doubt = max(noise.ranges, 1.0)
        moving = [Nuisances.none(len(state.x))]
        if gas is not None:
            sigma = np.array([doubt * gas_sigma(self.bubble.gas, gas)])
            bulge = tangent.bulge[:, :, None]
            moving.append(Nuisances.of_motions(bulge, np.zeros_like(bulge), sigma))
        if self._friction > 0.0 and state.pressure.any():
            moving += friction_nuisances(
                tangent,
                state.pressure,
                self._friction,
                self.mesh.rings,
                self._smoothness,
                observed.seen_by_flow,
            )
        return observed.measurements(noise, moving, fit_image * doubt)

    def threshold(self, measurements: Measurements) -> np.ndarray:
        """τ of the L1 term (n,) for an image's weights, 1/Pa."""
        return self._tau * np.sqrt(measurements.weight.sum() / self._weight)

    def _problem(
        self, tangent: Tangent, measurements: Measurements, state: State, gas: float | None
    ) -> ContactProblem:
        prior = Prior(self._smoothness, self.threshold(measurements), self.mesh.rings)
        relaxing = self._relaxation(tangent, state, gas)
        return ContactProblem(tangent, measurements, prior, state.pressure, relaxing)

    def _contact(
        self,
        tangent: Tangent,
        measurements: Measurements,
        state: State,
        gas: float | None,
        rounds: int,
    ) -> ContactPressure:
        problem = self._problem(tangent, measurements, state, gas)
        selection = Selection(state.support)
        if rounds and (state.pressure.any() or not problem.zero_is_optimal()):
            selection = problem.select(state.support, rounds)
        change = self.bubble.gas_at(state.x)[0] if gas is None else gas
        if self.bubble.gas.zero_sigma_pa:  # the measured one may be far off: use the estimate
            change = state.gas
        least = self.bubble.held_pressure_pa + change

        def touches(support: np.ndarray, pressure: np.ndarray) -> np.ndarray:
            return parts_with(self.mesh.rings, pressure >= least, support)

        if rounds and 0 < np.count_nonzero(selection.support) <= _MAX_EXCHANGE_NODES:
            selection = problem.max_evidence(selection)
        return problem.solve_debiased(selection, touches)

    def _relaxation(self, tangent: Tangent, state: State, gas: float | None) -> np.ndarray:
        """Motion (n, 3) to equilibrium under the pressure of a state, to first order."""
        if state is self._rest:  # in equilibrium except for a measured gas pressure
            return np.zeros_like(state.x) if gas is None else gas * tangent.bulge
        return tangent.motion(-self.bubble.residual(state.x, state.pressure, gas))

    def _advance(
        self,
        tangent: Tangent,
        state: State,
        nuisances: Nuisances,
        contact: ContactPressure,
        gas: float | None,
    ) -> tuple[State, bool, Tangent]:
        """State after a step, whether it is an equilibrium, and the last tangent computed.

        The shape is moved on to equilibrium under its new pressure where there is one nearby. There
        need not be one under a part of a pressure (the object prescribes positions, not pressures);
        the shape is then the linearised one, and the next step balances it.
        """
        share = min(1.0, self._max_step_m / max(float(np.abs(contact.motion).max()), 1e-300))
        pressure = state.pressure + share * (contact.pressure - state.pressure)
        linear, inside = state.x + share * contact.motion, gas
        if gas is not None:
            inside = state.gas + share * (gas + float(contact.amplitudes[0]) - state.gas)
        friction = nuisances.force(contact.amplitudes)
        x, balanced = linear, state is self._rest and not contact.motion.any()
        if share == 1.0 and not balanced:
            x, balanced, tangent = self.bubble.equilibrium(
                tangent, linear, pressure, inside, friction
            )
            balanced = balanced and float(np.abs(x - linear).max()) <= self._large_m
        if not balanced:
            x = linear
        if inside is None:
            inside = self.bubble.gas_at(x)[0]
        image_errors = contact.amplitudes[-len(IMAGE_ERRORS) :]
        after = State(x, pressure, contact.support, inside, friction, image_errors)
        return after, balanced, tangent

    def _tangent_at(self, state: State, gas: float | None, last: Tangent | None) -> Tangent:
        """Tangent near a state: the last one where it is near enough."""
        measured = gas is not None
        if state is self._rest:
            return self._rest_tangent[measured]
        if (
            last is not None
            and last.with_gas is not measured
            and float(np.abs(state.x - last.x).max()) <= self._reuse_m
        ):
            return last
        return self.bubble.linearised(state.x, state.pressure, state.gas if measured else None)

    def _contradicts(self, shape_pa: float, measured_pa: float | None) -> bool:
        """Whether p_v of the shape contradicts the measured one, if any."""
        gas, gauge = self.bubble.gas, self.bubble.held_pressure_pa
        return measured_pa is not None and contradicts_measured_gas(
            shape_pa, measured_pa, gas, gauge
        )

    def _was_linear(
        self, step: Step, observed: LinearisedFrame, following: LinearisedFrame
    ) -> bool:
        """Whether the error of a step's linearisation changes its force by less than noise does."""
        touching = step.contact.pressure > 0.0
        if not touching.any():
            return True
        exact = np.full(self.observer.blocks, np.nan)
        exact[following.view.block] = following.error_m
        linear = step.residual_m + step.image_error_m
        beyond = np.nan_to_num(exact[observed.view.block] - linear)
        nodes = step.contact.nodes
        force = self._unit_wrenches(step, touching, nodes)[:, :3]
        if observed.flow is not None and following.flow is not None:
            beyond_flow = following.flow.error_px - observed.flow.after(step.motion)
            beyond = np.concatenate([beyond, beyond_flow])
        change = self._change(step, beyond) @ force
        variance = np.diag(step.contact.problem.covariance_of(nodes, force))
        return bool((change**2 <= variance).all())

    def _wrench_covariance(
        self, step: Step, observed: LinearisedFrame, contact: np.ndarray
    ) -> np.ndarray:
        """Covariance (6, 6) of the wrench due to noise, nuisances, material and model.

        The support is uncertain by one node: its neighbours may touch, too.
        """
        if not contact.any():
            return np.zeros((6, 6))
        nodes, problem = step.contact.nodes, step.contact.problem
        unit = self._unit_wrenches(step, contact, nodes)
        by_material = [
            self._change(step, step.measurements.jacobian @ motion) @ unit
            for motion in step.tangent.by_material.T
        ]
        unknowns = np.concatenate([step.contact.pressure[nodes], step.contact.amplitudes])
        push = np.where(contact, step.contact.pressure, 0.0)[:, None]
        push = push * self.bubble.area_vectors(step.state.x)
        unseen = ~contacts_seen_by_flow(
            step.contact.pressure, self.mesh.rings, observed.seen_by_flow
        )
        model = _model_covariance(step.state.x, push, unknowns @ unit, self._friction * unseen)
        around = np.flatnonzero(problem.with_neighbours(step.contact.pressure > 0.0))
        unit = self._unit_wrenches(step, problem.with_neighbours(contact), around)
        covariance = model + problem.covariance_of(around, unit)
        for change in by_material:
            covariance += np.outer(change, change)
        return covariance

    def _change(self, step: Step, measured: np.ndarray) -> np.ndarray:
        """Change of pressures and amplitudes (s + a,) for a change of the measurements (k,)."""
        contact, count = step.contact, len(step.contact.nodes)
        gradient = contact.problem.misfit_gradient(contact.nodes, measured)
        change: np.ndarray = -contact.covariance[:, :count] @ gradient
        change[count:] += step.measurements.amplitudes(measured)
        return change

    def _unit_wrenches(self, step: Step, counted: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """Force, and torque about the origin of B, on the nodes `counted` (n,) bool, (s + a, 6).

        For unit pressures of nodes (s,) and unit amplitudes.
        """
        x, push = step.state.x, -self.bubble.area_vectors(step.state.x) * counted[:, None]
        nuisances = step.measurements.nuisances
        loads, at = nuisances.forces[counted].swapaxes(1, 2), x[counted][:, None]
        by_pressures = np.hstack([push[nodes], np.cross(x[nodes], push[nodes])])
        by_amplitudes = np.hstack([loads.sum(axis=0), np.cross(at, loads).sum(axis=0)])
        of_image = np.zeros((nuisances.errors.shape[1], 6))  # errors of it are no forces
        return np.concatenate([by_pressures, by_amplitudes, of_image])


def _model_covariance(
    x: np.ndarray, push: np.ndarray, wrench: np.ndarray, friction: np.ndarray
) -> np.ndarray:
    """Covariance (6, 6) of a wrench (6,) by errors of the model.

    Those of the force act at the centre of the normal forces `push` (n, 3) on nodes at `x` (n, 3),
    in every direction alike; so do those of the torque about it. The torque about the mean normal
    hardly changes the shape, and what the fit finds of it depends on how friction is distributed:
    for objects that stick it is off by as much as the prior of friction allows.
    """
    load = np.linalg.norm(push, axis=1)
    center, normal = load @ x / load.sum(), push.sum(axis=0) / np.linalg.norm(push.sum(axis=0))
    arm = np.linalg.norm(np.cross(x - center, normal), axis=1)
    unknown = friction * load
    spin = np.sqrt((unknown @ arm**2) * unknown.sum())
    size = np.linalg.norm((wrench_about(center) @ wrench).reshape(2, 3), axis=1)
    sigma = np.column_stack([np.diag(MODEL_ERROR * np.repeat(size, 3)), np.zeros(6)])
    sigma[3:, 6] = spin * normal
    back = wrench_about(-center) @ sigma
    return back @ back.T


def _contact_blocks(observed: LinearisedFrame, pressure: np.ndarray) -> int:
    """Number of blocks of pixels that see a facet with a node under pressure (n,)."""
    jacobian = observed.view.jacobian
    touched = (pressure > 0.0)[jacobian.indices // 3]
    row = np.repeat(np.arange(jacobian.shape[0]), np.diff(jacobian.indptr))
    sees = np.bincount(row[touched], minlength=jacobian.shape[0]) > 0
    return int(np.count_nonzero(sees & (observed.weight > 0.0)))


def _noise_converged(updated: Noise, noise: Noise, earlier: list[Noise], apart: int) -> bool:
    """Whether the noise factors have converged that a frame was solved with.

    They may be so many steps of the grid apart.
    """
    by_kind = zip(updated, noise, zip(*earlier, strict=True) if earlier else ((), ()), strict=True)
    same = (
        _factor_converged(now, before, list(others), ratio, apart)
        for (now, before, others), ratio in zip(by_kind, (_NOISE_RATIO, _FLOW_RATIO), strict=True)
    )
    return len(earlier) + 1 >= _MAX_NOISES or all(same)


def _factor_converged(
    updated: float, noise: float, earlier: list[float], ratio: float, apart: int
) -> bool:
    """Whether a noise factor has converged.

    Neighbours on the grid count as equal where a frame follows another one: their ratio is two
    standard deviations. From rest they do not, as the support that is selected with the first guess
    may be worse: forces of the real press that are reached in other ways then differ by up to 0.8
    instead of 2.3 % in 95 of 100 cases. Two factors further apart can alternate for ever, each with
    its own support: the larger one is taken.
    """
    near = min(updated, noise) >= 1.0 and abs(_grid_index(updated / noise, ratio)) <= apart
    alternating = updated < noise and updated in earlier
    return updated == noise or near or alternating


def _grid_index(noise: float, ratio: float) -> int:
    """Nearest power of a ratio to a noise factor."""
    return round(log(noise) / log(ratio))


def _on_noise_grid(noise: float, ratio: float = _NOISE_RATIO) -> float:
    """Nearest noise factor on the grid."""
    step = ratio if noise >= 1.0 else UPPER_95
    return float(step ** _grid_index(noise, step))
