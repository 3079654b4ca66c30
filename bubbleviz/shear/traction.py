"""Contact traction, normal and tangential, at the nodes of an estimate on the exact membrane."""

from __future__ import annotations

import numpy as np

from bubbleviz.camera import FlowField
from bubbleviz.inverse import RubberBubble
from bubbleviz.result import Estimate, Traction, TractionStatus, wrench_about

NO_FLOW = "the frame has no colour image, or there are no contact-free ones yet"
NO_TEXTURE = "no flow on most of the contact: no texture there, or it could not be matched"
CONTRADICTS = (
    "the colour image contradicts the depth image, as one of another moment does; see "
    "--colour-delay"
)
NO_FRICTION = "the expected coefficient of friction is 0"

_ALL_UNKNOWN = np.full((6, 6), np.nan)


def traction_of(
    bubble: RubberBubble, estimate: Estimate, flow: FlowField | None, friction: float
) -> Traction:
    """Traction of an estimate that used this optical flow, if any, with this expected friction.

    Without flow of the contact, friction is known by depth alone: two slides and a spin.
    """
    if estimate.status == "no_contact":
        return _of(bubble, "no_contact", estimate)
    if not estimate.trusted:
        status: TractionStatus = "no_data" if estimate.status == "no_data" else "not_converged"
        return _unknown(len(bubble.mesh.nodes), status, estimate.reason)
    if estimate.flow is None:
        reason = NO_FLOW if flow is None else flow.problem or NO_TEXTURE
        reason = CONTRADICTS if estimate.flow_contradicts else reason
        reason = reason if friction else NO_FRICTION
        return _of(bubble, "depth_alone", estimate, reason)
    return _of(bubble, "ok", estimate)


def _unknown(nodes: int, status: TractionStatus, reason: str) -> Traction:
    """Traction of a frame that was not solved."""
    nodal, center = np.full((nodes, 3), np.nan), np.full(3, np.nan)
    return Traction(
        status, nodal, nodal, nodal, nodal, nodal, nodal, center, _ALL_UNKNOWN, reason=reason
    )


def _of(
    bubble: RubberBubble, status: TractionStatus, estimate: Estimate, reason: str = ""
) -> Traction:
    x, force = bubble.mesh.deformed(estimate.motion_m), estimate.nodal_force_n
    assert force is not None  # as of every estimate with the exact membrane
    vectors = bubble.area_vectors(x)
    areas = np.linalg.norm(vectors, axis=1, keepdims=True)
    n, moved = vectors / areas, x - bubble.mesh.nodes
    normal = np.einsum("ij,ij->i", force, n)[:, None] * n
    tangential = force - normal
    if estimate.friction_n is None or not estimate.friction_n.any():
        tangential = np.zeros_like(force)  # not by rounding
    along = np.einsum("ij,ij->i", moved, n)[:, None] * n
    center, covariance = _center(x, normal), _ALL_UNKNOWN
    fit = estimate.flow
    if status != "no_contact" and estimate.wrench_covariance is not None:
        about = wrench_about(center)
        covariance = about @ estimate.wrench_covariance @ about.T
    return Traction(
        status,
        force,
        normal,
        tangential,
        force / areas,
        x,
        moved - along,
        center,
        covariance,
        np.nan if fit is None else fit.displacement_sigma_m,
        np.nan if fit is None else fit.rms_px,
        reason,
    )


def _center(x: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Centre of the normal forces (n, 3), (3,), m; NaN where there are none."""
    load = np.linalg.norm(normal, axis=1)
    return load @ x / load.sum() if load.any() else np.full(3, np.nan)
