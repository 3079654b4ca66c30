"""A pose in words and numbers."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, TypeGuard

import numpy as np

from bubbleviz.files.pose_reader import angles_of_pose, pose_numbers
from bubbleviz.pose.observability import open_axes
from bubbleviz.result import Pose, Stage
from bubbleviz.wording import count_of
from bubbleviz_ui.model.units import NOTHING, Units

if TYPE_CHECKING:
    from bubbleviz_ui.pose.pose_session import PoseSession

NUMBERS = {
    "state": "Status", "place": "x, y, z", "turn": "rx, ry, rz", "fit": "Both stages",
    "first": "Stage one", "open": "Not determined", "spread": "Deviation", "time": "Time",
}  # fmt: skip
"""Titles of the texts by name."""
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
    texts = dict.fromkeys(NUMBERS, NOTHING)
    if session.busy:
        texts["state"] = "fitting…"
    elif session.obj is None:
        texts["state"] = "choose an object"
    elif pose is None:
        texts["state"] = "not fitted yet"
    else:
        texts["state"] = state_words(pose)
    if known_pose(pose):
        texts["place"], texts["turn"] = _place(pose.T_B_O, units), _turn(pose.T_B_O)
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


def state_words(pose: Pose) -> str:
    """What became of it, and whether the contact leaves a direction open."""
    left = int(np.count_nonzero(~pose.determined)) if pose.status == "ok" else 0
    if pose.status == "lost" and not known_pose(pose):
        return "not found yet"
    return STATES[pose.status] + (f"; {left} of 6 directions not determined" if left else "")


def known_pose(pose: Pose | None) -> TypeGuard[Pose]:
    """Whether there is one, be it of an earlier frame."""
    return pose is not None and bool(np.isfinite(pose.T_B_O).all())


def copied_pose(pose: Pose) -> str:
    """T_B_O as lines of text with units, for other programs."""
    numbers = pose_numbers(pose.T_B_O)
    return "\n".join(
        [
            f"T_B_O, object to bubble frame: {state_words(pose)}",
            f"position x y z, m: {_digits(numbers[:3])}",
            f"quaternion x y z w, no unit: {_digits(numbers[3:])}",
            "matrix 4×4, translation in m:",
            *(_digits(row) for row in pose.T_B_O),
        ]
    )


def _digits(numbers: Iterable[float]) -> str:
    return " ".join(f"{round(float(number), 9) + 0.0:.9f}" for number in numbers)


def _place(T_B_O: np.ndarray, units: Units) -> str:
    return ", ".join(units.length.text(float(place)) for place in T_B_O[:3, 3])


def _turn(T_B_O: np.ndarray) -> str:
    angles = np.degrees(angles_of_pose(T_B_O)).round(1) + 0.0  # no "-0.0"
    return ", ".join(f"{angle:.1f}°" for angle in angles)


def _stage(stage: Stage, units: Units) -> str:
    return (
        f"{100 * stage.fitness:.0f} % · rmse {units.length.text(stage.rmse_m)} · "
        f"{count_of(stage.correspondences, 'point')}"
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
