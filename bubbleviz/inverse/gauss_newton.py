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
    SURELY,
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
    evident,
    friction_loads,
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
from bubbleviz.result import Status

NEAR, SERVES, FAR = 0.05, 0.2, 0.5
"""Shares of a mesh edge. A frame is done when a step moves the shape by less than the first, or the
first step from the frame before by less than the second; beyond the last a step is far from done. A
tangent serves while the shape is nearer than the second to where it was taken: the exact residual
puts the rest right."""
_STEPS, _FAR_STEPS = 16, 8
"""Gauss–Newton steps of a frame, and how many of them may be far, though shorter than `_LONGEST`:
by then the shape stands, or model and data contradict each other."""
_ASTRAY = 3
"""Far steps in a row that end no nearer to the image than the nearest shape so far, after which a
frame counts as failed. Frames that were solved had one at most: on the real press, and on rubber
dragged and twisted by another solver."""
_SELECTIONS, _ROUNDS = 2, 6
"""Times that the support is looked for anew where the shape stands, and how often nodes that pull
are added to it each time."""
MINIMUM_BLOCKS = 3
"""A plane's worth of blocks: with fewer, no dent can be told from a shift of the sensor."""
_LIKELIEST = 300
"""Nodes of a contact up to which the likeliest support is looked for: an exchange of one node costs
the square of them, and the edge of a larger contact is a small part of it. Chosen."""
_LONGEST = 2.0
"""Longest step in mesh edges."""
MODEL_ERROR = 0.02
"""Standard deviation of the force over its size by what triangles, material law and the three
amplitudes of friction miss. Chosen on balls and pucks that stick to a membrane of another mesh and
are dragged and twisted: forces are off by 1.8 % in the median of 42 frames, by up to 9 % where a
puck is twisted by 15° and dragged at once; of frictionless presses by 1.4 % at most."""
IMAGE_ERROR = 1e-3
"""Standard deviation of the errors of a whole depth image over the depth: 0.1 mm at 100 mm; where
more than noise is left it is as much larger. Chosen on rubber dragged by another solver, whose
images have no such errors: with 1e-2 an offset and an opposite scale imitate a change of gas
pressure, and forces are 4 to 8 % off; with 1e-3 or less they are within 1 %. The prior is weak
against thousands of blocks: an offset of 1 mm is still found."""
_FREE_SHARE = 0.5
"""Share of the image that has to see the membrane where nothing touches it for errors of the whole
image to be looked for: most of what is fitted should not be the contact itself. Chosen."""
_NOISE_STEP, _NOISES = 1.1, 8
"""Factor between the noises that frames are solved with, and how many are tried in one. From a
continuum a frame would stop at one that hangs on where it began. Half a step is about a standard
deviation: an image of correlated noise is worth some 650 samples, which tell it to 5 %. Less noise
than the sensor's is told by squares alone, and the factor is their `SURELY`."""


@dataclass(frozen=True)
class State:
    """Where one frame ended and the next may begin.

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
        None: the frame had no contact, or nothing is known of it.
    tangent : Tangent or None
        Tangent that was used last.
    noise : float
        By how much more than its noise the frame before was missed, a first guess for the next.
    reached : State or None
        Where the steps of this frame ended, be it to be trusted or not: a place to go on from for
        who knows more of the frame. None where they did not begin.
    measured : Measured or None
        What this frame's image told; None where none was looked at.
    view : ShapeRanges or None
        The camera's model at the last shape that it was found at.
    """

    state: State | None = None
    tangent: Tangent | None = None
    noise: float = 1.0
    reached: State | None = None
    measured: Measured | None = None
    view: ShapeRanges | None = None


@dataclass(frozen=True)
class FailedFrame:
    """A frame that could not be solved.

    Attributes
    ----------
    status : Status
    reached : State or None
        Where the steps ended.
    """

    status: Status
    reached: State | None = None


@dataclass(frozen=True)
class _Sight:
    """What an image tells of a shape.

    Attributes
    ----------
    view : ShapeRanges
        The camera's model of the shape.
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
        """Of the blocks in `view`, (k,), 1/m²."""
        return self.observation.weight[self.view.block]

    def misfit(self, error_m: np.ndarray) -> float:
        """χ² of errors (k,), with the errors of the whole image that suit them best."""
        return float(error_m @ self._by_image.weighed(error_m))

    def is_nearer_at_rest(self, error_m: np.ndarray) -> bool:
        """Whether the image is more like the membrane at rest than what leaves errors (k,)."""
        at_rest = self.observation.residual_m[self.view.block]
        return self.misfit(error_m) > self.misfit(at_rest)

    def without_image_errors(self, error_m: np.ndarray) -> np.ndarray:
        """Errors (k,) less what those of the whole image explain of them."""
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
        Where it ends.
    balanced : bool
        Whether that is an equilibrium.
    moved_m, seen_m : float
        Its longest motion along an axis, and along the membrane's normals: a depth image shows
        nothing of motion along the membrane.
    contact : ContactPressure
    tangent : Tangent
    ranges : Ranges
    left_m : (k,) array
        Errors of the ranges that it leaves, to first order.
    solve_ms : float
    """

    state: State
    balanced: bool
    moved_m: float
    seen_m: float
    contact: ContactPressure
    tangent: Tangent
    ranges: Ranges
    left_m: np.ndarray
    solve_ms: float

    @property
    def image_error_m(self) -> np.ndarray:
        """Errors of the ranges (k,) by those of the whole image; 0 where they were not free."""
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
        The camera's model at the last shape that it was found at.
    noise : float
        By how much more than the camera's noise it is missed.
    misfit : Misfit
    contradicts_gas : bool
        Whether its shape asks for another p_v than was measured.
    contact : (n,) bool array
        Nodes under pressure that is evidence of contact, see `evident`.
    sigma_n : (3,) array
        Standard deviation of its force, N.
    seen_share : float
        Share of its area that the camera saw; NaN where nothing touches.
    solve_ms : float
        Of all steps.
    """

    step: Step
    view: ShapeRanges
    noise: float
    misfit: Misfit
    contradicts_gas: bool
    contact: np.ndarray
    sigma_n: np.ndarray
    seen_share: float
    solve_ms: float


class GaussNewton:
    """Gauss–Newton steps of single frames, each from where another one ended, or from rest.

    Parameters
    ----------
    observer : RangeObserver
    bubble : Bubble
    smoothness : (n, n) sparse array
        λ L of the H1 term.
    length_m : float
        Size of the membrane, m: ranges that are off by more are not of it.
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
        self._near_m, self._serves_m = NEAR * edge, SERVES * edge
        self._far_m, self._longest_m = FAR * edge, _LONGEST * edge
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
        """The same for a gas whose pressure is measured with another error."""
        other = copy(self)
        other.bubble = self.bubble.with_gas(gas)
        return other

    def _detection_at_rest(self) -> None:
        """τ of the L1 term by what the camera says of the membrane at rest."""
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
        """Steps until the shape stands, on a support found anew while it moves far.

        Once it moves by less than a share of an edge the support is kept, for steps between two
        supports would go on for ever; where the shape then stands it is looked for a last time.
        A start that the image is less like than the membrane at rest is left for that. A frame
        is given up whose shape is farther from rest than the membrane is wide, or goes astray.
        Errors of the whole image are looked for from where the shape is close, lest they explain
        what the linearisation misses.
        How much more or less than the noise is left decides how far the image is trusted, but
        whether there is contact is decided by no less than the noise of the sensor. The first step
        to an equilibrium tells it roughly, unless that contradicts the gas; until then only those
        nodes are looked at that pull most. From then on every step to an equilibrium tells it
        again, and the frame is solved where noise and answer agree: they do not hang on the frames
        before.

        Parameters
        ----------
        measured : Measured
        measured_gas : float or None
            p_v, Pa; None: it follows from the volume.
        start : Start

        Raises
        ------
        RuntimeError, LinAlgError
            A singular tangent, or Hessian.
        """
        state, warm = start.state or self._rest, start.state is not None
        view, tangent, noise = start.view, start.tangent, start.noise
        noises: list[float] = []  # that the frame was solved with; inf: for a first guess
        selecting, chosen, far_steps, steps, solve_ms = True, 0, 0, 0, 0.0
        ahead = self._look(measured, state, view) if warm else None
        close, clear = warm, ahead is None or self._is_clear(ahead, state.pressure)
        nearest, astray, far = np.inf, 0, False
        while steps < _STEPS and astray < _ASTRAY:
            steps += 1
            sight = ahead or self._look(measured, state, view)
            ahead = None
            misfit = sight.misfit(sight.error_m)
            astray = astray + 1 if far and misfit >= nearest else 0
            nearest = min(nearest, misfit)
            if np.abs(state.x - self.mesh.nodes).max() > self._length_m:
                break
            follows = warm and steps == 1 and not noises
            if follows and self._is_better_from_rest(measured, measured_gas, sight, noise):
                return self.solve(measured, measured_gas, Start())
            if failure := self._unlike_a_membrane(sight, state):
                return failure
            untouched = state is self._rest and self._nothing_pulls(sight, measured_gas)
            close = close or untouched
            known = warm or bool(noises)  # how much more than the noise is left
            rounds = (_ROUNDS if known else 1) if selecting and not untouched else 0
            free = close and clear
            step = self._step(tangent, state, sight, measured_gas, noise, rounds, free)
            if step is None:
                break
            state, view, tangent = step.state, sight.view, step.tangent
            solve_ms += step.solve_ms
            far = step.moved_m > self._far_m
            far_steps += selecting and far and step.moved_m < 0.9 * self._longest_m
            stands = close and step.balanced and step.seen_m <= self._near_m
            close = close or not far
            if close:
                clear = clear and self._is_clear(sight, step.contact.pressure)
            if follows and step.balanced and self._near_m < step.seen_m <= self._serves_m:
                ahead = self._look(measured, state, view)
                stands = self._was_linear(step, sight, ahead)
            stands = stands and free == (close and clear)
            done = stands and ((selecting and step.contact.complete) or chosen > _SELECTIONS)
            guessed = step.balanced and not known and not self._contradicts(state.gas, measured_gas)
            if done or guessed or (step.balanced and known and not far):
                found = self._noise_left(step, sight, noise, clear)
                if done and _settled(found, noise, noises):
                    last = (ahead or sight).view
                    return self._answer(step, sight, last, measured_gas, noise, solve_ms)
                if done or guessed:
                    noises.append(noise if done else np.inf)
                    chosen, steps, astray = 0, 0, 0
                noise = found
            if stands:
                selecting, chosen = True, chosen + 1
            elif far_steps == _FAR_STEPS:
                break
            else:
                selecting = far
        unlike = noise > IMPLAUSIBLE_MISFIT
        return FailedFrame("implausible" if unlike else "not_converged", state)

    def _look(self, measured: Measured, state: State, last: ShapeRanges | None) -> _Sight:
        """The image beside the camera's model of a state, close to a shape seen before."""
        at_rest = state is self._rest
        view = self._view_at_rest if at_rest else self.observer.around(state.x, last)
        expected = view.model_m + self.observer.image_errors @ state.image_errors
        observation = self.observer.weigh(measured, expected)
        error = observation.residual_m[view.block] - view.model_m[view.block]
        errors_m = self.observer.image_errors[view.block]
        image = Nuisances.of_image(errors_m, self._image_sigma, len(state.x))
        return _Sight(view, observation, error, image)

    def _is_clear(self, sight: _Sight, pressure: np.ndarray) -> bool:
        """Whether the image shows enough of the membrane where nothing touches it."""
        clear = np.count_nonzero(sight.weight) - _seen_blocks(sight, pressure)
        return bool(clear >= _FREE_SHARE * len(self._view_at_rest.block))

    def _unlike_a_membrane(self, sight: _Sight, state: State) -> FailedFrame | None:
        """Why an image is none of the membrane, if it is not."""
        seen = sight.weight > 0.0
        if np.count_nonzero(seen) < MINIMUM_BLOCKS:
            return FailedFrame("no_data")
        error = sight.error_m[seen]
        # Contact only pushes inwards: what is far outside the membrane at rest is another surface.
        outside = state is self._rest and np.sqrt(np.mean(np.maximum(error, 0.0) ** 2))
        if (
            outside > IMPLAUSIBLE_SHARE * self._length_m
            or np.median(np.abs(error)) > self._length_m
        ):
            return FailedFrame("implausible", state)
        return None

    def _is_better_from_rest(
        self, measured: Measured, gas: float | None, sight: _Sight, noise: float
    ) -> bool:
        """Whether a frame is to be solved from rest, and not from the frame before."""
        # Less noise than the sensor's: by that, nothing may pull at the membrane at rest.
        if noise < 1.0 and self._nothing_pulls(self._look(measured, self._rest, None), gas):
            return True
        return sight.is_nearer_at_rest(sight.error_m)

    def is_untouched(self, measured: Measured) -> bool:
        """Whether an image by itself, without a gas pressure, is explained without contact."""
        sight = self._look(measured, self._rest, None)
        if self._unlike_a_membrane(sight, self._rest):
            return False
        pulled = not self._nothing_pulls(sight, None)
        step = self._step(None, self._rest, sight, None, 1.0, int(pulled), not pulled)
        if step is None or not step.balanced:
            return False
        noise = self._noise_left(step, sight, 1.0, self._is_clear(sight, step.contact.pressure))
        untouched = not pulled or self._nothing_pulls(sight, None, noise)
        return untouched and noise <= IMPLAUSIBLE_MISFIT

    def _nothing_pulls(self, at_rest: _Sight, gas: float | None, noise: float = 1.0) -> bool:
        """Whether an image of the membrane at rest is explained without contact."""
        tangent = self._rest_tangent[gas is not None]
        ranges = self._ranges(tangent, self._rest, at_rest, gas, noise)
        return self._problem(tangent, ranges, self._rest, gas).nothing_pulls()

    def _noise_left(self, step: Step, sight: _Sight, noise: float, clear: bool) -> float:
        """By how much more than the camera's noise a frame is missed, after one was assumed."""
        touching = bool(step.contact.pressure.any())
        if step.contact.pivots and not touching:
            return noise  # contact was looked for in vain, and what it would explain is left
        left = sight.without_image_errors(step.left_m) if clear else step.left_m
        found = self.observer.noise_left(sight.observation, sight.view.block, left)
        return _stepped(found) if touching else max(_stepped(found), 1.0)

    def _answer(
        self,
        step: Step,
        sight: _Sight,
        last: ShapeRanges,
        gas: float | None,
        noise: float,
        solve_ms: float,
    ) -> SolvedFrame | FailedFrame:
        if _seen_blocks(sight, step.contact.pressure) < np.count_nonzero(step.contact.pressure):
            return FailedFrame("no_data", step.state)
        touching, left = step.contact.pressure.any(), step.left_m + step.image_error_m
        if touching and sight.is_nearer_at_rest(left):
            return FailedFrame("implausible", step.state)  # contact makes it no better than none
        if not touching and noise > IMPLAUSIBLE_MISFIT:
            return FailedFrame("implausible", step.state)  # nor is it the membrane without contact
        misfit = self.observer.left(sight.observation, sight.view.block, step.left_m)
        contradicts = self._contradicts(step.state.gas, gas)
        contact = evident(self.mesh, step.contact)
        sigma, share = self._sigma(step, contact), self._seen_share(sight, contact)
        return SolvedFrame(step, last, noise, misfit, contradicts, contact, sigma, share, solve_ms)

    def _seen_share(self, sight: _Sight, contact: np.ndarray) -> float:
        """Share of the area of nodes (n,) bool that are a corner of a facet with a return."""
        jacobian, seen = sight.view.jacobian, np.zeros(len(contact), bool)
        weighed = np.repeat(sight.weight > 0.0, np.diff(jacobian.indptr))
        seen[jacobian.indices[weighed] // 3] = True
        area = self.mesh.areas * contact
        return float(area @ seen / area.sum()) if contact.any() else np.nan

    # -- one step -------------------------------------------------------------------------------

    def _step(
        self,
        last: Tangent | None,
        state: State,
        sight: _Sight,
        gas: float | None,
        noise: float,
        rounds: int,
        free: bool,
    ) -> Step | None:
        """A step from a state, with its support found anew in so many rounds; None: no answer.

        Errors of the whole image are `free` or taken for zero.
        """
        tangent = self._tangent_at(state, gas, last)
        ranges = self._ranges(tangent, state, sight, gas, noise, free)
        began = time.perf_counter()
        contact = self._contact(tangent, ranges, state, gas, rounds)
        solve_ms = 1e3 * (time.perf_counter() - began)
        if not contact.converged:
            return None
        ahead, balanced = self._advanced(tangent, state, ranges, contact, gas)
        motion = ahead.x - state.x
        left = sight.error_m - sight.view.jacobian @ motion.ravel()
        left -= ranges.nuisances.errors_m @ contact.amplitudes
        size = np.maximum(np.linalg.norm(tangent.area_vectors, axis=1), np.finfo(float).tiny)
        along = np.einsum("ij,ij->i", motion, tangent.area_vectors) / size
        moved, seen = float(np.abs(motion).max()), float(np.abs(along).max())
        return Step(ahead, balanced, moved, seen, contact, tangent, ranges, left, solve_ms)

    def _ranges(
        self,
        tangent: Tangent,
        state: State,
        sight: _Sight,
        gas: float | None,
        noise: float = 1.0,
        free: bool = True,
    ) -> Ranges:
        """What an image says near a shape, where it has so many times the camera's noise."""
        weight = sight.weight / noise**2
        # What the model misses is not the noise of pixels alone: a barometer and the whole image
        # are trusted less by as much, or their priors would drag the shape away from the image.
        doubt = max(noise, 1.0)
        known = self._nuisances(tangent, state, len(weight), gas, doubt)
        image = replace(sight.image, sigma=free * doubt * sight.image.sigma)
        nuisances = Nuisances.joined([*known, image])
        return Ranges(sight.view.jacobian, sight.error_m, weight, nuisances)

    def _nuisances(
        self, tangent: Tangent, state: State, ranges: int, gas: float | None, doubt: float
    ) -> list[Nuisances]:
        """Error of a measured gas pressure, and friction of the contacts that a state has."""
        parts = []
        if gas is not None:
            sigma = np.array([doubt * gas_sigma(self.bubble.gas, gas)])
            bulge, nothing = tangent.bulge[:, :, None], np.zeros((*state.x.shape, 1))
            parts.append(Nuisances.of_motions(bulge, sigma, nothing, ranges))
        if self._friction > 0.0 and state.pressure.any():
            loads = friction_loads(tangent.x, tangent.area_vectors, state.pressure, self.mesh.rings)
            sigma = np.full(loads.shape[2], self._friction)
            parts.append(Nuisances.of_motions(tangent.motion(loads), sigma, loads, ranges))
        return parts

    def threshold(self, ranges: Ranges) -> np.ndarray:
        """τ of the L1 term (n,) for what an image says, 1/Pa."""
        return self._tau * np.sqrt(ranges.weight.sum() / self._weight)

    def _problem(
        self, tangent: Tangent, ranges: Ranges, state: State, gas: float | None
    ) -> ContactProblem:
        prior = Prior(self._smoothness, self.threshold(ranges), self.mesh.rings)
        relaxing = self._relaxing(tangent, state, gas)
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
        if rounds and (state.pressure.any() or not problem.nothing_pulls()):
            selection = problem.select(state.support, rounds)
        change = self.bubble.gas_at(state.x)[0] if gas is None else gas
        if self.bubble.gas.zero_sigma_pa:  # what was measured may be far off: as found so far
            change = state.gas
        least = self.bubble.held_pressure_pa + change

        def touches(support: np.ndarray, pressure: np.ndarray) -> np.ndarray:
            return parts_with(self.mesh.rings, pressure >= least, support)

        if rounds and 0 < np.count_nonzero(selection.support) <= _LIKELIEST:
            selection = problem.likeliest(selection)
        return problem.refine(selection, touches)

    def _relaxing(self, tangent: Tangent, state: State, gas: float | None) -> np.ndarray:
        """Motion (n, 3) to equilibrium under a state's pressure, to first order."""
        if state is self._rest:  # in equilibrium but for a gas pressure that was measured
            return np.zeros_like(state.x) if gas is None else gas * tangent.bulge
        return tangent.motion(-self.bubble.residual(state.x, state.pressure, gas))

    def _advanced(
        self,
        tangent: Tangent,
        state: State,
        ranges: Ranges,
        contact: ContactPressure,
        gas: float | None,
    ) -> tuple[State, bool]:
        """Towards a contact pressure, and to equilibrium under it where that is close.

        Part of a pressure need not have an equilibrium nearby: a dent is held by the object's
        place. Then the shape goes where the data pull it, and the next step balances it.
        """
        share = min(1.0, self._longest_m / max(float(np.abs(contact.motion).max()), 1e-300))
        pressure = state.pressure + share * (contact.pressure - state.pressure)
        ahead, inside = state.x + share * contact.motion, gas
        if gas is not None:
            inside = state.gas + share * (gas + float(contact.amplitudes[0]) - state.gas)
        friction = ranges.nuisances.forces @ contact.amplitudes
        x, balanced = ahead, state is self._rest and not contact.motion.any()
        if share == 1.0 and not balanced:
            x, balanced, _ = self.bubble.settled(tangent, ahead, pressure, inside, friction)
            balanced = balanced and float(np.abs(x - ahead).max()) <= self._far_m
        if not balanced:
            x = ahead
        if inside is None:
            inside = self.bubble.gas_at(x)[0]
        image_errors = contact.amplitudes[-len(IMAGE_ERRORS) :]
        return State(x, pressure, contact.support, inside, friction, image_errors), balanced

    def _tangent_at(self, state: State, gas: float | None, last: Tangent | None) -> Tangent:
        """A tangent taken close to a state: the last one, where it still serves."""
        measured = gas is not None
        if state is self._rest:
            return self._rest_tangent[measured]
        if (
            last is not None
            and last.with_gas is not measured
            and float(np.abs(state.x - last.x).max()) <= self._serves_m
        ):
            return last
        return self.bubble.linearised(state.x, state.pressure, state.gas if measured else None)

    def _contradicts(self, asked_pa: float, measured_pa: float | None) -> bool:
        """Whether the shape asks for another p_v than was measured, if it was."""
        gas, gauge = self.bubble.gas, self.bubble.held_pressure_pa
        return measured_pa is not None and contradicts_measured_gas(
            asked_pa, measured_pa, gas, gauge
        )

    def _was_linear(self, step: Step, sight: _Sight, ahead: _Sight) -> bool:
        """Whether the image around a step's end changes its force by less than noise does."""
        touching = step.contact.pressure > 0.0
        if not touching.any():
            return True
        predicted = np.full(self.observer.blocks, np.nan)
        predicted[ahead.view.block] = ahead.error_m
        left = step.left_m + step.image_error_m
        beyond = np.nan_to_num(predicted[sight.view.block] - left)
        nodes = step.contact.nodes
        force = self._unit_forces(step, touching, nodes)
        change = self._change(step, beyond) @ force
        return bool((change**2 <= step.contact.problem.variance(nodes, force)).all())

    def _sigma(self, step: Step, contact: np.ndarray) -> np.ndarray:
        """Standard deviation by noise, nuisances, material and model of the force (3,), N.

        The support is known to a node: those beside it may touch, too.
        """
        if not contact.any():
            return np.zeros(3)
        problem, force = step.contact.problem, self._unit_forces(step, contact, step.contact.nodes)
        by_material = [
            self._change(step, step.ranges.jacobian @ motion) @ force
            for motion in step.tangent.by_material.T
        ]
        unknowns = np.concatenate(
            [step.contact.pressure[step.contact.nodes], step.contact.amplitudes]
        )
        model = MODEL_ERROR * np.linalg.norm(unknowns @ force)
        around = np.flatnonzero(problem.around(step.contact.pressure > 0.0))
        force = self._unit_forces(step, problem.around(contact), around)
        variance = problem.variance(around, force)
        return np.sqrt(variance + np.square(by_material).sum(axis=0) + model**2)

    def _change(self, step: Step, ranges_m: np.ndarray) -> np.ndarray:
        """Change of pressures and amplitudes (s + a,) where the ranges (k,) change."""
        contact, count = step.contact, len(step.contact.nodes)
        pull = contact.problem.pulled(contact.nodes, ranges_m)
        change: np.ndarray = -contact.covariance[:, :count] @ pull
        change[count:] += step.ranges.amplitudes(ranges_m)
        return change

    def _unit_forces(self, step: Step, counted: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """Force by unit pressures of nodes (s,) and amplitudes, (s + a, 3), where counted (n,)."""
        push = -self.bubble.area_vectors(step.state.x) * counted[:, None]
        friction = step.ranges.nuisances.forces[counted].sum(axis=0).T
        return np.concatenate([push[nodes], friction])


def _seen_blocks(sight: _Sight, pressure: np.ndarray) -> int:
    """Blocks of pixels that see a facet with a node under pressure (n,)."""
    jacobian = sight.view.jacobian
    touched = (pressure > 0.0)[jacobian.indices // 3]
    row = np.repeat(np.arange(jacobian.shape[0]), np.diff(jacobian.indptr))
    sees = np.bincount(row[touched], minlength=jacobian.shape[0]) > 0
    return int(np.count_nonzero(sees & (sight.weight > 0.0)))


def _settled(found: float, noise: float, before: list[float]) -> bool:
    """Whether a frame is solved that was solved with one noise and leaves another one.

    A step of them apart is the same noise: two standard deviations. Two that are further apart may
    follow each other for ever, each with its own support: the larger one stays.
    """
    same = found == noise or (min(found, noise) >= 1.0 and abs(_steps_from_1(found / noise)) <= 1)
    alternate = found < noise and found in before
    return same or alternate or len(before) + 1 >= _NOISES


def _steps_from_1(noise: float) -> int:
    """Steps of `_NOISE_STEP` nearest to a noise."""
    return round(log(noise) / log(_NOISE_STEP))


def _stepped(noise: float) -> float:
    """Nearest of the noises that frames are solved with."""
    step = _NOISE_STEP if noise >= 1.0 else SURELY
    return step ** round(log(noise) / log(step))
