"""From a depth image to shape, contact pressure and gas pressure of the exact rubber membrane."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from math import log

import numpy as np
from scipy import sparse

from bubbleviz.camera.block_squares import SURELY
from bubbleviz.camera.observer import (
    Measured,
    Misfit,
    Observation,
    RangeObserver,
    ShapeRanges,
)
from bubbleviz.errors import InputError
from bubbleviz.inverse.contact_problem import (
    ContactPressure,
    ContactProblem,
    GasError,
    Prior,
    Ranges,
    Selection,
    smoothness,
)
from bubbleviz.inverse.detection import sampled, universal_threshold
from bubbleviz.inverse.estimator import MAX_NODES, MINIMUM_BLOCKS, EstimatorOptions
from bubbleviz.inverse.linearised_rubber import LinearisedRubber
from bubbleviz.inverse.plausibility import (
    GAS_CONTRADICTS,
    GAS_LAG,
    GAS_MODEL_ERROR,
    GAS_NOISE,
    IMPLAUSIBLE_MISFIT,
    STATUS_REASONS,
    reason_against_fit,
    reason_against_gas,
)
from bubbleviz.inverse.resolution import at_noise, resolution_m
from bubbleviz.inverse.rubber_equilibrium import RubberEquilibrium
from bubbleviz.inverse.scales import Scales
from bubbleviz.inverse.solvers.inverse_solver import RUBBER
from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.mesh_graph import parts_with
from bubbleviz.membrane.rubber_model.rubber_membrane import RubberMembrane
from bubbleviz.result import Estimate, Status

_NEAR, SERVES, _FAR = 0.05, 0.2, 0.5
"""Shares of a mesh edge. A frame is done when a step moves the shape by less than the first, or the
first step from the frame before by less than the second; beyond the last a step is far from done. A
tangent serves while the shape is nearer than the second to where it was taken: the exact residual
puts the rest right."""
_STEPS, _FAR_STEPS = 16, 8
"""Gauss–Newton steps of a frame, and how many of them may be far, though shorter than `_LONGEST`:
by then the shape stands, or model and data contradict each other."""
_SELECTIONS, _ROUNDS = 2, 6
"""Times that the support is looked for anew where the shape stands, and how often nodes that pull
are added to it each time."""
_LONGEST = 2.0
"""Longest step in mesh edges."""
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
    """

    x: np.ndarray
    pressure: np.ndarray
    support: np.ndarray
    gas: float


@dataclass(frozen=True)
class RubberStart:
    """What `RubberEstimator.estimate` hands from one frame to the next.

    Attributes
    ----------
    state : State or None
        None: the frame had no contact, or nothing is known of it.
    rubber : LinearisedRubber or None
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
    rubber: LinearisedRubber | None = None
    noise: float = 1.0
    reached: State | None = None
    measured: Measured | None = None
    view: ShapeRanges | None = None


@dataclass(frozen=True)
class _Failure:
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
    """

    view: ShapeRanges
    observation: Observation
    error_m: np.ndarray

    @property
    def weight(self) -> np.ndarray:
        """Of the blocks in `view`, (k,), 1/m²."""
        return self.observation.weight[self.view.block]

    @property
    def is_nearer_at_rest(self) -> bool:
        """Whether the image is more like the membrane at rest than like the shape."""
        at_rest = self.observation.residual_m[self.view.block]
        return bool(self.weight @ self.error_m**2 > self.weight @ at_rest**2)


@dataclass(frozen=True)
class _Step:
    """A Gauss–Newton step.

    Attributes
    ----------
    state : State
        Where it ends.
    balanced : bool
        Whether that is an equilibrium.
    moved_m : float
        Its longest motion along an axis.
    contact : ContactPressure
    rubber : LinearisedRubber
    ranges : Ranges
    left_m : (k,) array
        Errors of the ranges that it leaves, to first order.
    solve_ms : float
    """

    state: State
    balanced: bool
    moved_m: float
    contact: ContactPressure
    rubber: LinearisedRubber
    ranges: Ranges
    left_m: np.ndarray
    solve_ms: float


@dataclass(frozen=True)
class _Answer:
    """A solved frame.

    Attributes
    ----------
    step : _Step
        The last one.
    view : ShapeRanges
    noise : float
    misfit : Misfit
    contradicts_gas : bool
    sigma_n : (3,) array
    solve_ms : float
    """

    step: _Step
    view: ShapeRanges
    noise: float
    misfit: Misfit
    contradicts_gas: bool
    sigma_n: np.ndarray
    solve_ms: float


class RubberEstimator:
    """Solves the inverse problem of the exact membrane frame by frame, each started from the last.

    Contact presses along the current normals on the support that an L1 term finds; everywhere else
    the membrane is in equilibrium by construction. A connected part of the support that nowhere
    reaches the gas pressure is no contact: what lies on something flat or convex carries that.

    Parameters
    ----------
    observer : RangeObserver
    membrane : RubberMembrane
    gas : Gas
        P0 and V0 of the reference configuration.
    options : EstimatorOptions, optional
    variants : sequence of RubberMembrane, optional
        The membrane with one of its material numbers moved by its standard deviation each, for
        `force_sigma_n`.

    Attributes
    ----------
    solver_name : str
    held_pressure_pa : float
        Gauge pressure of the reference configuration, which a contact carries that flattens it.
    prior_weight : float
        λ of the H1 term, 1/Pa².
    resolution_m : float
        Width of the estimate's response to a point load, m, at the noise of the camera; that of a
        frame is in its estimate.
    """

    def __init__(
        self,
        observer: RangeObserver,
        membrane: RubberMembrane,
        gas: Gas,
        options: EstimatorOptions | None = None,
        variants: Sequence[RubberMembrane] = (),
    ) -> None:
        self.mesh = observer.mesh
        if len(self.mesh.nodes) > MAX_NODES:
            raise InputError(
                f"mesh: {len(self.mesh.nodes)} nodes are too many for the inverse problem; "
                f"use at most {MAX_NODES}, the noise hides what 3,000 cannot resolve"
            )
        self.observer, self.membrane, self.gas = observer, membrane, gas
        self.options = options or EstimatorOptions()
        self.solver_name = RUBBER
        rest = self.mesh.nodes
        self.scales = Scales.of(self.mesh, membrane.mean_tension)
        self.held_pressure_pa = membrane.gauge_pressure_pa
        self.prior_weight = (self.options.pressure_scale * self.held_pressure_pa) ** -2.0
        self.equilibrium = RubberEquilibrium(membrane, gas, variants)
        edge = self.mesh.edge_length
        self._near_m, self._serves_m = _NEAR * edge, SERVES * edge
        self._far_m, self._longest_m = _FAR * edge, _LONGEST * edge
        nothing = np.zeros(len(rest))
        self._rest = State(rest, nothing, nothing > 0.0, 0.0)
        self._rest_rubber = {
            measured: self.equilibrium.linearised(rest, nothing, None if not measured else 0.0)
            for measured in (False, True)
        }
        self._prior_at_rest()

    def _prior_at_rest(self) -> None:
        """λ, τ and resolution by what the camera says of the membrane at rest."""
        mesh, everything = self.mesh, self.observer.observe_everything()
        view = self._view_at_rest = self.observer.around(mesh.nodes)
        weight = everything.weight[view.block]
        n = len(mesh.free)
        sample = mesh.free[sampled(n)]
        D = sparse.diags_array(np.sqrt(weight)) @ view.jacobian
        sigma = np.linalg.norm(D @ self._rest_rubber[False].responses(sample), axis=0)
        self._tau = universal_threshold(sigma / mesh.areas[sample], n) * mesh.areas
        self._weight = float(weight.sum())
        self.smoothness = smoothness(mesh, self.prior_weight)
        seen = float(weight.sum() / mesh.facet_areas.sum())
        self.resolution_m = resolution_m(self.prior_weight, self.membrane.mean_tension, seen)

    def estimate(
        self,
        depth_m: np.ndarray,
        gas_pressure_pa: float | None = None,
        start: RubberStart | None = None,
    ) -> tuple[Estimate, RubberStart]:
        """Solve one frame; also what the next one starts from.

        Parameters
        ----------
        depth_m : (H, W) array
            z-depth, NaN where there is no return.
        gas_pressure_pa : float, optional
            Measured absolute gas pressure.
        start : RubberStart, optional
            Of the frame before; from rest when None.
        """
        start = start or RubberStart()
        gas = None
        if gas_pressure_pa is not None and not np.isnan(gas_pressure_pa):
            gas = gas_pressure_pa - self.gas.P0
            if beyond := reason_against_gas(gas, self.gas):
                return self._nothing("implausible", beyond), RubberStart()
        measured = self.observer.measure(depth_m)
        try:
            answer = self._solve(measured, gas, start)
        except (RuntimeError, np.linalg.LinAlgError):  # a singular tangent, or Hessian
            answer = _Failure("not_converged")
        if isinstance(answer, _Failure):
            nothing = self._nothing(answer.status, STATUS_REASONS[answer.status])
            return nothing, RubberStart(reached=answer.reached, measured=measured)
        doubt = GAS_CONTRADICTS if answer.contradicts_gas else ""
        if doubt := doubt or reason_against_fit(answer.misfit, self.observer.white):
            nothing = self._nothing("implausible", doubt, answer.misfit.rms_m)
            return nothing, RubberStart(reached=answer.step.state, measured=measured)
        state, rubber = answer.step.state, answer.step.rubber
        touching = state if state.pressure.any() else None
        start = RubberStart(touching, rubber, answer.noise, state, measured, answer.view)
        return self._report(answer), start

    # -- one frame ------------------------------------------------------------------------------

    def _solve(
        self, measured: Measured, measured_gas: float | None, start: RubberStart
    ) -> _Answer | _Failure:
        """Gauss–Newton steps until the shape stands, on a support found anew while it moves far.

        Once it moves by less than a share of an edge the support is kept, for steps between two
        supports would go on for ever; where the shape then stands it is looked for a last time.
        A start that the image is less like than the membrane at rest is left for that.
        How much more or less than the noise is left decides how far the image is trusted, but
        whether there is contact is decided by no less than the noise of the sensor. The first step
        to an equilibrium tells it roughly, unless that contradicts the gas; until then only those
        nodes are looked at that pull most. The frame is solved until noise and answer agree: they
        do not hang on the frames before.
        """
        state, warm = start.state or self._rest, start.state is not None
        view, rubber, noise = start.view, start.rubber, start.noise
        noises: list[float] = []  # that the frame was solved with
        selecting, chosen, far_steps, steps, solve_ms = True, 0, 0, 0, 0.0
        while steps < _STEPS:
            steps += 1
            sight = self._look(measured, state, view)
            follows = warm and steps == 1 and not noises
            if follows and self._is_better_from_rest(measured, measured_gas, sight, noise):
                return self._solve(measured, measured_gas, RubberStart())
            if failure := self._unlike_a_membrane(sight, state):
                return failure
            known = warm or bool(noises)  # how much more than the noise is left
            rounds = (_ROUNDS if known else 1) if selecting else 0
            step = self._step(rubber, state, sight, measured_gas, noise, rounds)
            if step is None:
                break
            state, view, rubber = step.state, sight.view, step.rubber
            solve_ms += step.solve_ms
            far = step.moved_m > self._far_m
            far_steps += selecting and far and step.moved_m < 0.9 * self._longest_m
            near_m = self._serves_m if follows and step.contact.pressure.any() else self._near_m
            stands = step.balanced and step.moved_m <= near_m
            done = stands and ((selecting and step.contact.complete) or chosen > _SELECTIONS)
            guessed = step.balanced and not known and not self._contradicts(state.gas, measured_gas)
            if done or guessed:
                found = self._noise_left(step, sight, noise)
                if done and _settled(found, noise, noises):
                    return self._answer(step, sight, measured_gas, noise, solve_ms)
                noises.append(noise if done else np.inf)
                noise, chosen, steps = found, 0, 0
            if stands:
                selecting, chosen = True, chosen + 1
            elif far_steps == _FAR_STEPS:
                break
            else:
                selecting = far
        return _Failure("not_converged", state)

    def _look(self, measured: Measured, state: State, last: ShapeRanges | None) -> _Sight:
        """The image beside the camera's model of a state, close to a shape seen before."""
        at_rest = state is self._rest
        view = self._view_at_rest if at_rest else self.observer.around(state.x, last)
        observation = self.observer.weigh(measured, view.model_m)
        error = observation.residual_m[view.block] - view.model_m[view.block]
        return _Sight(view, observation, error)

    def _unlike_a_membrane(self, sight: _Sight, state: State) -> _Failure | None:
        """Why an image is none of the membrane, if it is not."""
        seen = sight.weight > 0.0
        if np.count_nonzero(seen) < MINIMUM_BLOCKS:
            return _Failure("no_data")
        if np.median(np.abs(sight.error_m[seen])) > self.scales.length_m:
            return _Failure("implausible", state)
        return None

    def _is_better_from_rest(
        self, measured: Measured, gas: float | None, sight: _Sight, noise: float
    ) -> bool:
        """Whether a frame is to be solved from rest, and not from the frame before."""
        if noise < 1.0:  # by the noise of the sensor nothing may pull at the membrane at rest
            rubber, at_rest = (
                self._rest_rubber[gas is not None],
                self._look(measured, self._rest, None),
            )
            ranges = self._ranges(rubber, at_rest, gas)
            if self._problem(rubber, ranges, self._rest, gas).nothing_pulls():
                return True
        return sight.is_nearer_at_rest

    def _noise_left(self, step: _Step, sight: _Sight, noise: float) -> float:
        """By how much more than the camera's noise a frame is missed, after one was assumed."""
        touching = bool(step.contact.pressure.any())
        if step.contact.pivots and not touching:
            return noise  # contact was looked for in vain, and what it would explain is left
        found = self.observer.noise_left(sight.observation, sight.view.block, step.left_m)
        return _stepped(found) if touching else max(_stepped(found), 1.0)

    def _answer(
        self, step: _Step, sight: _Sight, gas: float | None, noise: float, solve_ms: float
    ) -> _Answer:
        misfit = self.observer.left(sight.observation, sight.view.block, step.left_m)
        contradicts, sigma = self._contradicts(step.state.gas, gas), self._sigma(step)
        return _Answer(step, sight.view, noise, misfit, contradicts, sigma, solve_ms)

    # -- one step -------------------------------------------------------------------------------

    def _step(
        self,
        last: LinearisedRubber | None,
        state: State,
        sight: _Sight,
        gas: float | None,
        noise: float,
        rounds: int,
    ) -> _Step | None:
        """A step from a state, with its support found anew in so many rounds; None: no answer."""
        rubber = self.rubber_at(state, gas, last)
        ranges = self._ranges(rubber, sight, gas, noise)
        began = time.perf_counter()
        contact = self._contact(rubber, ranges, state, gas, rounds)
        solve_ms = 1e3 * (time.perf_counter() - began)
        if not contact.converged:
            return None
        ahead, balanced = self._advanced(rubber, state, contact, gas)
        motion = ahead.x - state.x
        left = sight.error_m - sight.view.jacobian @ motion.ravel()
        moved = float(np.abs(motion).max())
        return _Step(ahead, balanced, moved, contact, rubber, ranges, left, solve_ms)

    def _ranges(
        self, rubber: LinearisedRubber, sight: _Sight, gas: float | None, noise: float = 1.0
    ) -> Ranges:
        """What an image says near a shape, where it has so many times the camera's noise."""
        jacobian, weight = sight.view.jacobian, sight.weight / noise**2
        gas_error = None
        if gas is not None:
            sigma = self.gas_sigma(gas)
            gas_error = GasError(rubber.bulge, jacobian @ rubber.bulge.ravel(), sigma)
        return Ranges(jacobian, sight.error_m, weight, gas_error)

    def _problem(
        self, rubber: LinearisedRubber, ranges: Ranges, state: State, gas: float | None
    ) -> ContactProblem:
        tau = self._tau * np.sqrt(ranges.weight.sum() / self._weight)
        prior = Prior(self.smoothness, tau, self.mesh.rings)
        relaxing = self._relaxing(rubber, state, gas)
        return ContactProblem(rubber, ranges, prior, state.pressure, relaxing)

    def _contact(
        self,
        rubber: LinearisedRubber,
        ranges: Ranges,
        state: State,
        gas: float | None,
        rounds: int,
    ) -> ContactPressure:
        problem = self._problem(rubber, ranges, state, gas)
        selection = Selection(state.support)
        if rounds and (state.pressure.any() or not problem.nothing_pulls()):
            selection = problem.select(state.support, rounds)
        change = self.equilibrium.gas_at(state.x)[0] if gas is None else gas
        least = self.held_pressure_pa + change

        def touches(support: np.ndarray, pressure: np.ndarray) -> np.ndarray:
            return parts_with(self.mesh.rings, pressure >= least, support)

        if rounds and selection.support.any():
            selection = problem.likeliest(selection)
        return problem.refine(selection, touches)

    def _relaxing(self, rubber: LinearisedRubber, state: State, gas: float | None) -> np.ndarray:
        """Motion (n, 3) to equilibrium under a state's pressure, to first order."""
        if state is self._rest:  # in equilibrium but for a gas pressure that was measured
            return np.zeros_like(state.x) if gas is None else gas * rubber.bulge
        return rubber.motion(-self.equilibrium.residual(state.x, state.pressure, gas))

    def _advanced(
        self,
        rubber: LinearisedRubber,
        state: State,
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
            inside = state.gas + share * (gas + contact.gas_error_pa - state.gas)
        x, balanced = ahead, state is self._rest and not contact.motion.any()
        if share == 1.0 and not balanced:
            x, balanced, _ = self.equilibrium.settled(rubber, ahead, pressure, inside)
            balanced = balanced and float(np.abs(x - ahead).max()) <= self._far_m
        if not balanced:
            x = ahead
        if inside is None:
            inside = self.equilibrium.gas_at(x)[0]
        return State(x, pressure, contact.support, inside), balanced

    def rubber_at(
        self, state: State, gas: float | None, last: LinearisedRubber | None
    ) -> LinearisedRubber:
        """A tangent taken close to a state: the last one, where it still serves."""
        measured = gas is not None
        if state is self._rest:
            return self._rest_rubber[measured]
        if (
            last is not None
            and last.with_gas is not measured
            and float(np.abs(state.x - last.x).max()) <= self._serves_m
        ):
            return last
        return self.equilibrium.linearised(state.x, state.pressure, state.gas if measured else None)

    # -- what is to be believed -----------------------------------------------------------------

    def _contradicts(self, asked_pa: float, measured_pa: float | None) -> bool:
        """Whether the shape asks for another p_v than was measured, if it was."""
        if measured_pa is None:
            return False
        certain = IMPLAUSIBLE_MISFIT * self.gas_sigma(measured_pa)
        return abs(asked_pa - measured_pa) > max(certain, GAS_LAG * self.held_pressure_pa)

    def gas_sigma(self, measured_pa: float) -> float:
        """Standard deviation of a measured p_v, and of what the model makes of it, Pa."""
        return float(np.hypot(GAS_NOISE * self.gas.P0, GAS_MODEL_ERROR * measured_pa))

    def _sigma(self, step: _Step) -> np.ndarray:
        """Standard deviation of the force by noise and material, (3,), N."""
        contact, rubber, ranges = step.contact, step.rubber, step.ranges
        nodes = contact.nodes
        if not len(nodes):
            return np.zeros(3)
        push = self.membrane.volume_gradient(step.state.x)[nodes]
        variance = np.einsum("ik,ij,jk->k", push, contact.covariance, push)
        C = rubber.responses(nodes)
        for motion in rubber.by_material.T:
            moved = ranges.jacobian @ motion
            pull = C.T @ (ranges.transposed @ ranges.weighed(moved))
            variance += (push.T @ (contact.covariance @ pull)) ** 2
        return np.sqrt(variance)

    def _report(self, answer: _Answer) -> Estimate:
        state, contact = answer.step.state, answer.step.contact
        touching = bool(state.pressure.any())
        moved = state.x - self.mesh.nodes
        force = np.zeros(3)
        if touching:
            force = -state.pressure @ self.membrane.volume_gradient(state.x)
        return Estimate(
            status="ok" if touching else "no_contact",
            displacement_m=np.einsum("ij,ij->i", moved, self.mesh.normals),
            contact_pressure_pa=state.pressure,
            gas_pressure_change_pa=state.gas,
            residual_rms_m=answer.misfit.rms_m,
            kkt_residual=contact.kkt_residual,
            iterations=contact.pivots,
            solve_ms=answer.solve_ms,
            displacement_3d_m=moved,
            force_n=force,
            force_sigma_n=answer.sigma_n,
            gas_law_pa=self.equilibrium.gas_at(state.x)[0],
            resolution_m=at_noise(self.resolution_m, answer.noise),
        )

    def _nothing(self, status: Status, reason: str, misfit_m: float = np.nan) -> Estimate:
        """A frame about which nothing is known."""
        zero, three = np.zeros(len(self.mesh.nodes)), np.full(3, np.nan)
        return Estimate(
            status,
            zero,
            zero,
            np.nan,
            misfit_m,
            np.nan,
            displacement_3d_m=np.zeros((len(zero), 3)),
            force_n=three,
            force_sigma_n=three,
            reason=reason,
        )


def _settled(found: float, noise: float, before: list[float]) -> bool:
    """Whether a frame is solved that was solved with one noise and leaves another one.

    Two may follow each other for ever, each with its own support: the larger one stays.
    """
    alternate = found < noise and found in before
    return found == noise or alternate or len(before) + 1 >= _NOISES


def _stepped(noise: float) -> float:
    """Nearest of the noises that frames are solved with."""
    step = _NOISE_STEP if noise >= 1.0 else SURELY
    return step ** round(log(noise) / log(step))
