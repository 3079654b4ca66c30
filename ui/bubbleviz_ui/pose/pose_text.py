"""A pose in words and numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bubbleviz.pose.observability import open_axes
from bubbleviz.result import Pose, Stage
from bubbleviz_ui.model.units import NOTHING, Units

if TYPE_CHECKING:
    from bubbleviz_ui.pose.pose_session import PoseSession

STATES = {
    "ok": "found",
    "lost": "lost; the last good pose is kept",
    "no_contact": "nothing touches the membrane",
    "few_points": "the patch has fewer points than a pose needs",
    "no_data": "no estimate of the membrane to trust",
}


def pose_words(session: PoseSession, units: Units) -> dict[str, str]:
    """Texts of the panel by name."""
    pose = session.pose
    texts = dict.fromkeys(("state", "fit", "first", "open", "spread", "time"), NOTHING)
    if session.busy:
        texts["state"] = "fitting…"
    elif session.obj is None:
        texts["state"] = "choose an object"
    elif pose is None:
        texts["state"] = "not fitted yet"
    else:
        texts["state"] = STATES[pose.status]
    if pose is None or pose.stage_one is None or pose.stage_two is None:
        return texts
    texts["fit"], texts["first"] = _stage(pose.stage_two, units), _stage(pose.stage_one, units)
    texts["open"] = open_words(pose)
    deviation = np.sqrt(np.diag(pose.covariance))
    degrees = np.degrees(np.linalg.norm(deviation[3:]))
    texts["spread"] = f"{units.length.text(float(np.linalg.norm(deviation[:3])))}, {degrees:.1f}°"
    ms = pose.stage_one.ms, pose.stage_two.ms
    texts["time"] = f"{units.duration.text(ms[0])} + {units.duration.text(ms[1])}"
    return texts


def _stage(stage: Stage, units: Units) -> str:
    return (
        f"{100 * stage.fitness:.0f} % · rmse {units.length.text(stage.rmse_m)} · "
        f"{stage.correspondences} points"
    )


def open_words(pose: Pose) -> str:
    """Which directions the contact does not determine."""
    open_ = pose.motions[:, ~pose.determined]
    if not open_.size:
        return "nothing: all six directions are"
    shifts, turns = (len(axes) for axes in open_axes(open_))
    parts = []
    if shifts:
        parts.append("shift along 1 direction" if shifts == 1 else f"shift along {shifts}")
    if turns:
        parts.append("turn about 1 axis" if turns == 1 else f"turn about {turns} axes")
    return " and ".join(parts)
