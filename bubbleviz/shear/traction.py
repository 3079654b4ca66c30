"""Contact traction, normal and tangential, at the nodes of an estimate on the exact membrane."""

from __future__ import annotations

import numpy as np

from bubbleviz.inverse import RubberBubble
from bubbleviz.result import Result, Traction, TractionStatus

NO_REFERENCE = "no contact-free reference images"
NO_TEXTURE = "no flow on most of the contact: no texture there, or it could not be matched"
CONTRADICTS = (
    "the colour image contradicts the depth image, as one of another moment does; set the colour "
    "delay (--colour-delay; window: Sensor panel)"
)
NO_FRICTION = "the expected coefficient of friction is 0"


def traction_of(bubble: RubberBubble, result: Result, friction: float) -> Traction:
    """Traction of a result, whose estimate used its optical flow, with this expected friction."""
    status, reason = _status(result, friction)
    estimate, _ = result.solution
    x = bubble.mesh.deformed(estimate.motion_m)
    vectors, moved = bubble.area_vectors(x), x - bubble.mesh.nodes
    areas = np.linalg.norm(vectors, axis=1, keepdims=True)
    n = vectors / areas
    along = moved - np.einsum("ij,ij->i", moved, n)[:, None] * n
    force, slide = estimate.nodal_force_n, estimate.friction_n
    if force is None or slide is None:  # not solved
        force = slide = np.full_like(x, np.nan)
    return Traction(status, (force - slide) / areas, slide / areas, along, reason)


def _status(result: Result, friction: float) -> tuple[TractionStatus, str]:
    (estimate, _), frame, flow = result.solution, result.frame, result.flow
    if estimate.status == "no_contact":
        return "no_contact", ""
    if not estimate.trusted:
        return "no_data" if estimate.status == "no_data" else "not_converged", estimate.reason
    if estimate.flow is not None:
        return "ok", ""
    if not friction:
        return "depth_alone", NO_FRICTION
    if estimate.flow_contradicts:
        return "depth_alone", CONTRADICTS
    if flow is None:
        return "depth_alone", frame.no_colour if frame.find_colour is None else NO_REFERENCE
    return "depth_alone", flow.problem or NO_TEXTURE
