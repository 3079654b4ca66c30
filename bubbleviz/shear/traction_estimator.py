"""Contact traction, normal and tangential, on the exact membrane, from depth and optical flow."""

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


# State of a solution, and its residuals.


@dataclass(frozen=True)
class TractionStart:
    """Solution of a frame, and the warm start of the next one."""

    x: np.ndarray  # (n, 3), shape, m
    pressure: np.ndarray  # (n,), p_c, Pa
    shear: np.ndarray  # (n, 3), forces along the membrane, N
    gas: float  # p_v, Pa
    rubber: LinearisedRubber  # last tangent used
    # range_noise, flow_noise: noise factors, σ of the residual over that of the noise
    range_noise: float = 1.0
    flow_noise: float = 1.0
    # depth camera model at the last shape at which it was computed
    view: ShapeRanges | None = None


class Linearisation(NamedTuple):
    """Residuals of ranges and flow at a shape, with their models linearised there."""

    view: ShapeRanges
    observation: Observation  # of the ranges
    range_error: np.ndarray  # (k,), measured less modelled, of the blocks of `view`, m
    flow: ShapeFlow
    flow_error: np.ndarray  # (j, 2), measured less modelled, pixels
    measured: MeasuredFlow

    def measurements(self, state: TractionStart) -> Measurements:
        """Ranges and flow, weighted by the noise factors of a state."""
        by_flow = np.repeat(1.0 / (state.flow_noise * self.measured.sigma_px) ** 2, 2)
        by_range = self.observation.weight[self.view.block] / state.range_noise**2
        return Measurements(
            sparse.vstack([self.view.jacobian, self.flow.jacobian], format="csr"),
            np.concatenate([self.range_error, self.flow_error.ravel()]),
            np.concatenate([by_range, by_flow]),
        )

    def misfit(self, state: TractionStart) -> float:
        """Mean square residual in standard deviations, at the noise factors of a state."""
        by_range = self.observation.weight[self.view.block] / state.range_noise**2
        by_flow = 1.0 / (state.flow_noise * self.measured.sigma_px) ** 2
        flow = float(by_flow @ (self.flow_error**2).sum(axis=1)) / (2 * len(by_flow))
        return float(by_range @ self.range_error**2) / len(by_range) + flow

    def after(self, motion: np.ndarray) -> Linearisation:
        """Residuals after a small motion (n, 3), to first order."""
        flow = (self.flow.jacobian @ motion.ravel()).reshape(-1, 2)
        return self._replace(
            range_error=self.range_error - self.view.jacobian @ motion.ravel(),
            flow_error=self.flow_error - flow,
        )


# Result of a frame: forces, torque, displacement, and their uncertainty.


_ALL_UNKNOWN = np.full((6, 6), np.nan)


class TractionReport:
    """Builds the traction of a frame, solved or not."""

    def __init__(
        self,
        mesh: MembraneMesh,  # reference surface
        membrane: RubberMembrane,
    ) -> None:
        self._mesh, self._membrane = mesh, membrane

    def failed(self, status: TractionStatus, reason: str) -> Traction:
        """Traction of a frame that was not solved."""
        nodal = np.full((len(self._mesh.nodes), 3), np.nan)
        center = np.full(3, np.nan)
        return Traction(
            status, nodal, nodal, nodal, nodal, nodal, nodal, center, _ALL_UNKNOWN, reason=reason
        )

    def no_contact(self, estimate: Estimate) -> Traction:
        """Traction of a frame without contact."""
        x = self._positions(estimate)
        vectors = self._membrane.volume_gradient(x)
        return self._of("no_contact", x, np.zeros_like(x), vectors)

    def by_depth_only(self, estimate: Estimate, reason: str) -> Traction:
        """Traction by the depth estimate, without flow."""
        x = self._positions(estimate)
        vectors = self._membrane.volume_gradient(x)
        force = estimate.nodal_force_n
        assert force is not None  # as of every estimate with the exact membrane
        return self._of("depth_alone", x, force, vectors, reason=reason)

    def solved(
        self,
        state: TractionStart,
        rubber: LinearisedRubber,
        solved: SolvedTraction,
        nodes: np.ndarray,
        residuals: Linearisation,
    ) -> Traction:
        """Traction of a solution on support `nodes` (s,), with its tangent and its residuals."""
        vectors = self._membrane.volume_gradient(state.x)
        force = state.shear - state.pressure[:, None] * vectors
        center = _center(state.x, force, vectors)
        squares = np.einsum("ij,ij->i", residuals.flow_error, residuals.flow_error)
        wrench = self._wrench_columns(state.x, rubber, vectors, nodes, center)[:, solved.active]
        deviation = solve_triangular(solved.factor[0], wrench.T, lower=True, check_finite=False)
        by_material = wrench @ solved.response(rubber.by_material)
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
_SHARES = (1.0, 0.5, 0.25)  # of a step, tried in turn until the misfit decreases
_MIN_FLOW_SHARE = 0.5
"""Least share of the nodes in contact next to which flow was measured."""

NO_FLOW = "no optical flow: the frame has no colour image, or there are no contact-free ones yet"
NO_TEXTURE = "no flow on most of the contact: no texture there, or it could not be matched"
NO_CONTACT_SHAPE = "no contact in the depth image"
NOT_CONVERGED = "no equilibrium with tangential traction was found; the force is by depth alone"


@dataclass(frozen=True)
class TractionOptions:
    """Options of the traction estimator.

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
    """Measurements of a frame."""

    ranges: Measured
    image_error_m: np.ndarray  # (B,), of the ranges of the blocks, by the depth estimate
    flow: MeasuredFlow
    gas: float | None


class _Target(NamedTuple):
    """Linearised solution of a step; `present` is the shear before it, on the same tangents."""

    solved: SolvedTraction
    pressure: np.ndarray
    present: np.ndarray
    shear: np.ndarray
    gas: float


class TractionEstimator:
    """Solves for shape, pressure and tangential traction frame by frame, after the estimate.

    Outside the support of the depth estimate the membrane is in equilibrium by construction. Ranges
    and flow are weighted by their noise factors, estimated from the residuals.
    """

    def __init__(
        self,
        estimator: Estimator,  # of the frames' depth
        camera: DepthCamera,  # whose images the flow is of
        options: TractionOptions | None = None,
    ) -> None:
        self.mesh, self.options = estimator.mesh, options or TractionOptions()
        self._estimator, bubble = estimator, estimator.bubble
        assert isinstance(bubble, RubberBubble)  # guaranteed by `Pipeline`
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
        depth: Start,  # final state of that estimate
        start: TractionStart | None = None,  # of the previous frame
    ) -> tuple[Traction, TractionStart | None]:
        """Traction of one frame, and the warm start of the next one."""
        report = self._report
        if estimate.status == "no_contact":
            return report.no_contact(estimate), None
        if estimate.status == "no_data":
            return report.failed("no_data", estimate.reason), None
        if depth.measured is None:
            return report.failed("not_converged", estimate.reason), None
        if flow is None or not len(flow.pixel):
            return self._without_flow(estimate, NO_FLOW if flow is None else flow.problem), None
        initial, support = self._initial(estimate, depth, start)
        if initial is None or not support.any():
            return report.failed("not_converged", estimate.reason or NO_CONTACT_SHAPE), None
        measured = self.flow_observer.measure(flow)
        if self.flow_observer.flow_share(measured, support) < _MIN_FLOW_SHARE:
            return self._without_flow(estimate, NO_TEXTURE), None
        gas = self._bubble.gas.measured_change(gas_pressure_pa)
        frame = _Frame(depth.measured, self._image_error_m(estimate), measured, gas)
        try:
            return self._solve(frame, initial, support, warm=start is not None)
        except (RuntimeError, np.linalg.LinAlgError):  # a singular tangent, or Hessian
            return report.failed("not_converged", NOT_CONVERGED), None

    def _image_error_m(self, estimate: Estimate) -> np.ndarray:
        errors = self._estimator.observer.image_errors
        if estimate.image_errors is None:
            return np.zeros(len(errors))
        total: np.ndarray = errors @ estimate.image_errors
        return total

    def _without_flow(self, estimate: Estimate, reason: str) -> Traction:
        if estimate.trusted:
            return self._report.by_depth_only(estimate, reason)
        return self._report.failed("not_converged", estimate.reason)

    def _initial(
        self, estimate: Estimate, depth: Start, start: TractionStart | None
    ) -> tuple[TractionStart | None, np.ndarray]:
        """Initial state, and the support (n,) bool: of the depth estimate and the previous frame.

        Under large shear the depth estimate may fail; the support is then that of the previous
        frame, grown, or of the final state of the failed estimate.
        """
        there = depth.final_state
        empty = np.zeros(len(self.mesh.nodes), bool)
        support = empty if there is None else there.support
        if start is not None:
            before = start.pressure > 0.0
            near = support | before if estimate.trusted else grown(self.mesh.rings, before)
            support = near & ~self.mesh.rim
            pressure = np.where(support, start.pressure, 0.0)
            shear = np.where(support[:, None], start.shear, 0.0)
            return replace(start, pressure=pressure, shear=shear), support
        if there is None:
            return None, support
        rubber = depth.tangent
        if (
            not isinstance(rubber, LinearisedRubber)
            or np.abs(there.x - rubber.x).max() > self._reuse_m
        ):
            with_gas = there.gas if rubber is None or not rubber.with_gas else None
            rubber = self._bubble.linearised(there.x, there.pressure, with_gas)
        shear = np.zeros_like(there.x)
        return TractionStart(
            there.x, there.pressure, shear, there.gas, rubber, depth.noise, view=depth.view
        ), support

    # -- one frame ------------------------------------------------------------------------------

    def _solve(
        self, frame: _Frame, state: TractionStart, support: np.ndarray, *, warm: bool
    ) -> tuple[Traction, TractionStart | None]:
        """Gauss–Newton steps to convergence, shortened until they reduce the misfit."""
        nodes, initial = np.flatnonzero(support), state.x
        here = self._observe(frame, state.x, state.view)
        for _ in range(_STEPS):
            rubber = self._rubber_at(state, frame.gas)
            before, target = state, self._target(frame, here, state, rubber, nodes)
            misfit = here.misfit(before)
            for share in _SHARES:
                state, balanced = self._advance(before, rubber, target, share, frame.gas)
                motion = state.x - before.x
                length = float(np.abs(motion).max())
                near_start = warm and float(np.abs(state.x - initial).max()) <= self._reuse_m
                solved = balanced and target.solved.converged
                converged = solved and length <= self._converged_m
                following = here if converged else self._observe(frame, state.x, here.view)
                better = following.misfit(before) < misfit
                if converged or (solved and near_start and better):
                    residuals = here.after(motion)
                    state = self._with_noise(residuals, state)
                    return self._report.solved(
                        state, rubber, target.solved, nodes, residuals
                    ), state
                if balanced and better:
                    break
            here, state = following, self._with_noise(following, state)
        return self._report.failed("not_converged", NOT_CONVERGED), None

    def _observe(self, frame: _Frame, x: np.ndarray, last: ShapeRanges | None) -> Linearisation:
        observer = self._estimator.observer
        view = observer.around(x, last)
        expected = view.model_m + frame.image_error_m
        observation = observer.weigh(frame.ranges, expected)
        flow = self.flow_observer.around(x, frame.flow.point)
        return Linearisation(
            view,
            observation,
            observation.residual_m[view.block] - expected[view.block],
            flow,
            frame.flow.moved_px - flow.moved_px,
            frame.flow,
        )

    def _rubber_at(self, state: TractionStart, gas: float | None) -> LinearisedRubber:
        """Tangent near a state: the last one where it is near enough."""
        last, with_gas = state.rubber, gas is None
        distance = float(np.abs(state.x - last.x).max())
        if last.with_gas is with_gas and distance <= self._reuse_m:
            return last
        return self._bubble.linearised(state.x, state.pressure, None if with_gas else state.gas)

    def _target(
        self,
        frame: _Frame,
        here: Linearisation,
        state: TractionStart,
        rubber: LinearisedRubber,
        nodes: np.ndarray,
    ) -> _Target:
        """Solution of the linearised problem."""
        estimator, gas = self._estimator, frame.gas
        tangents = rubber.tangents[nodes]
        square = np.maximum(np.einsum("ikj,ikj->ik", tangents, tangents), 1e-300)
        shear = np.einsum("ikj,ij->ik", tangents, state.shear[nodes]) / square
        present = np.zeros_like(state.x)
        present[nodes] = np.einsum("ik,ikj->ij", shear, tangents)
        inside = None if gas is None else state.gas
        residual = self._bubble.residual(state.x, state.pressure, inside, present)
        columns = [-rubber.responses(nodes), rubber.tangential_responses(nodes)]
        if gas is not None:
            columns.append(rubber.bulge.reshape(-1, 1))
        problem = TractionProblem(
            np.hstack(columns),
            rubber.motion(-residual),
            here.measurements(state),
            dense_part(estimator.smoothness, nodes),
            Unknowns(state.pressure[nodes], shear.ravel(), 0.0 if gas is None else state.gas - gas),
            None if gas is None else gas_sigma(self._bubble.gas, gas),
        )
        solved = problem.solve(self.options.friction)
        pressure, force = np.zeros_like(state.pressure), np.zeros_like(state.x)
        pressure[nodes] = solved.unknowns.pressure
        force[nodes] = np.einsum("ik,ikj->ij", solved.unknowns.shear.reshape(-1, 2), tangents)
        change = solved.unknowns.gas_error_pa if gas is None else gas + solved.unknowns.gas_error_pa
        return _Target(solved, pressure, present, force, change)

    def _advance(
        self,
        state: TractionStart,
        rubber: LinearisedRubber,
        target: _Target,
        share: float,
        gas: float | None,
    ) -> tuple[TractionStart, bool]:
        """State after a share of a step, and whether it is an equilibrium near by."""
        motion = target.solved.motion
        share = min(share, self._max_step_m / max(float(np.abs(motion).max()), 1e-300))
        pressure = state.pressure + share * (target.pressure - state.pressure)
        shear = target.present + share * (target.shear - target.present)
        inside = None if gas is None else state.gas + share * (target.gas - state.gas)
        linear = state.x + share * motion
        x, balanced, last = self._bubble.equilibrium(rubber, linear, pressure, inside, shear)
        rubber = last if isinstance(last, LinearisedRubber) else rubber
        balanced = balanced and float(np.abs(x - linear).max()) <= self._large_m
        if not balanced:
            x = linear
        change = self._bubble.gas_at(x)[0] if inside is None else inside
        return TractionStart(
            x, pressure, shear, change, rubber, state.range_noise, state.flow_noise
        ), balanced

    def _with_noise(self, residuals: Linearisation, state: TractionStart) -> TractionStart:
        """The state with the noise factors by its residuals."""
        observer = self._estimator.observer
        view = residuals.view
        ranges = observer.noise_factor(residuals.observation, view.block, residuals.range_error)
        flow = residuals.measured.noise_factor(residuals.flow_error)
        return replace(state, range_noise=ranges, flow_noise=flow, view=view)
