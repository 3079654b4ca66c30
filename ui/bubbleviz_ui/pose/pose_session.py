"""What the pose panel shows and changes: the object, its start, and the poses found so far."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, TypeGuard

import numpy as np
from PySide6.QtCore import QObject, Signal

from bubbleviz.errors import InputError
from bubbleviz.files import angles_of_pose, pose_matrix, pose_numbers
from bubbleviz.output import PoseRow, pose_row, write_poses
from bubbleviz.pose import open_axes
from bubbleviz.result import ObjectPatch, Pose, Result, Stage
from bubbleviz.rigid_object import RigidObject
from bubbleviz.wording import count_of
from bubbleviz_ui.engine.controller import Controller, ObjectChange
from bubbleviz_ui.engine.solver import Opened
from bubbleviz_ui.engine.worker import Failed
from bubbleviz_ui.model.settings import POSE_SETTINGS
from bubbleviz_ui.model.undo import UndoRecorder
from bubbleviz_ui.model.units import DASH, Units

# A pose in words and numbers.


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
    "no_data": "no trusted estimate of the membrane",
}


def pose_words(session: PoseSession, units: Units) -> dict[str, str]:
    """Texts of the panel by name."""
    pose = session.pose
    texts = dict.fromkeys(NUMBERS, DASH)
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
        return "none (all 6 DoF observable)"
    shifts, turns = (len(axes) for axes in open_axes(open_))
    parts = []
    if shifts:
        parts.append("shift along 1 direction" if shifts == 1 else f"shift along {shifts}")
    if turns:
        parts.append("turn about 1 axis" if turns == 1 else f"turn about {turns} axes")
    return " and ".join(parts)


FileUnit = Literal["m", "mm"]


@dataclass(frozen=True)
class _Found:
    """What there is of an object in a session of the solver, for undo."""

    session: object
    pose: Pose | None = None
    rows: Mapping[int, PoseRow] = field(default_factory=dict)
    track: bool = False


class PoseSession(QObject):
    """The object that is looked for: the one of `Settings`, so that undo and sessions know it."""

    changed = Signal()  # Another object, start or pose, or a fit began or ended

    def __init__(self, controller: Controller, undo: UndoRecorder) -> None:
        super().__init__()
        self._undo = undo
        self._controller, self._state = controller, controller.state
        self.obj: RigidObject | None = None  # What the solver thread made of it
        # (4, 4) array or None: T_B_O to begin at; None to search
        self.start: np.ndarray | None = None
        self._loaded: tuple[str | None, FileUnit | None] = (None, None)
        self.pose: Pose | None = None  # Of the frame that is shown, or the last one there was
        self._shown: Pose | None = None
        self.busy = False  # A one-shot fit runs
        # `PoseRow` by frame: every pose since the object was chosen
        self.rows: dict[int, PoseRow] = {}
        controller.opened.connect(self._on_opened)
        controller.object_changed.connect(self._on_object_changed)
        controller.failed.connect(self._on_failed)
        controller.shown.connect(self._on_shown)
        self._state.source_changed.connect(self._on_source)
        self._state.settings_changed.connect(self._on_settings)

    @property
    def object_name(self) -> str | None:
        """Preset or file; None for none."""
        return self._state.settings.pose_object

    def choose(self, name: str | None) -> None:
        """Look for another object, or for none; the same one is read again."""
        before = self._state.settings
        self._state.change(pose_object=name, pose_start=None)
        if self._state.settings is before:
            self._look_for_it()

    def set_start(self, T_B_O: np.ndarray | None) -> None:
        """Begin at a pose (4, 4), or search."""
        self._state.change(pose_start=None if T_B_O is None else pose_numbers(T_B_O))

    def fit_once(self) -> None:
        """Fit the frame at the cursor from the start."""
        if self.obj is None or self.busy:
            return
        self._state.set_playing(False)
        self.busy = True
        self._follow(fit=True)

    def track(self, on: bool) -> None:
        """Follow the object from frame to frame, from the start on."""
        if on and self.obj is not None:
            self._follow(fit=False)
        self._state.change(pose_track=on)
        self.changed.emit()

    @property
    def object_patch(self) -> ObjectPatch | None:
        """Of the frame that is shown, where it was asked for."""
        result = self._controller.result
        return None if result is None else result.object_patch

    def reset(self) -> None:
        """Forget every pose and stop tracking, as a step for undo; object and start stay."""
        session, track = self._controller.client.session, self._state.settings.pose_track
        if self.pose is not None or self.rows or track:
            found = _Found(session, self.pose, self.rows, track)
            self._undo.push("reset pose", self._use, found, _Found(session))

    def _use(self, found: _Found) -> None:
        """Show these poses, and track on from the last; nothing where another source is open."""
        if found.session is not self._controller.client.session:
            return
        pose, self.rows = found.pose, dict(found.rows)
        self.pose, start = pose, self.start
        if found.track and known_pose(pose):
            start = pose.T_B_O
        settings = self._state.settings
        self._controller.set_object(settings.pose_object, settings.pose_unit, start, fit=False)
        self._state.change(pose_track=found.track)
        self.changed.emit()  # last: the choice has the last result drawn once more, with its pose

    def export(self, path: Path, form: Literal["csv", "tum"]) -> int:
        """Write the poses found so far; count of lines.

        Raises InputError: The file exists or cannot be written.
        """
        return write_poses(path, [self.rows[k] for k in sorted(self.rows)], form)

    def _forget(self) -> None:
        self.pose, self.rows = None, {}
        self.changed.emit()

    def _look_for_it(self) -> None:
        self._forget()
        self._follow(fit=False)

    def _follow(self, *, fit: bool) -> None:
        settings = self._state.settings
        self._controller.set_object(settings.pose_object, settings.pose_unit, self.start, fit=fit)
        self.changed.emit()

    def _on_opened(self, opened: Opened) -> None:
        self.pose, self.rows, self.busy = None, {}, False
        self.changed.emit()

    def _on_source(self) -> None:
        if self.object_name is not None:
            self._follow(fit=self._state.settings.pose_track)

    def _on_settings(self, names: frozenset[str]) -> None:
        if "pose_start" in names:
            self._take_start()
        if names & POSE_SETTINGS:
            self._look_for_it()
        elif "pose_start" in names:
            self._follow(fit=False) if self._state.settings.pose_track else self.changed.emit()

    def _take_start(self) -> None:
        numbers = self._state.settings.pose_start
        try:
            self.start = None if numbers is None else pose_matrix(np.array(numbers))
        except InputError:  # of a session that somebody has edited
            self.start = None

    def _on_object_changed(self, followed: ObjectChange) -> None:
        asked = (followed.object_name, followed.unit)
        if self.obj is None or asked != self._loaded:  # the same one stays the same
            self.obj, self._loaded = followed.obj, asked
        if followed.fitted:
            self.busy = False
        self.changed.emit()

    def _on_failed(self, failed: Failed) -> None:
        """An object that cannot be used stays chosen, for undo and for the next source."""
        request = failed.request
        if isinstance(request, ObjectChange):
            self.busy = False
            if request.object_name == self.object_name and not request.fitted:
                self._controller.set_object(None, None, None, fit=False)
            self.changed.emit()

    def _on_shown(self, result: Result) -> None:
        if result.pose is None or result.pose is self._shown:
            return  # a frame that is settled keeps its pose, though it was reset meanwhile
        self.pose = self._shown = result.pose
        self.rows[result.frame.index] = pose_row(result)
        self.changed.emit()
