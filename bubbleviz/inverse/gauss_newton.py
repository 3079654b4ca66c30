"""One frame: Gauss–Newton steps to the shape of the membrane and its contact pressure."""

from __future__ import annotations

import time
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from math import log

import numpy as np
from scipy import sparse

from bubbleviz.camera import (
    IMAGE_ERRORS,
    UPPER_95,
    Measured,
    Misfit,
    Observation,
    RangeObserver,
    ShapeRanges,
)
from bubbleviz.inverse.contact_problem import (
    ContactPressure,
    ContactProblem,
    Nuisances,
    Prior,
    Ranges,
    Selection,
    friction_loads,
    significant_contact,
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
from bubbleviz.result import Status, wrench_about

CONVERGED_MOTION, TANGENT_REUSE, LARGE_MOTION = 0.05, 0.2, 0.5
"""Motions of the nodes over the mesh edge. A frame has converged when a step moves it by less than
`CONVERGED_MOTION`, or the first step from a warm start by less than `TANGENT_REUSE`; a step is
large beyond `LARGE_MOTION`. A tangent is used again within `TANGENT_REUSE` of the shape that it was
computed at: the residual is always exact."""
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
    noise : float
        Noise factor of the frame, a first guess for the next one.
    final_state : State or None
        State after the last step, plausible or not: the traction estimator continues from it. None
        if there was no step.
    measured : Measured or None
        Measurements of this frame's image; None if it was not evaluated.
    view : ShapeRanges or None
        Camera model at the last shape at which it was computed.
    """

    state: State | None = None
    tangent: Tangent | None = None
    noise: float = 1.0
    final_state: State | None = None
    measured: Measured | None = None
    view: ShapeRanges | None = None


@dataclass(frozen=True)
class FailedFrame:
    """A frame that could not be solved.

    Attributes
    ----------
    status : Status
    final_state : State or None
        State after the last step.
    """

    status: Status
    final_state: State | None = None


@dataclass(frozen=True)
class _Linearisation:
    """Camera model linearised at a shape, and the residual of an image there.

    Attributes
    ----------
    view : ShapeRanges
    observation : Observation
    error_m : (k,) array
        Measured minus modelled ranges of the blocks in `view`.
    image : Nuisances
        Errors of the whole image.
    """

    view: ShapeRanges
    observation: Observation
    error_m: np.ndarray
    image: Nuisances

    @property
    def weight(self) -> np.ndarray:
        """1/σ² of the blocks in `view`, (k,), 1/m²."""
        return self.observation.weight[self.view.block]

    def misfit(self, error_m: np.ndarray) -> float:
        """χ² of errors (k,), minimised over the errors of the whole image."""
        return float(error_m @ self._by_image.weighed(error_m))

    def fits_rest_better(self, error_m: np.ndarray) -> bool:
        """Whether the membrane at rest has a smaller misfit than errors (k,)."""
        at_rest = self.observation.residual_m[self.view.block]
        return self.misfit(error_m) > self.misfit(at_rest)

    def without_image_errors(self, error_m: np.ndarray) -> np.ndarray:
        """Errors (k,) less the fitted errors of the whole image."""
        explained: np.ndarray = self.image.errors_m @ self._by_image.amplitudes(error_m)
        return error_m - explained

    @cached_property
    def _by_image(self) -> Ranges:
        return Ranges(self.view.jacobian, self.error_m, self.weight, self.image)


@dataclass(frozen=True)
class Step:
    """A Gauss–Newton step.

    Attributes
    ----------
    state : State
        State after it.
    balanced : bool
        Whether that is an equilibrium.
    motion_m, normal_motion_m : float
        Largest motion of a node along an axis, and along the membrane's normals: a depth image
        does not show motion along the membrane.
    contact : ContactPressure
    tangent : Tangent
        Of the step.
    last_tangent : Tangent
        The last one computed, which may be nearer to the new shape.
    ranges : Ranges
    residual_m : (k,) array
        Errors of the ranges after it, to first order.
    solve_ms : float
    """

    state: State
    balanced: bool
    motion_m: float
    normal_motion_m: float
    contact: ContactPressure
    tangent: Tangent
    last_tangent: Tangent
    ranges: Ranges
    residual_m: np.ndarray
    solve_ms: float

    @property
    def image_error_m(self) -> np.ndarray:
        """Range errors (k,) due to those of the whole image; 0 where these were not fitted."""
        errors: np.ndarray = self.ranges.nuisances.errors_m @ self.contact.amplitudes
        return errors


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
    solve_ms : float
        Of all steps.
    """

    step: Step
    view: ShapeRanges
    noise: float
    misfit: Misfit
    contradicts_gas: bool
    contact: np.ndarray
    wrench_covariance: np.ndarray
    visible_share: float
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
        Standard deviation of the amplitudes of `friction_loads`; 0 for none.
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

    def solve(
        self, measured: Measured, measured_gas: float | None, start: Start
    ) -> SolvedFrame | FailedFrame:
        """Estimate shape and contact pressure of a frame by Gauss–Newton steps.

        1. Observe: model the image at the present shape and linearise the model there. Restart
           from rest if the rest shape fits the image better than the warm start does; give up if
           the image cannot be of this membrane, if the shape leaves its surroundings (`length_m`),
           or if large steps hardly reduce the misfit.
        2. Step: solve for contact pressure and nuisances, on a support that is selected anew as
           long as steps are large, and after a first guess of the noise factor. After a small step
           the support is kept, as the solution could alternate between two supports for ever.
           Errors of the whole image are fitted only near the solution, where they cannot explain
           errors of the linearisation.
        3. Once the shape has converged, select the support again, until it is complete.
        4. Update the noise factor, by which the image is weighted, from the residual of each step
           to an equilibrium; repeat from 1 until noise and solution agree, so that the result does
           not depend on the frames before. Whether there is contact is decided with at least the
           noise of the sensor. Without a warm start the first step to an equilibrium gives a first
           guess of the factor, unless it contradicts a measured gas pressure; until then, only the
           nodes with the steepest gradient are selected.

        Parameters
        ----------
        measured : Measured
        measured_gas : float or None
            p_v, Pa; None: computed from the volume.
        start : Start

        Raises
        ------
        RuntimeError, LinAlgError
            A singular tangent, or Hessian.
        """
        state, warm = start.state or self._rest, start.state is not None
        view, tangent, noise = start.view, start.tangent, start.noise
        noises: list[float] = []  # factors solved with; inf: only used for a first guess
        selecting, selections, large_steps, steps, solve_ms = True, 0, 0, 0, 0.0
        following = self._observe(measured, state, view) if warm else None
        near = warm
        image_shows_rest = following is None or self._shows_rest(following, state.pressure)
        best_misfit, stalled, large = np.inf, 0, False
        while steps < _MAX_STEPS and stalled < _MAX_STALLED:
            steps += 1
            observed = following or self._observe(measured, state, view)
            following = None
            misfit = observed.misfit(observed.error_m)
            poor = large and misfit >= _STALLED_SHARE * best_misfit
            stalled = stalled + 1 if poor else 0
            best_misfit = min(best_misfit, misfit)
            if np.abs(state.x - self.mesh.nodes).max() > self._length_m:
                break
            first_warm = warm and steps == 1 and not noises
            if first_warm and self._restarts_from_rest(measured, measured_gas, observed, noise):
                return self.solve(measured, measured_gas, Start())
            if failure := self._reject_image(observed, state):
                return failure
            no_contact = state is self._rest and self._fits_without_contact(observed, measured_gas)
            near = near or no_contact
            noise_known = warm or bool(noises)
            rounds = _SELECTION_ROUNDS if noise_known else 1
            if no_contact or not selecting:
                rounds = 0
            fit_image = near and image_shows_rest
            step = self._step(tangent, state, observed, measured_gas, noise, rounds, fit_image)
            if step is None:
                break
            state, view, tangent = step.state, observed.view, step.last_tangent
            solve_ms += step.solve_ms
            large = step.motion_m > self._large_m
            large_steps += selecting and large and step.motion_m < 0.9 * self._max_step_m
            converged = near and step.balanced and step.normal_motion_m <= self._converged_m
            near = near or not large
            if near:
                pressure = step.contact.pressure
                image_shows_rest = image_shows_rest and self._shows_rest(observed, pressure)
            small = self._converged_m < step.normal_motion_m <= self._reuse_m
            if first_warm and step.balanced and small:
                following = self._observe(measured, state, view)
                converged = self._was_linear(step, observed, following)
            converged = converged and fit_image == (near and image_shows_rest)
            done = converged and (
                (selecting and step.contact.complete) or selections > _MAX_SELECTIONS
            )
            first_guess = (
                step.balanced and not noise_known and not self._contradicts(state.gas, measured_gas)
            )
            searched = rounds > 0 or no_contact or step.contact.pressure.any()
            known = step.balanced and noise_known and not large and searched
            if done or first_guess or known:
                updated = self._updated_noise(step, observed, noise, image_shows_rest)
                if done and _noise_converged(updated, noise, noises):
                    last = (following or observed).view
                    return self._result(step, observed, last, measured_gas, noise, solve_ms)
                if done or first_guess:
                    noises.append(noise if done else np.inf)
                    selections, steps, stalled = 0, 0, 0
                noise = updated
            if converged:
                selecting, selections = True, selections + 1
            elif large_steps == _MAX_LARGE_STEPS:
                break
            else:
                selecting = large or first_guess
        implausible = stalled == _MAX_STALLED or noise > IMPLAUSIBLE_MISFIT
        return FailedFrame("implausible" if implausible else "not_converged", state)

    def _observe(
        self, measured: Measured, state: State, last: ShapeRanges | None
    ) -> _Linearisation:
        """Camera model and residual at a state; `last` is a model at a shape nearby."""
        at_rest = state is self._rest
        view = self._view_at_rest if at_rest else self.observer.around(state.x, last)
        expected = view.model_m + self.observer.image_errors @ state.image_errors
        observation = self.observer.weigh(measured, expected)
        error = observation.residual_m[view.block] - view.model_m[view.block]
        errors_m = self.observer.image_errors[view.block]
        image = Nuisances.of_image(errors_m, self._image_sigma, len(state.x))
        return _Linearisation(view, observation, error, image)

    def _shows_rest(self, observed: _Linearisation, pressure: np.ndarray) -> bool:
        """Whether enough of the image is outside the contact to fit errors of the whole image."""
        outside = np.count_nonzero(observed.weight) - _contact_blocks(observed, pressure)
        return bool(outside >= _MIN_CONTACT_FREE * len(self._view_at_rest.block))

    def _reject_image(self, observed: _Linearisation, state: State) -> FailedFrame | None:
        """Failure if the image does not fit the membrane, or None."""
        seen = observed.weight > 0.0
        if np.count_nonzero(seen) < MINIMUM_BLOCKS:
            return FailedFrame("no_data")
        error = observed.error_m[seen]
        # Contact only pushes inwards: a surface far outside the membrane at rest is not of it.
        outside = state is self._rest and np.sqrt(np.mean(np.maximum(error, 0.0) ** 2))
        if (
            outside > IMPLAUSIBLE_SHARE * self._length_m
            or np.median(np.abs(error)) > self._length_m
        ):
            return FailedFrame("implausible", state)
        return None

    def _restarts_from_rest(
        self, measured: Measured, gas: float | None, observed: _Linearisation, noise: float
    ) -> bool:
        """Whether a frame should be solved from rest instead of its warm start."""
        # With a noise factor below 1 a contact could persist that the sensor's own noise explains.
        at_rest = self._observe(measured, self._rest, None) if noise < 1.0 else None
        if at_rest and self._fits_without_contact(at_rest, gas):
            return True
        return observed.fits_rest_better(observed.error_m)

    def is_untouched(self, measured: Measured) -> bool:
        """Whether an image alone, without a gas pressure, is explained without contact."""
        observed = self._observe(measured, self._rest, None)
        if self._reject_image(observed, self._rest):
            return False
        fits = self._fits_without_contact(observed, None)
        step = self._step(None, self._rest, observed, None, 1.0, int(not fits), fits)
        if step is None or not step.balanced:
            return False
        shows_rest = self._shows_rest(observed, step.contact.pressure)
        noise = self._updated_noise(step, observed, 1.0, shows_rest)
        untouched = fits or self._fits_without_contact(observed, None, noise)
        return untouched and noise <= IMPLAUSIBLE_MISFIT

    def _fits_without_contact(
        self, at_rest: _Linearisation, gas: float | None, noise: float = 1.0
    ) -> bool:
        """Whether an image of the membrane at rest is explained without contact."""
        tangent = self._rest_tangent[gas is not None]
        ranges = self._ranges(tangent, self._rest, at_rest, gas, noise)
        return self._problem(tangent, ranges, self._rest, gas).zero_is_optimal()

    def _updated_noise(
        self, step: Step, observed: _Linearisation, noise: float, fit_image: bool
    ) -> float:
        """Noise factor by the residual of a step that assumed the factor `noise`."""
        touching = bool(step.contact.pressure.any())
        if step.contact.pivots and not touching:
            return noise  # no contact was found: the residual still has what it would explain
        left = observed.without_image_errors(step.residual_m) if fit_image else step.residual_m
        factor = self.observer.noise_factor(observed.observation, observed.view.block, left)
        return _on_noise_grid(factor) if touching else max(_on_noise_grid(factor), 1.0)

    def _result(
        self,
        step: Step,
        observed: _Linearisation,
        last: ShapeRanges,
        gas: float | None,
        noise: float,
        solve_ms: float,
    ) -> SolvedFrame | FailedFrame:
        pressure = step.contact.pressure
        if _contact_blocks(observed, pressure) < np.count_nonzero(pressure):
            return FailedFrame("no_data", step.state)
        touching = pressure.any()
        if touching and observed.fits_rest_better(step.residual_m + step.image_error_m):
            return FailedFrame("implausible", step.state)  # contact does not improve the fit
        if not touching and noise > IMPLAUSIBLE_MISFIT:
            return FailedFrame("implausible", step.state)  # nor does the membrane at rest fit
        misfit = self.observer.misfit(observed.observation, observed.view.block, step.residual_m)
        contradicts = self._contradicts(step.state.gas, gas)
        contact = significant_contact(self.mesh, step.contact)
        covariance = self._wrench_covariance(step, contact)
        share = self._visible_share(observed, contact)
        return SolvedFrame(
            step, last, noise, misfit, contradicts, contact, covariance, share, solve_ms
        )

    def _visible_share(self, observed: _Linearisation, contact: np.ndarray) -> float:
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
        observed: _Linearisation,
        gas: float | None,
        noise: float,
        rounds: int,
        fit_image: bool,
    ) -> Step | None:
        """A step from a state, or None if its problem was not solved.

        Its support is selected in so many rounds; errors of the whole image are fitted or zero.
        """
        tangent = self._tangent_at(state, gas, last)
        ranges = self._ranges(tangent, state, observed, gas, noise, fit_image)
        began = time.perf_counter()
        contact = self._contact(tangent, ranges, state, gas, rounds)
        solve_ms = 1e3 * (time.perf_counter() - began)
        if not contact.converged:
            return None
        after, balanced, last = self._advance(tangent, state, ranges, contact, gas)
        motion = after.x - state.x
        residual = observed.error_m - observed.view.jacobian @ motion.ravel()
        residual -= ranges.nuisances.errors_m @ contact.amplitudes
        size = np.maximum(np.linalg.norm(tangent.area_vectors, axis=1), np.finfo(float).tiny)
        along = np.einsum("ij,ij->i", motion, tangent.area_vectors) / size
        most, normal = float(np.abs(motion).max()), float(np.abs(along).max())
        return Step(
            after, balanced, most, normal, contact, tangent, last, ranges, residual, solve_ms
        )

    def _ranges(
        self,
        tangent: Tangent,
        state: State,
        observed: _Linearisation,
        gas: float | None,
        noise: float = 1.0,
        fit_image: bool = True,
    ) -> Ranges:
        """Residual and weights of an image with a noise factor, and its nuisances."""
        weight = observed.weight / noise**2
        # A noise factor above 1 is partly an error of the model: the priors of gas pressure and
        # image errors are widened by it, too, or they would pull the shape away from the image.
        doubt = max(noise, 1.0)
        known = self._nuisances(tangent, state, len(weight), gas, doubt)
        image = replace(observed.image, sigma=fit_image * doubt * observed.image.sigma)
        nuisances = Nuisances.joined([*known, image])
        return Ranges(observed.view.jacobian, observed.error_m, weight, nuisances)

    def _nuisances(
        self, tangent: Tangent, state: State, ranges: int, gas: float | None, doubt: float
    ) -> list[Nuisances]:
        """Error of a measured gas pressure, and friction of the contacts of a state."""
        parts = []
        if gas is not None:
            sigma = np.array([doubt * gas_sigma(self.bubble.gas, gas)])
            bulge, no_force = tangent.bulge[:, :, None], np.zeros((*state.x.shape, 1))
            parts.append(Nuisances.of_motions(bulge, sigma, no_force, ranges))
        if self._friction > 0.0 and state.pressure.any():
            loads = friction_loads(tangent.x, tangent.area_vectors, state.pressure, self.mesh.rings)
            sigma = np.full(loads.shape[2], self._friction)
            parts.append(Nuisances.of_motions(tangent.motion(loads), sigma, loads, ranges))
        return parts

    def threshold(self, ranges: Ranges) -> np.ndarray:
        """τ of the L1 term (n,) for an image's weights, 1/Pa."""
        return self._tau * np.sqrt(ranges.weight.sum() / self._weight)

    def _problem(
        self, tangent: Tangent, ranges: Ranges, state: State, gas: float | None
    ) -> ContactProblem:
        prior = Prior(self._smoothness, self.threshold(ranges), self.mesh.rings)
        relaxing = self._relaxation(tangent, state, gas)
        return ContactProblem(tangent, ranges, prior, state.pressure, relaxing)

    def _contact(
        self,
        tangent: Tangent,
        ranges: Ranges,
        state: State,
        gas: float | None,
        rounds: int,
    ) -> ContactPressure:
        problem = self._problem(tangent, ranges, state, gas)
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
        ranges: Ranges,
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
        friction = ranges.nuisances.forces @ contact.amplitudes
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

    def _was_linear(self, step: Step, observed: _Linearisation, following: _Linearisation) -> bool:
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
        change = self._change(step, beyond) @ force
        variance = np.diag(step.contact.problem.covariance_of(nodes, force))
        return bool((change**2 <= variance).all())

    def _wrench_covariance(self, step: Step, contact: np.ndarray) -> np.ndarray:
        """Covariance (6, 6) of the wrench due to noise, nuisances, material and model.

        The support is uncertain by one node: its neighbours may touch, too.
        """
        if not contact.any():
            return np.zeros((6, 6))
        nodes, problem = step.contact.nodes, step.contact.problem
        unit = self._unit_wrenches(step, contact, nodes)
        by_material = [
            self._change(step, step.ranges.jacobian @ motion) @ unit
            for motion in step.tangent.by_material.T
        ]
        unknowns = np.concatenate([step.contact.pressure[nodes], step.contact.amplitudes])
        push = np.where(contact, step.contact.pressure, 0.0)[:, None]
        push = push * self.bubble.area_vectors(step.state.x)
        model = _model_covariance(step.state.x, push, unknowns @ unit, self._friction)
        around = np.flatnonzero(problem.with_neighbours(step.contact.pressure > 0.0))
        unit = self._unit_wrenches(step, problem.with_neighbours(contact), around)
        covariance = model + problem.covariance_of(around, unit)
        for change in by_material:
            covariance += np.outer(change, change)
        return covariance

    def _change(self, step: Step, ranges_m: np.ndarray) -> np.ndarray:
        """Change of pressures and amplitudes (s + a,) for a change of the ranges (k,)."""
        contact, count = step.contact, len(step.contact.nodes)
        gradient = contact.problem.misfit_gradient(contact.nodes, ranges_m)
        change: np.ndarray = -contact.covariance[:, :count] @ gradient
        change[count:] += step.ranges.amplitudes(ranges_m)
        return change

    def _unit_wrenches(self, step: Step, counted: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """Force, and torque about the origin of B, on the nodes `counted` (n,) bool, (s + a, 6).

        For unit pressures of nodes (s,) and unit amplitudes.
        """
        x, push = step.state.x, -self.bubble.area_vectors(step.state.x) * counted[:, None]
        loads, at = step.ranges.nuisances.forces[counted].swapaxes(1, 2), x[counted][:, None]
        by_pressures = np.hstack([push[nodes], np.cross(x[nodes], push[nodes])])
        by_amplitudes = np.hstack([loads.sum(axis=0), np.cross(at, loads).sum(axis=0)])
        return np.concatenate([by_pressures, by_amplitudes])


def _model_covariance(
    x: np.ndarray, push: np.ndarray, wrench: np.ndarray, friction: float
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
    spin = friction * np.sqrt((load @ arm**2) * load.sum())
    size = np.linalg.norm((wrench_about(center) @ wrench).reshape(2, 3), axis=1)
    sigma = np.column_stack([np.diag(MODEL_ERROR * np.repeat(size, 3)), np.zeros(6)])
    sigma[3:, 6] = spin * normal
    back = wrench_about(-center) @ sigma
    return back @ back.T


def _contact_blocks(observed: _Linearisation, pressure: np.ndarray) -> int:
    """Number of blocks of pixels that see a facet with a node under pressure (n,)."""
    jacobian = observed.view.jacobian
    touched = (pressure > 0.0)[jacobian.indices // 3]
    row = np.repeat(np.arange(jacobian.shape[0]), np.diff(jacobian.indptr))
    sees = np.bincount(row[touched], minlength=jacobian.shape[0]) > 0
    return int(np.count_nonzero(sees & (observed.weight > 0.0)))


def _noise_converged(updated: float, noise: float, earlier: list[float]) -> bool:
    """Whether the noise factor has converged that a frame was solved with.

    Neighbours on the grid count as equal: their ratio is two standard deviations. Two factors
    further apart can alternate for ever, each with its own support: the larger one is taken.
    """
    near = min(updated, noise) >= 1.0 and abs(_noise_index(updated / noise)) <= 1
    alternating = updated < noise and updated in earlier
    return updated == noise or near or alternating or len(earlier) + 1 >= _MAX_NOISES


def _noise_index(noise: float) -> int:
    """Nearest power of `_NOISE_RATIO` to a noise factor."""
    return round(log(noise) / log(_NOISE_RATIO))


def _on_noise_grid(noise: float) -> float:
    """Nearest noise factor on the grid."""
    step = _NOISE_RATIO if noise >= 1.0 else UPPER_95
    return step ** round(log(noise) / log(step))
