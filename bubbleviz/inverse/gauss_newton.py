"""A Gauss–Newton step: a frame linearised at a shape of the membrane, and its contact pressure."""

from __future__ import annotations

import time
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import sparse

from bubbleviz.camera import IMAGE_ERRORS, ImageErrors, RangeObserver, ShapeRanges, camera_shift
from bubbleviz.inverse.contact_problem import (
    MAX_EXCHANGE_NODES,
    ContactPressure,
    ContactProblem,
    Prior,
    Selection,
    TouchRule,
    significant_contact,
    smoothness,
    touching_parts,
)
from bubbleviz.inverse.friction import INITIAL_SCALES, friction_nuisances, prior_scale
from bubbleviz.inverse.measurements import (
    FlowResidual,
    FrameData,
    LinearisedFrame,
    Measurements,
    Nuisances,
)
from bubbleviz.inverse.noise import Noise, are_neighbours
from bubbleviz.inverse.pivoting import part
from bubbleviz.inverse.plausibility import contradicts_measured_gas, gas_sigma
from bubbleviz.inverse.resolution import SAMPLE, resolution_m, universal_threshold
from bubbleviz.inverse.response import BALANCED_MOTION, Bubble, Tangent
from bubbleviz.membrane import Gas, connected_parts, grown

TANGENT_REUSE, LARGE_MOTION, MAX_STEP = 0.2, 0.5, 2.0
"""Motions of the nodes, in mesh edges. A tangent is reused within `TANGENT_REUSE` of the shape at
which it was computed, or within the length of the last step if that is longer: the residual is
always exact. A step longer than `LARGE_MOTION` is large, and none exceeds `MAX_STEP`."""
_MAX_SOLUTIONS = 4
"""Most solutions of a linearised problem on one support, each with the hyperparameters that the
previous one determined; also the most supports selected in one step."""
_IMAGE_CHANGED = 22.5
"""χ² of the six errors of an image that one image in 1,000 exceeds by chance: above it, the camera
has moved since the known errors were determined."""
_MOVED, _FIXED = 5.0, 0.1
"""Standard deviations, relative to that of other errors of the image, of tilts and shifts of a
camera that may have been moved (0.5 mm at 100 mm), and of shifts of one that has not. Chosen:
mountings give way by that much; a shift that is free in every image imitates friction (on rubber
twisted by another solver the median error of the force would rise from 1.0 to 1.7 %)."""
IMAGE_ERROR = 1e-3
"""Standard deviation of the errors of a whole depth image over the depth: 0.1 mm at 100 mm; scaled
by the noise factor of a frame. Chosen on rubber dragged by another solver, whose
images have no such errors: with 1e-2 an offset and an opposite scale imitate a change of gas
pressure, and forces are 4 to 8 % off; with 1e-3 or less they are within 1 %. The prior is weak
against thousands of blocks: an offset of 1 mm is still found."""
_MIN_CONTACT_FREE = 0.5
"""Least share of the image outside the contact for errors of the whole image to be fitted: they
should mostly be determined by the contact-free membrane. Chosen."""


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
    clamp : (n, 3) array
        Force on the nodes of the rim that moves them beyond the expected slack, N.
    image_errors : (e,) array
        Amplitudes of `IMAGE_ERRORS`.
    balanced : bool
        Whether the shape is in equilibrium under these.
    area_vectors : (n, 3) array
        Of the nodes at the shape, m².
    """

    x: np.ndarray
    pressure: np.ndarray
    support: np.ndarray
    gas: float
    friction: np.ndarray
    clamp: np.ndarray
    image_errors: np.ndarray
    balanced: bool
    area_vectors: np.ndarray

    @property
    def nodal_force(self) -> np.ndarray:
        """Force of the contact on the nodes, (n, 3), N."""
        return self.friction - self.pressure[:, None] * self.area_vectors


class Scaled(NamedTuple):
    """Amplitudes whose prior has a scale by evidence: their indices, and their σ at scale 1."""

    own: np.ndarray
    sigma: float


class Hyperparameters(NamedTuple):
    """Noise and priors of a frame, as determined by its own evidence.

    `scales` are those of the priors of slides and spins by depth alone, and of errors beside
    missing returns; `image_errors` is the prior of the errors of the whole image.
    """

    noise: Noise
    scales: tuple[float, ...]
    image_errors: ImageErrors

    @property
    def doubt(self) -> float:
        """Factor of the priors of gas pressure and image errors.

        A noise factor above 1 is partly due to errors of the model: without this factor, narrow
        priors would pull the shape away from the image.
        """
        return max(self.noise.ranges, 1.0)


@dataclass(frozen=True)
class Step:
    """A Gauss–Newton step.

    Attributes
    ----------
    state : State
        State after it.
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
    scaled : three Scaled
        Slides and spins by depth alone, and errors beside missing returns.
    hyperparameters : Hyperparameters
        By the step's own evidence near the solution, else those given.
    selected_with : Hyperparameters
        Those with which the support was selected; if it was not, `hyperparameters`.
    residual_m : (k,) array
        Errors of the ranges after it, to first order.
    solve_ms : float
    """

    state: State
    motion: np.ndarray
    normal_motion_m: float
    contact: ContactPressure
    tangent: Tangent
    last_tangent: Tangent
    scaled: tuple[Scaled, ...]
    hyperparameters: Hyperparameters
    selected_with: Hyperparameters
    residual_m: np.ndarray
    solve_ms: float

    @property
    def measurements(self) -> Measurements:
        """The fitted measurements, with the prior of their nuisances."""
        return self.contact.problem.measurements

    @property
    def image_error_m(self) -> np.ndarray:
        """Range errors (k,) of the whole image and beside missing returns, as far as fitted."""
        return self.measurements.nuisances.error(self.contact.amplitudes)

    @property
    def motion_m(self) -> float:
        """Largest motion of a node along an axis."""
        return float(np.abs(self.motion).max())


class GaussNewton:
    """Linearised problems of single frames, and their steps.

    Parameters
    ----------
    observer : RangeObserver
    bubble : Bubble
    prior_weight : float
        λ of the H1 term, 1/Pa².
    length_m : float
        Size of the membrane, m: a range with a larger error is not of the membrane.
    friction : float
        Standard deviation of the amplitudes of `friction_nuisances`; 0 for none.
    image_error : float
        Standard deviation of the errors of a whole image, see `IMAGE_ERROR`; 0 for none.

    Attributes
    ----------
    rest : State
        Without contact.
    smoothness : (n, n) sparse array
        λ L of the H1 term.
    drift_prior, moved_prior : ImageErrors
        Of an image of which nothing else is known, of a camera that is where it was calibrated, and
        of one that may have been moved.
    resolution_m : float
        Width of the estimate's response to a point load, m, at the noise of the camera.
    weight_density : float
        Weight of all ranges at rest over the membrane's area, 1/m⁴.
    """

    def __init__(
        self,
        observer: RangeObserver,
        bubble: Bubble,
        prior_weight: float,
        length_m: float,
        friction: float,
        image_error: float,
    ) -> None:
        self.mesh, self.observer, self.bubble = observer.mesh, observer, bubble
        self.smoothness = smoothness(self.mesh, prior_weight)
        self.length_m, self.friction = length_m, friction
        depth = float(observer.image_errors[:, 3].mean() / observer.image_errors[:, 0].mean())
        drift = np.array([depth, depth, depth, 1.0, _FIXED * depth, _FIXED * depth])
        moved = _MOVED * depth * np.array([0.0, 1.0, 1.0, 0.0, 1.0, 1.0])
        self.drift_prior, self.moved_prior = (
            ImageErrors(np.zeros(len(IMAGE_ERRORS)), image_error**2 * np.diag(sigma**2))
            for sigma in (drift, np.hypot(drift, moved))
        )
        edge = self.mesh.edge_length
        self._reuse_m, self._large_m = TANGENT_REUSE * edge, LARGE_MOTION * edge
        self._max_step_m, self._balanced_m = MAX_STEP * edge, BALANCED_MOTION * edge
        rest = self.mesh.nodes
        nothing = np.zeros(len(rest))
        image = self.moved_prior.mean
        still, vectors = np.zeros_like(rest), bubble.area_vectors(rest)
        self.rest = State(rest, nothing, nothing > 0.0, 0.0, still, still, image, True, vectors)
        self._rest_tangent = {
            measured: bubble.linearised(rest, nothing, None if not measured else 0.0)
            for measured in (False, True)
        }
        self._view_at_rest = observer.around(rest)
        self._detection_at_rest()
        tension = bubble.tension_n_per_m
        self.resolution_m = resolution_m(prior_weight, tension, self.weight_density)

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
        sample = mesh.free[:: max(1, n // SAMPLE)]
        D = sparse.diags_array(np.sqrt(weight)) @ view.jacobian
        sigma = np.linalg.norm(D @ self._rest_tangent[False].responses(sample), axis=0)
        self._tau = universal_threshold(sigma / mesh.areas[sample], n) * mesh.areas
        self._weight = float(weight.sum())
        self.weight_density = float(weight.sum() / mesh.facet_areas.sum())

    def observe(self, data: FrameData, state: State, last: ShapeRanges | None) -> LinearisedFrame:
        """Camera model and residual at a state; `last` is a model at a shape nearby."""
        at_rest = state is self.rest
        prior = data.image_errors or self.moved_prior
        image_errors = prior.mean if at_rest else state.image_errors
        nearby = self._view_at_rest if at_rest else last
        view = self.observer.around(state.x, nearby, camera_shift(image_errors))
        expected = view.model_m + self.observer.image_errors @ image_errors
        observation = self.observer.weigh(data.ranges, expected)
        errors_m = self.observer.image_errors[view.block]
        measured_m = observation.residual_m[view.block] - errors_m @ prior.mean
        flow = None if data.flow is None else FlowResidual.at(state.x, data.flow)
        border = data.ranges.border[view.block]
        return LinearisedFrame(view, observation, measured_m, errors_m, prior, border, flow)

    def shows_rest(self, observed: LinearisedFrame, pressure: np.ndarray) -> bool:
        """Whether enough of the image is outside the contact to fit errors of the whole image."""
        outside = np.count_nonzero(observed.weight) - self.contact_blocks(observed, pressure)
        return bool(outside >= _MIN_CONTACT_FREE * len(self._view_at_rest.block))

    def contact_blocks(self, observed: LinearisedFrame, pressure: np.ndarray) -> int:
        """Number of blocks of pixels that see a facet with a node under pressure (n,)."""
        touched = (pressure > 0.0)[self.mesh.triangles].any(axis=1)
        return int(np.count_nonzero(touched[observed.view.hits.triangle] & (observed.weight > 0.0)))

    def fits_without_contact(
        self,
        at_rest: LinearisedFrame,
        gas: float | None,
        noise: float = 1.0,
        image_errors: ImageErrors | None = None,
    ) -> bool:
        """Whether a depth image of the membrane at rest is explained without contact.

        `image_errors`: prior of the errors of the whole image, by default its own.
        """
        tangent = self._rest_tangent[gas is not None]
        by_depth = replace(at_rest, border=at_rest.border[:, :0], flow=None)
        hyper = Hyperparameters(Noise(noise), INITIAL_SCALES, image_errors or at_rest.image_prior)
        measurements, _ = self._measurements(tangent, self.rest, by_depth, gas, hyper, False, True)
        return self._problem(tangent, measurements, self.rest, gas).zero_is_optimal()

    def updated_noise(
        self, step: Step, observed: LinearisedFrame, noise: Noise, fit_image: bool
    ) -> Noise:
        """Noise factors by the residual of a step that assumed the factors `noise`."""
        if step.contact.pivots and not step.contact.pressure.any():
            return noise  # no contact found: the residual still includes what it would explain
        updated = self._noise_of(step.contact, step.residual_m, observed, noise, fit_image)
        if observed.flow is None:
            return updated
        return updated.with_flow(observed.flow.noise_factor(step.motion))

    def _noise_of(
        self,
        contact: ContactPressure,
        residual_m: np.ndarray,
        observed: LinearisedFrame,
        noise: Noise,
        fit_image: bool,
    ) -> Noise:
        """Noise factors, with the one of the ranges determined by their residual (k,)."""
        left = observed.without_image_errors(residual_m) if fit_image else residual_m
        factor = self.observer.noise_factor(observed.observation, observed.view.block, left)
        return noise.with_ranges(factor if contact.pressure.any() else max(factor, 1.0))

    def step(
        self,
        tangent: Tangent,
        state: State,
        observed: LinearisedFrame,
        gas: float | None,
        hyper: Hyperparameters,
        rounds: int,
        fit_image: bool,
        near: bool,
    ) -> Step | None:
        """A step from a state with a tangent there, or None if its problem was not solved.

        The support is selected in `rounds` rounds with the given hyperparameters; errors of the
        whole image are fitted (`fit_image`) or zero. Near the solution friction is fitted,
        insignificant parts of the contact are left out, and the step's own evidence determines the
        hyperparameters: the support is selected again until they agree with those that it was
        selected with (noise factor within a step of its grid, the same errors of the image and the
        same scale of those beside missing returns).
        """
        measurements, scaled = self._measurements(
            tangent, state, observed, gas, hyper, near, fit_image
        )
        began = time.perf_counter()
        problem = self._problem(tangent, measurements, state, gas)
        touches, support = self._touch_rule(state, gas), state.support
        selected_with, selections = hyper, 0
        while True:
            contact = self._contact(problem, touches, support, observed, rounds, near)
            if not near:
                break
            contact, hyper = self._by_evidence(
                contact, touches, scaled, observed, gas, hyper, fit_image
            )
            if not rounds:
                selected_with = hyper
                break
            selections += 1
            same_image = hyper.image_errors is selected_with.image_errors
            same_border = hyper.scales[-1] == selected_with.scales[-1]
            settled = (
                same_image and same_border and are_neighbours(hyper.noise, selected_with.noise)
            )
            if settled or selections == _MAX_SOLUTIONS:
                break
            selected_with, problem, support = hyper, contact.problem, contact.support
        solve_ms = 1e3 * (time.perf_counter() - began)
        if not contact.converged:
            return None
        nuisances = contact.problem.measurements.nuisances
        image_errors = observed.image_prior.mean + contact.amplitudes[-len(IMAGE_ERRORS) :]
        after, last = self._advance(tangent, state, nuisances, contact, gas, image_errors)
        motion = after.x - state.x
        size = np.maximum(np.linalg.norm(tangent.area_vectors, axis=1), np.finfo(float).tiny)
        along = np.einsum("ij,ij->i", motion, tangent.area_vectors) / size
        return Step(
            after,
            motion,
            float(np.abs(along).max()),
            contact,
            tangent,
            last,
            scaled,
            hyper,
            selected_with,
            observed.residual_m(motion, nuisances.error(contact.amplitudes)),
            solve_ms,
        )

    def _measurements(
        self,
        tangent: Tangent,
        state: State,
        observed: LinearisedFrame,
        gas: float | None,
        hyper: Hyperparameters,
        near: bool,
        fit_image: bool,
    ) -> tuple[Measurements, tuple[Scaled, ...]]:
        """Residual and weights of a frame with its nuisances, and those with a scale."""
        moving = []
        if gas is not None:
            bulge = tangent.bulge[:, :, None]
            moving.append((bulge, np.zeros_like(bulge)))
        by_depth = np.zeros(0, int)
        if near and self.friction > 0.0 and state.pressure.any():
            found = friction_nuisances(
                tangent, state.pressure, self.mesh.rings, self.smoothness, observed.seen_by_flow
            )
            by_depth = np.arange(found[0][0].shape[2])
            moving += found
            if observed.flow is not None:
                # The σ of the slack is the slack itself. Only flow shows the motion along the
                # membrane that determines it. Divided by the σ of friction, their common prior.
                pull = (self.bubble.rim_pull(state.x) - state.clamp)[:, :, None] / self.friction
                moving.append((tangent.motion(pull), pull))
        first = int(gas is not None)
        spins = by_depth % 3 == 2  # the third amplitude of each contact
        alone = observed.measurements(hyper.noise, moving)
        count = alone.nuisances.motions.shape[2]
        scaled = (
            Scaled(first + by_depth[~spins], self.friction),
            Scaled(first + by_depth[spins], self.friction),
            Scaled(count + np.arange(observed.border.shape[1]), self.observer.border_sigma_m),
        )
        prior = self._prior(alone.nuisances, scaled, observed, gas, hyper, fit_image)
        return alone.with_prior(*prior, 1.0), scaled

    def _prior(
        self,
        nuisances: Nuisances,
        scaled: tuple[Scaled, ...],
        observed: LinearisedFrame,
        gas: float | None,
        hyper: Hyperparameters,
        fit_image: bool,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Mean (a,), and root (a, a) of the covariance, of the prior of a frame's nuisances."""
        mean, root = np.zeros_like(nuisances.mean), np.zeros_like(nuisances.root)
        sigma = np.full(len(mean) - len(IMAGE_ERRORS), self.friction)
        if gas is not None:
            sigma[0] = hyper.doubt * gas_sigma(self.bubble.gas, gas)
        for (own, widest), scale in zip(scaled, hyper.scales, strict=True):
            sigma[own] = widest * scale
        np.fill_diagonal(root[: len(sigma)], sigma)
        if fit_image:
            last = slice(-len(IMAGE_ERRORS), None)
            mean[last] = hyper.image_errors.mean - observed.image_prior.mean
            root[last, last] = hyper.doubt * hyper.image_errors.units
        return mean, root

    def threshold(self, measurements: Measurements) -> np.ndarray:
        """τ of the L1 term (n,) for an image's weights, 1/Pa."""
        return self._tau * np.sqrt(measurements.weight.sum() / self._weight)

    def _problem(
        self, tangent: Tangent, measurements: Measurements, state: State, gas: float | None
    ) -> ContactProblem:
        prior = Prior(self.smoothness, self.threshold(measurements), self.mesh.rings)
        relaxing = self._relaxation(tangent, state, gas)
        return ContactProblem(tangent, measurements, prior, state.pressure, relaxing)

    def _touch_rule(self, state: State, gas: float | None) -> TouchRule:
        change = self.bubble.gas_at(state.x)[0] if gas is None else gas
        if self.bubble.gas.zero_sigma_pa:  # the measured one may be far off: use the estimate
            change = state.gas
        least = self.bubble.held_pressure_pa + change

        def touches(support: np.ndarray, pressure: np.ndarray) -> np.ndarray:
            return touching_parts(self.mesh, support, pressure, least, self.resolution_m)

        return touches

    def _contact(
        self,
        problem: ContactProblem,
        touches: TouchRule,
        support: np.ndarray,
        observed: LinearisedFrame,
        rounds: int,
        near: bool,
    ) -> ContactPressure:
        selection = Selection(support)
        if rounds and (support.any() or not problem.zero_is_optimal()):
            selection = problem.select(support, rounds)
        if rounds and 0 < np.count_nonzero(selection.support) <= MAX_EXCHANGE_NODES:
            selection = problem.max_evidence(selection)
        if rounds and near:  # with it from the first step on, fewer frames converge
            continued = self._continued(selection.support, observed)
            selection = replace(selection, support=continued)
        contact = problem.solve_debiased(selection, touches)
        if near and contact.pressure.any():
            significant = significant_contact(self.mesh, contact)
            if not np.array_equal(significant, contact.pressure > 0.0):
                contact = problem.solve_debiased(replace(selection, support=significant), touches)
        return contact

    def _by_evidence(
        self,
        contact: ContactPressure,
        touches: TouchRule,
        scaled: tuple[Scaled, ...],
        observed: LinearisedFrame,
        gas: float | None,
        hyper: Hyperparameters,
        fit_image: bool,
    ) -> tuple[ContactPressure, Hyperparameters]:
        """A contact with hyperparameters by its own evidence, and these.

        They are determined on its support, as they change neither the derivative of the
        measurements nor its Gram matrix. With optical flow the noise factors remain. The prior of
        the errors of the image is the known one unless the image refutes it.
        """
        selection = Selection(contact.support, contact.pivots, contact.converged, contact.complete)

        def solved(found: Hyperparameters) -> ContactPressure:
            nuisances = contact.problem.measurements.nuisances
            prior = self._prior(nuisances, scaled, observed, gas, found, fit_image)
            factor = (hyper.noise.ranges / found.noise.ranges) ** 2
            return contact.problem.with_prior(*prior, factor).solve_debiased(selection, touches)

        if hyper.image_errors is not observed.image_prior:
            known = hyper._replace(image_errors=observed.image_prior)
            contact, hyper = solved(known), known
        for solution in range(1, _MAX_SOLUTIONS + 1):
            found = self._evidence(contact, scaled, observed, hyper, fit_image)
            settled = found.noise == hyper.noise or solution == _MAX_SOLUTIONS
            if settled and fit_image and hyper.image_errors is not self.moved_prior:
                found = self._unless_refuted(found, contact, hyper, observed, solved)
            if found == hyper:
                break
            again, before = solved(found), hyper
            same_nodes, contact, hyper = np.array_equal(again.nodes, contact.nodes), again, found
            if same_nodes and hyper == before._replace(scales=hyper.scales):
                break  # the scales do not depend on those it was solved with
        return contact, hyper

    def _evidence(
        self,
        contact: ContactPressure,
        scaled: tuple[Scaled, ...],
        observed: LinearisedFrame,
        hyper: Hyperparameters,
        fit_image: bool,
    ) -> Hyperparameters:
        """Hyperparameters by the evidence of a contact solved with others."""
        scales = tuple(
            prior_scale(
                contact.amplitudes[own],
                part(contact.covariance, len(contact.nodes) + own),
                sigma,
                scale,
            ).value
            if len(own)  # else no contact, or optical flow sees all
            else scale
            for (own, sigma), scale in zip(scaled, hyper.scales, strict=True)
        )
        noise = self._noise_by(contact, observed, hyper.noise, fit_image)
        return hyper._replace(noise=noise, scales=scales)

    def _noise_by(
        self, contact: ContactPressure, observed: LinearisedFrame, noise: Noise, fit_image: bool
    ) -> Noise:
        """Noise factors by the residual of a contact that was solved with others."""
        if observed.flow is not None or (contact.pivots and not contact.pressure.any()):
            return noise
        error_m = contact.problem.measurements.nuisances.error(contact.amplitudes)
        residual_m = observed.residual_m(contact.motion, error_m)
        return self._noise_of(contact, residual_m, observed, noise, fit_image)

    def _unless_refuted(
        self,
        found: Hyperparameters,
        contact: ContactPressure,
        hyper: Hyperparameters,
        observed: LinearisedFrame,
        solved: Callable[[Hyperparameters], ContactPressure],
    ) -> Hyperparameters:
        """`found`, with another prior of the errors of the image if the image refutes that one.

        It is judged with the noise that a moved camera would leave: friction and noise may have
        taken up its motion in the contact that was solved with `hyper`.
        """
        noise, prior = found.noise, hyper.image_errors

        def change(contact: ContactPressure, doubt: float) -> float:
            """χ² of the errors of the image under the prior."""
            errors = observed.image_prior.mean + contact.amplitudes[-len(IMAGE_ERRORS) :]
            # errors known from other frames are not less certain because this one is noisy
            off = (errors - prior.mean) / (doubt if prior is self.drift_prior else 1.0)
            return float(off @ prior.precision @ off)

        if noise.ranges > 1.0 and observed.flow is None:
            # less noise, at least 1, multiplies χ² by about that factor's square or less
            if change(contact, hyper.doubt) * noise.ranges**2 <= _IMAGE_CHANGED:
                return found
            moved = solved(hyper._replace(image_errors=self.moved_prior))
            noise = min(noise, self._noise_by(moved, observed, noise, True))
        judged = hyper._replace(noise=noise)
        if judged != hyper:
            contact = solved(judged)
        if change(contact, judged.doubt) <= _IMAGE_CHANGED:
            return found
        # drift is tried before motion, which errors of the membrane's model resemble
        other = self.moved_prior if prior is self.drift_prior else self.drift_prior
        return found._replace(noise=noise, image_errors=other)

    def _hidden(self, observed: LinearisedFrame) -> np.ndarray:
        """Nodes (n,) bool that an image shows neither at the present shape nor at rest.

        Nodes that only the present shape hides, such as the wall around a plate, are not included.
        """
        at_rest = self._view_at_rest
        measured = observed.observation.weight[at_rest.block] > 0.0
        hidden = ~(observed.seen | self.mesh.rim)
        hidden[self.mesh.triangles[at_rest.hits.triangle[measured]]] = False
        return hidden

    def _continued(self, support: np.ndarray, observed: LinearisedFrame) -> np.ndarray:
        """Support (n,) bool of contacts that continue at `_hidden` nodes.

        The edge of the image, or of a hole in it, is not the edge of the contact, and the L1 term
        selects no node that has no measurement. A contact may continue there by its diameter in
        the given support. The pressure there follows from smoothness and the membrane around it.
        """
        mesh, hidden = self.mesh, self._hidden(observed)
        if not (hidden & grown(mesh.rings, support)).any():
            return support
        continued, nodes = np.zeros_like(support), np.flatnonzero(support)
        count, part = connected_parts(mesh.rings, support)
        for number in range(count):
            own = np.zeros_like(support)
            own[nodes[part == number]] = True
            if (own & ~hidden).any():
                diameter_m = 2.0 * np.sqrt(mesh.areas[own].sum() / np.pi)
                for _ in range(round(diameter_m / mesh.edge_length)):
                    own |= hidden & grown(mesh.rings, own)
            continued |= own
        return continued

    def _relaxation(self, tangent: Tangent, state: State, gas: float | None) -> np.ndarray:
        """Motion (n, 3) to equilibrium without friction, under the pressure of a state and the gas.

        To first order.
        """
        if not state.balanced:
            return tangent.motion(-self.bubble.residual(state.x, state.pressure, gas))
        motion = np.zeros_like(state.x)
        forces = state.friction + state.clamp
        if forces.any():
            motion -= tangent.motion(forces)
        change = self.bubble.gas_at(state.x)[0] if gas is None else gas
        if change != state.gas:
            motion += (change - state.gas) * tangent.bulge
        return motion

    def _advance(
        self,
        tangent: Tangent,
        state: State,
        nuisances: Nuisances,
        contact: ContactPressure,
        gas: float | None,
        image_errors: np.ndarray,
    ) -> tuple[State, Tangent]:
        """State after a step, and the last tangent computed.

        The shape is moved on to equilibrium under its new pressure if there is one nearby. After a
        step that was cut off there need not be one (the object prescribes positions, not
        pressures); the shape is then the linearised one, and the next step balances it.
        """
        length_m = float(np.abs(contact.motion).max())
        share = min(1.0, self._max_step_m / max(length_m, 1e-300))
        pressure = state.pressure + share * (contact.pressure - state.pressure)
        linear, inside = state.x + share * contact.motion, gas
        if gas is not None:
            inside = state.gas + share * (gas + float(contact.amplitudes[0]) - state.gas)
        force, rim = nuisances.force(contact.amplitudes), self.mesh.rim[:, None]
        x, balanced = linear, state.balanced and length_m <= self._balanced_m
        if share == 1.0 and not balanced:
            x, balanced, tangent = self.bubble.equilibrium(tangent, linear, pressure, inside, force)
            balanced = balanced and float(np.abs(x - linear).max()) <= self._large_m
        if not balanced:
            x = linear
        if inside is None:
            inside = self.bubble.gas_at(x)[0]
        forces = np.where(rim, 0.0, force), np.where(rim, force, 0.0)
        reached = *forces, image_errors, balanced, self.bubble.area_vectors(x)
        return State(x, pressure, contact.support, inside, *reached), tangent

    def tangent_at(
        self, state: State, gas: float | None, last: Tangent | None = None, step_m: float = 0.0
    ) -> Tangent:
        """Tangent near a state: the last one if it is near enough.

        Near enough is within `TANGENT_REUSE`, or within the length of the step that led to the
        state: the error is then of the order of that step's linearisation error, which the next
        step corrects. This does not apply to the tangent at rest: a dented membrane yields to
        friction in another way.
        """
        measured = gas is not None
        if state is self.rest:
            return self._rest_tangent[measured]
        if last is not None and last.with_gas is not measured:
            away_m = float(np.abs(state.x - last.x).max())
            from_rest = last is self._rest_tangent[measured]
            if away_m <= (self._reuse_m if from_rest else max(step_m, self._reuse_m)):
                return last
        return self.bubble.linearised(state.x, state.pressure, state.gas if measured else None)

    def contradicts(self, shape_pa: float, measured_pa: float | None) -> bool:
        """Whether p_v of the shape contradicts the measured one, if any."""
        gas, gauge = self.bubble.gas, (self.bubble.held_pressure_pa, self.bubble.gauge_sigma_pa)
        return measured_pa is not None and contradicts_measured_gas(
            shape_pa, measured_pa, gas, *gauge
        )
