"""What a solved frame says of the contact: forces, torque, displacement, and how certain."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular

from bubbleviz.inverse.gauss_newton import MODEL_ERROR
from bubbleviz.inverse.linearised_rubber import LinearisedRubber
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.rubber_model.rubber_membrane import RubberMembrane
from bubbleviz.result import Estimate, Traction, TractionStatus
from bubbleviz.shear.traction_problem import SolvedTraction
from bubbleviz.shear.traction_state import Look, TractionStart

_ALL_UNKNOWN = np.full((6, 6), np.nan)


class TractionReport:
    """Makes tractions of solutions, and of frames without one.

    Parameters
    ----------
    mesh : MembraneMesh
        Reference surface.
    membrane : RubberMembrane
    """

    def __init__(self, mesh: MembraneMesh, membrane: RubberMembrane) -> None:
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
            raise ValueError("the estimate is not of the exact membrane")
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
