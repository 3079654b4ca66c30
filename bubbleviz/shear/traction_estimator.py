"""From depth and optical flow to the contact traction with friction of the exact membrane."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import solve_triangular

from bubbleviz.camera import DepthCamera, Measured, Observation, ShapeRanges
from bubbleviz.inverse import (
    CONVERGED_MOTION,
    LARGE_MOTION,
    MODEL_ERROR,
    TANGENT_REUSE,
    Estimator,
    LinearisedRubber,
    RubberBubble,
    Start,
    gas_sigma,
)
from bubbleviz.membrane import MembraneMesh, RubberMembrane, checked_friction, dense_part, grown
from bubbleviz.result import Estimate, Traction, TractionStatus
from bubbleviz.shear.flow_observer import FlowObserver, MeasuredFlow, ShapeFlow
from bubbleviz.shear.traction_problem import Measurements, SolvedTraction, TractionProblem, Unknowns

if TYPE_CHECKING:
    from bubbleviz.shear.optical_flow import FlowField


# Where the solution of one frame is, and what it leaves unexplained.


@dataclass(frozen=True)
class TractionStart:
    """Where one frame ended and the next may begin."""

    x: np.ndarray  # (n, 3), shape, m
    pressure: np.ndarray  # (n,), p_c, Pa
    shear: np.ndarray  # (n, 3), forces along the membrane, N
    gas: float  # p_v, Pa
    rubber: LinearisedRubber  # tangent that was used last
    # range_noise, flow_noise: by how much more than their noise ranges and flow were missed
    range_noise: float = 1.0
    flow_noise: float = 1.0
    # the depth camera's model at the last shape that was looked at, which the next is close to
    view: ShapeRanges | None = None


class Look(NamedTuple):
    """What a shape leaves unexplained, and how that changes with the shape."""

    view: ShapeRanges
    observation: Observation  # of the ranges
    range_error: np.ndarray  # (k,), measured less modelled, of the blocks of `view`, m
    flow: ShapeFlow
    flow_error: np.ndarray  # (j, 2), measured less modelled, pixels
    measured: MeasuredFlow

    def measurements(self, state: TractionStart) -> Measurements:
        """Both, each trusted as far as the state's noise says."""
        by_flow = np.repeat(1.0 / (state.flow_noise * self.measured.sigma_px) ** 2, 2)
        by_range = self.observation.weight[self.view.block] / state.range_noise**2
        return Measurements(
            sparse.vstack([self.view.jacobian, self.flow.jacobian], format="csr"),
            np.concatenate([self.range_error, self.flow_error.ravel()]),
            np.concatenate([by_range, by_flow]),
        )

    def misfit(self, state: TractionStart) -> float:
        """Mean square error in standard deviations, by the noise of a state."""
        by_range = self.observation.weight[self.view.block] / state.range_noise**2
        by_flow = 1.0 / (state.flow_noise * self.measured.sigma_px) ** 2
        flow = float(by_flow @ (self.flow_error**2).sum(axis=1)) / (2 * len(by_flow))
        return float(by_range @ self.range_error**2) / len(by_range) + flow

    def after(self, motion: np.ndarray) -> Look:
        """The same after a small motion (n, 3), to first order."""
        flow = (self.flow.jacobian @ motion.ravel()).reshape(-1, 2)
        return self._replace(
            range_error=self.range_error - self.view.jacobian @ motion.ravel(),
            flow_error=self.flow_error - flow,
        )


# What a solved frame says of the contact: forces, torque, displacement, and how certain.


_ALL_UNKNOWN = np.full((6, 6), np.nan)


class TractionReport:
    """Makes tractions of solutions, and of frames without one."""

    def __init__(
        self,
        mesh: MembraneMesh,  # reference surface
        membrane: RubberMembrane,
    ) -> None:
        self._mesh, self._membrane = mesh, membrane

    def nothing(self, status: TractionStatus, reason: str) -> Traction:
        """A frame about which nothing is known."""
        nodal = np.full((len(self._mesh.nodes), 3), np.nan)
        center = np.full(3, np.nan)
        return Traction(
            status, nodal, nodal, nodal, nodal, nodal, nodal, center, _ALL_UNKNOWN, reason=reason
        )

    def untouched(self, estimate: Estimate) -> Traction:
        """A frame without contact."""
        x = self._positions(estimate)
        vectors = self._membrane.volume_gradient(x)
        return self._of("no_contact", x, np.zeros_like(x), vectors)

    def alone(self, estimate: Estimate, reason: str) -> Traction:
        """The contact of an estimate, whose friction is known by depth alone."""
        x = self._positions(estimate)
        vectors = self._membrane.volume_gradient(x)
        force = estimate.nodal_force_n
        if force is None:
            raise ValueError("the estimate was not made with the exact membrane")
        return self._of("depth_alone", x, force, vectors, reason=reason)

    def solved(
        self,
        state: TractionStart,
        rubber: LinearisedRubber,
        solved: SolvedTraction,
        nodes: np.ndarray,
        look: Look,
    ) -> Traction:
        """A frame with friction, solved by a tangent on support `nodes` (s,); `look` is there."""
        vectors = self._membrane.volume_gradient(state.x)
        force = state.shear - state.pressure[:, None] * vectors
        center = _center(state.x, force, vectors)
        squares = np.einsum("ij,ij->i", look.flow_error, look.flow_error)
        wrench = self._wrench_columns(state.x, rubber, vectors, nodes, center)[:, solved.active]
        deviation = solve_triangular(solved.factor[0], wrench.T, lower=True, check_finite=False)
        by_material = wrench @ solved.answer(rubber.by_material)
        covariance = deviation.T @ deviation + by_material @ by_material.T
        torque = np.cross(state.x - center, force).sum(axis=0)
        by_mesh = MODEL_ERROR * np.concatenate([force.sum(axis=0), torque])
        covariance += np.outer(by_mesh, by_mesh)
        columns = solved.columns.reshape(-1, 3, solved.columns.shape[1])[nodes]
        motions = columns[:, :, solved.active].reshape(3 * len(nodes), -1)
        moved = solve_triangular(solved.factor[0], motions.T, lower=True, check_finite=False)
        return self._of(
            "ok",
            state.x,
            force,
            vectors,
            wrench_covariance=covariance,
            displacement_sigma_m=float(np.sqrt(np.mean(np.sum(moved**2, axis=0)))),
            flow_rms_px=float(np.sqrt(0.5 * np.mean(squares))),
            flow_noise=state.flow_noise,
        )

    def _positions(self, estimate: Estimate) -> np.ndarray:
        return self._mesh.deformed(estimate.motion_m)

    def _of(
        self,
        status: TractionStatus,
        x: np.ndarray,
        force: np.ndarray,
        vectors: np.ndarray,
        *,
        wrench_covariance: np.ndarray = _ALL_UNKNOWN,
        displacement_sigma_m: float = np.nan,
        flow_rms_px: float = np.nan,
        flow_noise: float = np.nan,
        reason: str = "",
    ) -> Traction:
        areas = np.linalg.norm(vectors, axis=1, keepdims=True)
        n, moved = vectors / areas, x - self._mesh.nodes
        normal = np.einsum("ij,ij->i", force, n)[:, None] * n
        along = np.einsum("ij,ij->i", moved, n)[:, None] * n
        return Traction(
            status,
            force,
            normal,
            force - normal,
            force / areas,
            x,
            moved - along,
            _center(x, force, vectors),
            wrench_covariance,
            displacement_sigma_m,
            flow_rms_px,
            flow_noise,
            reason,
        )

    def _wrench_columns(
        self,
        x: np.ndarray,
        rubber: LinearisedRubber,
        vectors: np.ndarray,
        nodes: np.ndarray,
        center: np.ndarray,
    ) -> np.ndarray:
        """Force and torque of unit p, q and gas pressure, (6, c)."""
        across = rubber.tangents[nodes].reshape(-1, 3)
        forces = np.concatenate([-vectors[nodes], across])
        arms = x[np.concatenate([nodes, np.repeat(nodes, 2)])] - center
        wrench = np.concatenate([forces, np.cross(arms, forces)], axis=1).T
        gas = np.zeros((6, 0 if rubber.with_gas else 1))
        return np.hstack([wrench, gas])


def _center(x: np.ndarray, force: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Centre of the normal forces (3,), m, by current area vectors; NaN where there are none."""
    pushing = np.einsum("ij,ij->i", force, vectors) / np.linalg.norm(vectors, axis=1)
    load = np.maximum(-pushing, 0.0)
    total = float(load.sum())
    return load @ x / total if total > 0.0 else np.full(3, np.nan)


_STEPS = 12
_SHARES = (1.0, 0.5, 0.25)  # of a step that are tried until the shape explains more than before
_SEEN_SHARE = 0.5
"""Of the touched nodes that flow must be seen beside, for the rest to follow from it."""

NO_FLOW = "no optical flow: the colour image of the frame or the contact-free one is missing"
NO_TEXTURE = "no flow where the membrane is touched: no texture, or it could not be matched"
NO_CONTACT_SHAPE = "no contact in the depth image"
NOT_CONVERGED = "no equilibrium with friction was found"


@dataclass(frozen=True)
class TractionOptions:
    """Choices of an operator.

    Attributes
    ----------
    friction : float or None
        Coulomb's bound μ of the tangential over the normal traction; None for no bound.

    Raises
    ------
    InputError
        μ is out of range.
    """

    friction: float | None = None

    def __post_init__(self) -> None:
        if self.friction is not None:
            checked_friction(self.friction)


class _Frame(NamedTuple):
    """What was measured."""

    ranges: Measured
    image_error_m: np.ndarray  # (B,), of the ranges of the blocks, by the estimate of the depth
    flow: MeasuredFlow
    gas: float | None


class _Wanted(NamedTuple):
    """What a step aims at; `present` is the shear on the tangents it is described by."""

    solved: SolvedTraction
    pressure: np.ndarray
    present: np.ndarray
    shear: np.ndarray
    gas: float


class TractionEstimator:
    """Solves for shape, pressure and tangential traction frame by frame, after the estimate.

    Outside the support that depth found the membrane is in equilibrium by construction. How much
    more than by their noise ranges and flow are missed decides how far each is trusted.
    """

    def __init__(
        self,
        estimator: Estimator,  # of the frames' depth
        camera: DepthCamera,  # whose images the flow is of
        options: TractionOptions | None = None,
    ) -> None:
        self.mesh, self.options = estimator.mesh, options or TractionOptions()
        self._estimator, bubble = estimator, estimator.bubble
        assert isinstance(bubble, RubberBubble)  # as `Pipeline` sees to
        self._bubble = bubble
        self.flow_observer = FlowObserver(camera, self.mesh)
        edge = self.mesh.edge_length
        self._converged_m, self._reuse_m = CONVERGED_MOTION * edge, TANGENT_REUSE * edge
        self._large_m, self._max_step_m = LARGE_MOTION * edge, edge
        self._report = TractionReport(self.mesh, self._bubble.membrane)

    def estimate(
        self,
        flow: FlowField | None,  # of the colour image of the same moment
        gas_pressure_pa: float | None,  # measured absolute gas pressure
        estimate: Estimate,  # of the depth image
        reached: Start,  # that the estimator handed on with it
        start: TractionStart | None = None,  # of the frame before
    ) -> tuple[Traction, TractionStart | None]:
        """Traction of one frame; also what the next one starts from."""
        report = self._report
        if estimate.status == "no_contact":
            return report.untouched(estimate), None
        if estimate.status == "no_data":
            return report.nothing("no_data", estimate.reason), None
        if reached.measured is None:
            return report.nothing("not_converged", estimate.reason), None
        if flow is None or not len(flow.pixel):
            return self._alone(estimate, NO_FLOW if flow is None else flow.problem), None
        begin, support = self._begin(estimate, reached, start)
        if begin is None or not support.any():
            return report.nothing("not_converged", NO_CONTACT_SHAPE), None
        measured = self.flow_observer.measure(flow)
        if self.flow_observer.seen_share(measured, support) < _SEEN_SHARE:
            return self._alone(estimate, NO_TEXTURE), None
        gas = self._bubble.gas.measured_change(gas_pressure_pa)
        frame = _Frame(reached.measured, self._image_error_m(estimate), measured, gas)
        try:
            return self._solve(frame, begin, support, warm=start is not None)
        except (RuntimeError, np.linalg.LinAlgError):  # a singular tangent, or Hessian
            return report.nothing("not_converged", NOT_CONVERGED), None

    def _image_error_m(self, estimate: Estimate) -> np.ndarray:
        errors = self._estimator.observer.image_errors
        if estimate.image_errors is None:
            return np.zeros(len(errors))
        total: np.ndarray = errors @ estimate.image_errors
        return total

    def _alone(self, estimate: Estimate, reason: str) -> Traction:
        if estimate.trusted:
            return self._report.alone(estimate, reason)
        return self._report.nothing("not_converged", estimate.reason)

    def _begin(
        self, estimate: Estimate, reached: Start, start: TractionStart | None
    ) -> tuple[TractionStart | None, np.ndarray]:
        """Where to begin, and the support (n,) bool: depth's, and that of the frame before.

        Under much shear no frictionless shape looks like the image; the contact is then about
        where it was, or where depth looked for it.
        """
        there = reached.final_state
        nothing = np.zeros(len(self.mesh.nodes), bool)
        support = nothing if there is None else there.support
        if start is not None:
            before = start.pressure > 0.0
            near = support | before if estimate.trusted else grown(self.mesh.rings, before)
            support = near & ~self.mesh.rim
            pressure = np.where(support, start.pressure, 0.0)
            shear = np.where(support[:, None], start.shear, 0.0)
            return replace(start, pressure=pressure, shear=shear), support
        if there is None:
            return None, support
        rubber = reached.tangent
        if (
            not isinstance(rubber, LinearisedRubber)
            or np.abs(there.x - rubber.x).max() > self._reuse_m
        ):
            with_gas = there.gas if rubber is None or not rubber.with_gas else None
            rubber = self._bubble.linearised(there.x, there.pressure, with_gas)
        shear = np.zeros_like(there.x)
        return TractionStart(
            there.x, there.pressure, shear, there.gas, rubber, reached.noise, view=reached.view
        ), support

    # -- one frame ------------------------------------------------------------------------------

    def _solve(
        self, frame: _Frame, state: TractionStart, support: np.ndarray, *, warm: bool
    ) -> tuple[Traction, TractionStart | None]:
        """Gauss–Newton steps until the shape stands, each no longer than it helps."""
        nodes, begin = np.flatnonzero(support), state.x
        look = self._look(frame, state.x, state.view)
        for _ in range(_STEPS):
            rubber = self._rubber_at(state, frame.gas)
            before, wanted = state, self._wanted(frame, look, state, rubber, nodes)
            misfit = look.misfit(before)
            for share in _SHARES:
                state, balanced = self._moved(before, rubber, wanted, share, frame.gas)
                motion = state.x - before.x
                way = float(np.abs(motion).max())
                lasting = warm and float(np.abs(state.x - begin).max()) <= self._reuse_m
                found = balanced and wanted.solved.converged
                stands = found and way <= self._converged_m
                ahead = look if stands else self._look(frame, state.x, look.view)
                better = ahead.misfit(before) < misfit
                if stands or (found and lasting and better):
                    left = look.after(motion)
                    state = self._with_noise(left, state)
                    return self._report.solved(state, rubber, wanted.solved, nodes, left), state
                if balanced and better:
                    break
            look, state = ahead, self._with_noise(ahead, state)
        return self._report.nothing("not_converged", NOT_CONVERGED), None

    def _look(self, frame: _Frame, x: np.ndarray, last: ShapeRanges | None) -> Look:
        observer = self._estimator.observer
        view = observer.around(x, last)
        expected = view.model_m + frame.image_error_m
        observation = observer.weigh(frame.ranges, expected)
        flow = self.flow_observer.around(x, frame.flow.point)
        return Look(
            view,
            observation,
            observation.residual_m[view.block] - expected[view.block],
            flow,
            frame.flow.moved_px - flow.moved_px,
            frame.flow,
        )

    def _rubber_at(self, state: TractionStart, gas: float | None) -> LinearisedRubber:
        """A tangent taken close to a state: the last one, where it still serves."""
        last, with_gas = state.rubber, gas is None
        away = float(np.abs(state.x - last.x).max())
        if last.with_gas is with_gas and away <= self._reuse_m:
            return last
        return self._bubble.linearised(state.x, state.pressure, None if with_gas else state.gas)

    def _wanted(
        self,
        frame: _Frame,
        look: Look,
        state: TractionStart,
        rubber: LinearisedRubber,
        nodes: np.ndarray,
    ) -> _Wanted:
        """What would explain the frame, to first order."""
        estimator, gas = self._estimator, frame.gas
        tangents = rubber.tangents[nodes]
        square = np.maximum(np.einsum("ikj,ikj->ik", tangents, tangents), 1e-300)
        shear = np.einsum("ikj,ij->ik", tangents, state.shear[nodes]) / square
        present = np.zeros_like(state.x)
        present[nodes] = np.einsum("ik,ikj->ij", shear, tangents)
        inside = None if gas is None else state.gas
        left = self._bubble.residual(state.x, state.pressure, inside, present)
        columns = [-rubber.responses(nodes), rubber.tangential_responses(nodes)]
        if gas is not None:
            columns.append(rubber.bulge.reshape(-1, 1))
        problem = TractionProblem(
            np.hstack(columns),
            rubber.motion(-left),
            look.measurements(state),
            dense_part(estimator.smoothness, nodes),
            Unknowns(state.pressure[nodes], shear.ravel(), 0.0 if gas is None else state.gas - gas),
            None if gas is None else gas_sigma(self._bubble.gas, gas),
        )
        solved = problem.solve(self.options.friction)
        pressure, force = np.zeros_like(state.pressure), np.zeros_like(state.x)
        pressure[nodes] = solved.unknowns.pressure
        force[nodes] = np.einsum("ik,ikj->ij", solved.unknowns.shear.reshape(-1, 2), tangents)
        change = solved.unknowns.gas_error_pa if gas is None else gas + solved.unknowns.gas_error_pa
        return _Wanted(solved, pressure, present, force, change)

    def _moved(
        self,
        state: TractionStart,
        rubber: LinearisedRubber,
        wanted: _Wanted,
        share: float,
        gas: float | None,
    ) -> tuple[TractionStart, bool]:
        """A share of the way, and to equilibrium there; whether that was found close by."""
        motion = wanted.solved.motion
        share = min(share, self._max_step_m / max(float(np.abs(motion).max()), 1e-300))
        pressure = state.pressure + share * (wanted.pressure - state.pressure)
        shear = wanted.present + share * (wanted.shear - wanted.present)
        inside = None if gas is None else state.gas + share * (wanted.gas - state.gas)
        ahead = state.x + share * motion
        x, balanced, last = self._bubble.equilibrium(rubber, ahead, pressure, inside, shear)
        rubber = last if isinstance(last, LinearisedRubber) else rubber
        balanced = balanced and float(np.abs(x - ahead).max()) <= self._large_m
        if not balanced:
            x = ahead
        change = self._bubble.gas_at(x)[0] if inside is None else inside
        return TractionStart(
            x, pressure, shear, change, rubber, state.range_noise, state.flow_noise
        ), balanced

    def _with_noise(self, look: Look, state: TractionStart) -> TractionStart:
        """The state with the noise that a look leaves."""
        observer = self._estimator.observer
        ranges = observer.noise_factor(look.observation, look.view.block, look.range_error)
        flow = look.measured.noise_factor(look.flow_error)
        return replace(state, range_noise=ranges, flow_noise=flow, view=look.view)
