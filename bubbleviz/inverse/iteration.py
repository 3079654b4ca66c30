"""One frame: Gauss–Newton steps until shape, contact pressure and noise agree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.camera import IMAGE_ERRORS, ImageErrors, Measured, Misfit, ShapeRanges
from bubbleviz.inverse.friction import INITIAL_SCALES, contacts_seen_by_flow
from bubbleviz.inverse.gauss_newton import (
    LARGE_MOTION,
    MAX_STEP,
    GaussNewton,
    Hyperparameters,
    State,
    Step,
)
from bubbleviz.inverse.measurements import FlowResidual, FrameData, LinearisedFrame
from bubbleviz.inverse.noise import AS_EXPECTED, Noise, are_neighbours, noise_converged
from bubbleviz.inverse.plausibility import IMPLAUSIBLE_MISFIT, IMPLAUSIBLE_SHARE
from bubbleviz.inverse.response import Tangent
from bubbleviz.inverse.wrench_covariance import (
    MODEL_ERROR,
    change_by,
    image_errors_by_model,
    unit_wrenches,
    wrench_covariance,
)
from bubbleviz.result import FlowFit, Status

_CONVERGED_MOTION, _CONVERGED_FORCE, _MAX_SETTLING = 0.05, 0.1, 2
"""Criteria of convergence: the largest motion of a node in a step, in mesh edges; the largest
change of a component of the force, in its standard deviations (an error of 0.1 σ adds 0.5 % to σ);
and the number of further steps taken if steps that short do not shrink. After a warm start one
step within the first limit is enough if the error of its linearisation changes the force by no more
than the second, and the noise factor is that of the previous frame or its neighbour on the grid:
otherwise contact and friction have changed. After longer first steps friction is still that of the
previous frame, and areas are up to 10 % off."""
_MAX_STEPS, _MAX_LARGE_STEPS = 16, 8
"""Most Gauss–Newton steps of a frame, and most large ones that are not cut off at `MAX_STEP`: a
frame that has not converged by then contradicts the model."""
_MAX_STALLED, _STALLED_SHARE = 3, 0.72
"""A frame fails after this many consecutive large steps that leave more than this share of the
smallest χ² so far. Steps of the largest length towards a contact reduce χ² by more. Of the
converged frames of the real press, of rubber dragged and twisted by another solver, and of presses
of six objects, one (a plane 29 mm deep across a dome) had two such steps in a row, all others at
most one. A plate pressed 40 of 50 mm into a dome is refused by this rule. Without it, images that
do not show a membrane took up to 15 such steps, of 0.3 s each."""
_MAX_SELECTIONS, _SELECTION_ROUNDS, _SELECTING_STEPS = 2, 6, 3
"""Most selections of the support at a converged shape, how often each may add nodes with a negative
gradient, and the number of first steps that select the support. If only the first one does, frames
of a moving object take 2.2 instead of 1.8 steps; if the first five do, some hardly converge."""
MINIMUM_BLOCKS = 3
"""Blocks that a plane needs: with fewer, a dent cannot be distinguished from a shift of the
sensor."""


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
    scales : (float, float, float)
        Scales of its priors, see `Hyperparameters`, also a first guess.
    image_errors : ImageErrors or None
        Prior of the errors of the whole image in the frame.
    view : ShapeRanges or None
        Camera model at the last shape at which it was computed.
    by_flow : Start or None
        The same from depth and optical flow; all other attributes are from depth alone.
    """

    state: State | None = None
    tangent: Tangent | None = None
    noise: Noise = AS_EXPECTED
    scales: tuple[float, ...] = INITIAL_SCALES
    image_errors: ImageErrors | None = None
    view: ShapeRanges | None = None
    by_flow: Start | None = None


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
    wrench_covariance : (6, 6) array
        Covariance of its force, N, and its torque about the origin of B, N·m.
    visible_share : float
        Share of the contact area visible to the camera; NaN without contact.
    flow : FlowFit or None
        None where flow saw no contact.
    image_errors : ImageErrors or None
        None if they are not known.
    solve_ms : float
        Of all steps.
    """

    step: Step
    view: ShapeRanges
    noise: Noise
    misfit: Misfit
    contradicts_gas: bool
    wrench_covariance: np.ndarray
    visible_share: float
    flow: FlowFit | None
    image_errors: ImageErrors | None
    solve_ms: float

    @property
    def touching(self) -> bool:
        """Whether there is contact."""
        return bool(self.step.state.pressure.any())


class Iteration:
    """Estimate of the shape and contact pressure of a frame by Gauss–Newton steps.

    1. Observe: model the image at the present shape and linearise the model there. Restart
       from rest if the rest shape fits the image better than the warm start does; give up if
       the image cannot be of this membrane, if the shape leaves its surroundings (`length_m`),
       or if large steps hardly reduce the misfit.
    2. Step: solve for contact pressure and nuisances. The support is selected anew while steps
       are large, in the first steps, near convergence, and after a first guess of the noise
       factor. After other small steps it is kept, as the solution could alternate between two
       supports forever. Insignificant parts of the contact are left out: they explain noise by a
       few nodes that depend on previous frames, and change the force by up to 3 %. Friction and
       errors of the whole image are fitted only near the solution (after a step to an
       equilibrium that was not cut off), where they hardly explain errors of the linearisation.
       With optical flow, which must start from the solution by depth alone, the support stays
       that of the start: tractions at all of its nodes could explain a light contact completely,
       without any pressure.
    3. Once the shape has converged, select the support again, until it is complete.
    4. Near the solution, the evidence of each step determines the noise factor by which the image
       is weighted, the scales of friction and of errors beside missing returns, and whether the
       known errors of the image fit; the support is selected again until they agree, so that the
       result does not depend on previous frames. Before, and with optical flow, the residual of
       each step to an equilibrium gives the noise factor of the next one. Whether there is contact
       is decided with at least the noise of the sensor. Without a warm start the first step to an
       equilibrium gives a first guess of the factor, unless it contradicts a measured gas pressure;
       until then, only the nodes with the steepest gradient are selected.

    Parameters
    ----------
    newton : GaussNewton
    data : FrameData
    start : Start
    """

    def __init__(self, newton: GaussNewton, data: FrameData, start: Start) -> None:
        self._newton, self._data = newton, data
        edge = newton.mesh.edge_length
        self._converged_m = _CONVERGED_MOTION * edge
        self._large_m = LARGE_MOTION * edge
        self._cut_m = 0.9 * MAX_STEP * edge
        # A contact of a single node tells too little of shape and friction to start from, but with
        # optical flow it is kept: the support is not selected then
        state, fewest = start.state or newton.rest, 2 if data.flow is None else 1
        self._warm = bool(np.count_nonzero(state.pressure) >= fewest)
        self._state, self._view = state if self._warm else newton.rest, start.view
        self._tangent = start.tangent
        scales = start.scales if self._warm else INITIAL_SCALES
        known, unknown = data.image_errors, newton.moved_prior
        image_errors = unknown if known is None or start.image_errors is unknown else known
        self._hyper = Hyperparameters(start.noise, scales, image_errors)
        self._start_noise = start.noise
        self._noises: list[Noise] = []  # factors solved with; inf: only used for a first guess
        self._near = self._warm  # the errors of the linearisation are small
        self._following = self._observe() if self._warm else None
        self._image_shows_rest = self._following is None or newton.shows_rest(
            self._following, self._state.pressure
        )
        self._selecting, self._selections = True, 0
        self._steps = self._large_steps = self._stalled = self._settling = 0
        self._motion_m = self._normal_motion_m = self._solve_ms = 0.0
        self._force_n = self._state.nodal_force.sum(axis=0)
        self._force_change_n = np.zeros(3)

    def solve(self) -> SolvedFrame | Status:
        """Solution of the frame, or why there is none.

        Raises
        ------
        RuntimeError, LinAlgError
            A singular tangent, or Hessian.
        """
        newton, data = self._newton, self._data
        while self._steps < _MAX_STEPS and not (self._stalled == _MAX_STALLED and self._large):
            self._steps += 1
            observed = self._linearised()
            if np.abs(self._state.x - newton.mesh.nodes).max() > newton.length_m:
                break
            first = self._warm and self._steps == 1 and not self._noises
            if first and data.flow is None and self._restarts_from_rest(observed):
                return Iteration(newton, data, Start()).solve()
            if failure := _reject_image(newton, observed, self._state):
                return failure
            at_rest = self._state is newton.rest
            no_contact = at_rest and newton.fits_without_contact(
                observed, data.gas_pa, image_errors=self._hyper.image_errors
            )
            self._near = self._near or no_contact
            rounds = _SELECTION_ROUNDS if self._noise_known else 1
            rounds *= self._selecting and not no_contact and data.flow is None
            fit_image = self._near and self._image_shows_rest
            step = newton.step(
                newton.tangent_at(self._state, data.gas_pa, self._tangent, self._motion_m),
                self._state,
                observed,
                data.gas_pa,
                self._hyper,
                rounds,
                fit_image,
                self._near,
            )
            if step is None:
                break
            by_evidence = self._near and data.flow is None
            same_image = step.hyperparameters.image_errors is self._hyper.image_errors
            self._take(step, observed)
            converged = self._has_converged(step, observed, first, fit_image)
            converged = converged and (rounds > 0 or same_image)
            searched = rounds > 0 or no_contact or bool(step.contact.pressure.any())
            if self._update_noise(step, observed, converged, searched, by_evidence):
                return self._result(step, observed)
            if not converged and self._large_steps == _MAX_LARGE_STEPS:
                break
        implausible = self._stalled == _MAX_STALLED or self._hyper.noise.ranges > IMPLAUSIBLE_MISFIT
        return "implausible" if implausible else "not_converged"

    @property
    def _noise_known(self) -> bool:
        """Whether the noise factor is more than a guess: only the steepest nodes count before."""
        return self._warm or bool(self._noises)

    @property
    def _large(self) -> bool:
        """Whether the last step was large: motion along the membrane hardly changes an image."""
        return min(self._motion_m, self._normal_motion_m) > self._large_m

    def _observe(self) -> LinearisedFrame:
        return self._newton.observe(self._data, self._state, self._view)

    def _linearised(self) -> LinearisedFrame:
        """The frame, linearised at the present shape.

        Counts the consecutive large steps that hardly reduced the misfit.
        """
        observed = self._following or self._observe()
        self._following = None
        noise = self._hyper.noise
        if observed.flow is not None and not noise.flow:
            # Friction has not explained any of it yet: steps with too small a factor diverge.
            factor = observed.flow.noise_factor(np.zeros_like(self._state.x))
            self._hyper = self._hyper._replace(noise=noise.with_flow(factor))
        if self._steps == 1:
            self._best = observed
        poor = self._large and observed.misfit >= _STALLED_SHARE * self._best.misfit
        self._stalled = self._stalled + 1 if poor else 0
        if self._large and observed.misfit < self._best.misfit:
            self._best = observed
        return observed

    def _restarts_from_rest(self, observed: LinearisedFrame) -> bool:
        """Whether a frame should be solved from rest instead of its warm start."""
        newton, data = self._newton, self._data
        # With a noise factor below 1 a contact could persist that the sensor's own noise explains.
        if self._hyper.noise.ranges < 1.0:
            at_rest = newton.observe(data, newton.rest, None)
            if newton.fits_without_contact(at_rest, data.gas_pa):
                return True
        return observed.fits_rest_better(observed.error_m)

    def _take(self, step: Step, observed: LinearisedFrame) -> None:
        self._state, self._view, self._tangent = step.state, observed.view, step.last_tangent
        self._solve_ms += step.solve_ms
        self._motion_m, self._normal_motion_m = step.motion_m, step.normal_motion_m
        force_n = step.state.nodal_force.sum(axis=0)
        self._force_n, self._force_change_n = force_n, force_n - self._force_n
        self._hyper = step.selected_with._replace(scales=step.hyperparameters.scales)
        self._large_steps += self._selecting and self._large and step.motion_m < self._cut_m

    def _has_converged(
        self, step: Step, observed: LinearisedFrame, first: bool, fit_image: bool
    ) -> bool:
        """Whether a step was the last one needed, at this support and noise.

        Also judges whether the shape is near the solution, and whether the image shows the membrane
        outside the contact.
        """
        newton = self._newton  # flow shows motion along the membrane, too
        motion = step.normal_motion_m if observed.flow is None else step.motion_m
        small = self._near and step.state.balanced and motion <= self._converged_m
        self._settling = self._settling + 1 if small else 0
        converged = small and self._is_small(step, self._force_change_n)
        converged = converged or self._settling > _MAX_SETTLING
        self._near = self._near or (step.state.balanced and step.motion_m < self._cut_m)
        if self._near and self._image_shows_rest:
            self._image_shows_rest = newton.shows_rest(observed, step.contact.pressure)
        follows = first and are_neighbours(step.hyperparameters.noise, self._start_noise)
        if follows and not converged and step.state.balanced and motion <= self._converged_m:
            self._following = self._observe()
            converged = self._was_linear(step, observed, self._following)
        return converged and fit_image == (self._near and self._image_shows_rest)

    def _was_linear(
        self, step: Step, observed: LinearisedFrame, following: LinearisedFrame
    ) -> bool:
        """Whether the error of a step's linearisation changes its force little."""
        exact = np.full(self._newton.observer.blocks, np.nan)
        exact[following.view.block] = following.error_m
        linear = step.residual_m + step.image_error_m
        beyond = np.nan_to_num(exact[observed.view.block] - linear)
        if observed.flow is not None and following.flow is not None:
            beyond_flow = following.flow.error_px - observed.flow.after(step.motion)
            beyond = np.concatenate([beyond, beyond_flow])
        unit = unit_wrenches(step, step.contact.nodes)[:, :3]
        return self._is_small(step, change_by(step, beyond) @ unit)

    def _is_small(self, step: Step, change_n: np.ndarray) -> bool:
        """Whether a change (3,) of the force of a step is small beside its deviation."""
        nodes = step.contact.nodes
        if not len(nodes):
            return not change_n.any()
        unit = unit_wrenches(step, nodes)[:, :3]
        variance = np.diag(step.contact.problem.covariance_of(nodes, unit))
        variance = variance + MODEL_ERROR**2 * (self._force_n @ self._force_n)
        return bool((change_n**2 <= _CONVERGED_FORCE**2 * variance).all())

    def _update_noise(
        self,
        step: Step,
        observed: LinearisedFrame,
        converged: bool,
        searched: bool,
        by_evidence: bool,
    ) -> bool:
        """Take the noise factors of the residual; whether the solution of the frame is found.

        Before that, also decides whether the next step selects the support. `searched`: contact was
        searched for, or there is some. `by_evidence`: the noise factor of the step is its own.
        """
        complete = self._selecting and step.contact.complete
        done = converged and (complete or self._selections > _MAX_SELECTIONS)
        contradicts = self._newton.contradicts(step.state.gas, self._data.gas_pa)
        first_guess = step.state.balanced and not self._noise_known and not contradicts
        known = step.state.balanced and self._noise_known and not self._large and searched
        if done and by_evidence:
            return True
        if done or first_guess or (known and not by_evidence):
            noise = self._hyper.noise
            updated = self._newton.updated_noise(step, observed, noise, self._image_shows_rest)
            if done and noise_converged(updated, noise, self._noises):
                return True
            if done or first_guess:
                self._noises.append(noise if done else Noise(np.inf, np.inf))
                self._selections = self._steps = self._stalled = self._settling = 0
            self._hyper = self._hyper._replace(noise=updated)
        early = self._steps < _SELECTING_STEPS
        self._selecting = converged or self._settling > 0 or self._large or first_guess or early
        if converged:
            self._selections, self._settling = self._selections + 1, 0
        return False

    def _result(self, step: Step, observed: LinearisedFrame) -> SolvedFrame | Status:
        newton, pressure, noise = self._newton, step.contact.pressure, step.hyperparameters.noise
        if pressure.any():
            unknown = np.count_nonzero(pressure[observed.seen])
            if newton.contact_blocks(observed, pressure) < max(int(unknown), 1):
                return "no_data"
            if observed.fits_rest_better(step.residual_m + step.image_error_m):
                return "implausible"  # contact does not improve the fit
        elif noise.ranges > IMPLAUSIBLE_MISFIT:
            return "implausible"  # nor does the membrane at rest fit
        view, observer, mesh = observed.view, newton.observer, newton.mesh
        by_flow = contacts_seen_by_flow(pressure, mesh.rings, observed.seen_by_flow)
        return SolvedFrame(
            step,
            (self._following or observed).view,
            noise,
            observer.misfit(observed.observation, view.block, step.residual_m, noise.ranges),
            newton.contradicts(step.state.gas, self._data.gas_pa),
            wrench_covariance(step, newton.friction, by_flow),
            _seen_share(observed, mesh.areas * (pressure > 0.0)),
            _flow_fit(step, observed.flow, noise) if by_flow.any() else None,
            self._image_errors(step, observed),
            self._solve_ms,
        )

    def _image_errors(self, step: Step, observed: LinearisedFrame) -> ImageErrors | None:
        """Errors of the whole image; where they are not fitted, those known before, if any."""
        measurements, own = step.measurements, slice(-len(IMAGE_ERRORS), None)
        if measurements.nuisances.root[own, own].any():
            covariance = measurements.nuisance_covariance[own, own]
            hyper = step.hyperparameters
            prior, newton = hyper.image_errors.widened(hyper.doubt), self._newton
            by_model = prior.by_model
            if hyper.image_errors is newton.moved_prior:
                model_errors = newton.observer.model_errors(observed.view.block)
                by_model = image_errors_by_model(step, model_errors)
            return ImageErrors(step.state.image_errors, covariance, prior, by_model)
        known = self._data.image_errors
        return None if known is self._newton.drift_prior else known


def is_untouched(newton: GaussNewton, measured: Measured) -> bool:
    """Whether an image alone, without a gas pressure, is explained without contact."""
    observed = newton.observe(FrameData(measured), newton.rest, None)
    if _reject_image(newton, observed, newton.rest):
        return False
    fits = newton.fits_without_contact(observed, None)
    rest_tangent = newton.tangent_at(newton.rest, None)
    hyper = Hyperparameters(AS_EXPECTED, INITIAL_SCALES, observed.image_prior)
    step = newton.step(rest_tangent, newton.rest, observed, None, hyper, int(not fits), fits, False)
    if step is None or not step.state.balanced:
        return False
    shows_rest = newton.shows_rest(observed, step.contact.pressure)
    noise = newton.updated_noise(step, observed, AS_EXPECTED, shows_rest).ranges
    untouched = fits or newton.fits_without_contact(observed, None, noise)
    return untouched and noise <= IMPLAUSIBLE_MISFIT


def _reject_image(newton: GaussNewton, observed: LinearisedFrame, state: State) -> Status | None:
    """Failure if the image does not fit the membrane, or None."""
    seen, size_m = observed.weight > 0.0, newton.length_m
    if np.count_nonzero(seen) < MINIMUM_BLOCKS:
        return "no_data"
    error = observed.error_m[seen]
    # Contact only pushes inwards: a surface far outside the membrane at rest is not the membrane.
    outside = state is newton.rest and np.sqrt(np.mean(np.maximum(error, 0.0) ** 2))
    if outside > IMPLAUSIBLE_SHARE * size_m or np.median(np.abs(error)) > size_m:
        return "implausible"
    return None


def _seen_share(observed: LinearisedFrame, area: np.ndarray) -> float:
    """Share of an area of nodes (n,) whose facets are seen."""
    return 1.0 - float(area @ ~observed.seen / area.sum()) if area.any() else np.nan


def _flow_fit(step: Step, flow: FlowResidual | None, noise: Noise) -> FlowFit:
    """How well the optical flow of a contact is fitted."""
    assert flow is not None  # it sees the contact
    contact = step.contact
    rms_px = float(np.sqrt(np.mean(flow.after(step.motion) ** 2)))
    own = step.measurements.nuisances.motions[contact.nodes]
    pushed = step.tangent.responses(contact.nodes).reshape(len(step.state.x), 3, -1)[contact.nodes]
    motions = np.concatenate([-pushed, own], axis=2).reshape(3 * len(own), -1)
    covariance = contact.covariance[: motions.shape[1], : motions.shape[1]]
    variance = np.einsum("ij,jk,ik->i", motions, covariance, motions, optimize=True)
    return FlowFit(rms_px, noise.flow, float(np.sqrt(variance.mean())))
