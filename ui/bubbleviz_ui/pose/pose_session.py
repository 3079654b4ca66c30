"""State of the pose panel: object, initial pose, and the poses found so far."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
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
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.engine.solver import Opened
from bubbleviz_ui.engine.worker import Failed
from bubbleviz_ui.model.settings import POSE_SETTINGS
from bubbleviz_ui.model.undo import UndoRecorder
from bubbleviz_ui.model.units import DASH, Units

# Texts about a pose.


NUMBERS = {
    "state": "Status", "place": "x, y, z", "turn": "rx, ry, rz", "fit": "Final fit",
    "first": "First stage", "open": "Not determined", "spread": "Std. deviation", "time": "Time",
}  # fmt: skip
"""Titles of the texts by name."""
STATES = {
    "ok": "found",
    "lost": "lost; the last good pose is kept",
    "no_contact": "no contact",
    "few_points": "the patch has too few points for a pose; press deeper, or choose another frame",
    "no_data": "no trusted estimate of the membrane",
}


def pose_texts(session: PoseSession, units: Units) -> dict[str, str]:
    """Texts of the panel by name."""
    pose = session.pose
    texts = dict.fromkeys(NUMBERS, DASH)
    if session.busy:
        texts["state"] = "fitting…"
    elif session.obj is None:
        texts["state"] = session.problem or "choose an object"
    elif pose is None:
        texts["state"] = "not fitted"
    else:
        elsewhere = "" if session.here else f"; of frame {session.pose_frame}"
        texts["state"] = status_text(pose, session.touched) + elsewhere
    if has_pose(pose):
        texts["place"], texts["turn"] = _place(pose.T_B_O, units), _turn(pose.T_B_O)
    if pose is not None and pose.rejected is not None:
        texts["fit"] = f"best: {_stage(pose.rejected, units)}"
    if pose is None or pose.stage_one is None or pose.stage_two is None:
        return texts
    texts["fit"], texts["first"] = _stage(pose.stage_two, units), _stage(pose.stage_one, units)
    texts["open"] = undetermined_text(pose)
    deviation = np.sqrt(np.diag(pose.covariance))
    degrees = np.degrees(np.linalg.norm(deviation[3:]))
    texts["spread"] = f"{units.length.text(float(np.linalg.norm(deviation[:3])))}, {degrees:.1f}°"
    ms = pose.stage_one.ms, pose.stage_two.ms
    texts["time"] = f"{units.duration.text(ms[0])} + {units.duration.text(ms[1])}"
    return texts


def status_text(pose: Pose, touched: bool) -> str:
    """Status, and the number of directions not determined by the contact, if there is one."""
    left = int(np.count_nonzero(~pose.determined)) if pose.status == "ok" else 0
    if pose.status == "lost" and not touched:
        return "no contact" + ("; the last good pose is kept" if has_pose(pose) else "")
    if pose.status == "lost" and not has_pose(pose):
        return "no pose tried so far fits; choose a frame pressed deeper, or another object"
    if pose.status == "ok" and pose.contradicted:
        return "doubtful: contact and object are farther apart than errors explain; another object?"
    return STATES[pose.status] + (f"; {left} of 6 directions not determined" if left else "")


def has_pose(pose: Pose | None) -> TypeGuard[Pose]:
    """Whether there is a pose, possibly of an earlier frame."""
    return pose is not None and bool(np.isfinite(pose.T_B_O).all())


def pose_report(pose: Pose, touched: bool) -> str:
    """T_B_O as text with units, for other programs."""
    numbers = pose_numbers(pose.T_B_O)
    return "\n".join(
        [
            f"T_B_O, object to bubble frame: {status_text(pose, touched)}",
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
        f"fitness {100 * stage.fitness:.0f} % · rmse {units.length.text(stage.rmse_m)} · "
        f"{count_of(stage.correspondences, 'point')}"
    )


def undetermined_text(pose: Pose) -> str:
    """Directions not determined by the contact."""
    open_ = pose.motions[:, ~pose.determined]
    if not open_.size:
        return "none (all 6 DoF observable)"
    shifts, turns = (len(axes) for axes in open_axes(open_))
    parts = []
    if shifts:
        parts.append(f"translation along {count_of(shifts, 'direction')}")
    if turns:
        parts.append("rotation about 1 axis" if turns == 1 else f"rotation about {turns} axes")
    return " and ".join(parts)


FileUnit = Literal["m", "mm"]


@dataclass(frozen=True)
class _Poses:
    """Poses of an open source, for undo."""

    session: object
    pose: Pose | None = None
    rows: Mapping[int, PoseRow] = field(default_factory=dict)
    track: bool = False


class PoseSession(QObject):
    """The object to register, stored in `Settings` for undo and session files, and its poses."""

    changed = Signal()  # Object, initial pose or pose changed, or a fit began or ended

    def __init__(self, controller: Controller, undo: UndoRecorder) -> None:
        super().__init__()
        self._undo = undo
        self._controller, self._state = controller, controller.state
        self.obj: RigidObject | None = None  # Loaded in the solver thread
        self.start: np.ndarray | None = None  # (4, 4) initial pose T_B_O; None: global search
        self._loaded: tuple[str | None, FileUnit | None] = (None, None)
        self.pose: Pose | None = None  # Of the frame shown, or the last one found
        self.touched = True  # Whether anything touches in the frame of `pose`
        self.pose_frame: int | None = None
        self.here = False  # Whether that is the frame shown
        self.busy = False  # A single fit is running
        self.problem = ""  # Why the chosen object was rejected
        self._start_set = False  # Since the last pose was found
        self.rows: dict[int, PoseRow] = {}  # All poses of the object, by frame
        # other poses (4, 4) that fit as well as the one found by search; index of that frame
        self.others: list[np.ndarray] = []
        self._searched: int | None = None
        controller.opened.connect(self._on_opened)
        controller.shown.connect(self._on_shown)
        self._state.source_changed.connect(self._on_source)
        self._state.settings_changed.connect(self._on_settings)

    @property
    def object_name(self) -> str | None:
        """Preset or file; None: no object."""
        return self._state.settings.pose_object

    @property
    def at_start(self) -> bool:
        """Whether no pose was found since the initial pose was set."""
        return self._start_set or self.pose is None

    def choose(self, name: str | None) -> None:
        """Register another object, or none; the same one is loaded again."""
        before = self._state.settings
        track = name is not None and before.pose_track
        self._state.change(pose_object=name, pose_start=None, pose_track=track)
        if self._state.settings is before:
            self._register_object()

    def set_start(self, T_B_O: np.ndarray | None) -> None:
        """Set the initial pose (4, 4); None: global search."""
        self._state.change(pose_start=None if T_B_O is None else pose_numbers(T_B_O))

    def fit_once(self) -> None:
        """Fit the object to the frame at the cursor, from the initial pose."""
        self._state.set_playing(False)
        self.busy = True
        self._set_object(fit=True)

    def fit_other(self) -> None:
        """Fit from the next of the poses that fit as well; the present one becomes the last."""
        other, *rest = self.others
        if has_pose(self.pose):
            rest.append(self.pose.T_B_O)
        self.set_start(other)
        self.others = rest
        self.fit_once()

    def track(self, on: bool) -> None:
        """Start or stop tracking the object from frame to frame."""
        if on and self.obj is not None:
            self._set_object(fit=False)
        self._state.change(pose_track=on)
        self.changed.emit()

    @property
    def object_patch(self) -> ObjectPatch | None:
        """Patch by the object of the frame shown, if requested."""
        return self._controller.result.object_patch

    def reset(self) -> None:
        """Discard all poses and stop tracking, as an undo step; object and initial pose stay."""
        session, track = self._controller.client.session, self._state.settings.pose_track
        if self.pose is not None or self.rows or track:
            found = _Poses(session, self.pose, self.rows, track)
            self._undo.push("reset pose", self._use, found, _Poses(session))

    def _use(self, found: _Poses) -> None:
        """Restore poses and tracking, unless another source is open."""
        if found.session is not self._controller.client.session:
            return
        pose, self.rows, self.others = found.pose, dict(found.rows), []
        self.pose, self._start_set, start = pose, False, self.start
        if found.track and has_pose(pose):
            start = pose.T_B_O
        settings = self._state.settings
        self._request(settings.pose_object, settings.pose_unit, start)
        self._state.change(pose_track=found.track)
        self.changed.emit()

    def export(self, path: Path, form: Literal["csv", "tum"]) -> int:
        """Write the poses found so far; returns the number of lines.

        Raises InputError: The file exists or cannot be written.
        """
        return write_poses(path, [self.rows[k] for k in sorted(self.rows)], form)

    def _forget(self) -> None:
        self.pose, self.rows, self.others = None, {}, []
        self.changed.emit()

    def _register_object(self) -> None:
        self.problem = ""
        self._forget()
        self._set_object(fit=False)

    def _set_object(self, *, fit: bool) -> None:
        settings = self._state.settings
        self._request(settings.pose_object, settings.pose_unit, self.start, fit=fit)
        self.changed.emit()

    def _request(
        self,
        name: str | None,
        unit: FileUnit | None = None,
        start: np.ndarray | None = None,
        *,
        fit: bool = False,
    ) -> None:
        if start is None:  # is searched
            self.others = []
        take = partial(self._take_object, (name, unit), fit)
        self._controller.set_object(
            name, unit, start, take, partial(self._reject, name, fit), fit=fit
        )

    def _on_opened(self, opened: Opened) -> None:
        self.busy = False
        self._forget()

    def _on_source(self) -> None:
        if self.object_name is not None:
            self._set_object(fit=self._state.settings.pose_track)

    def _on_settings(self, names: frozenset[str]) -> None:
        if "pose_start" in names:
            self._apply_start()
        if names & POSE_SETTINGS:
            self._register_object()
        elif "pose_start" in names and self._state.settings.pose_track:
            self._set_object(fit=False)
        elif names & {"pose_start", "pose_stage"}:
            self.changed.emit()

    def _apply_start(self) -> None:
        numbers = self._state.settings.pose_start
        try:
            self.start = None if numbers is None else pose_matrix(np.array(numbers))
        except InputError:  # of a session file edited by hand
            self.start = None
        self._start_set |= self.start is not None

    def _take_object(
        self, requested: tuple[str | None, FileUnit | None], fitted: bool, obj: RigidObject | None
    ) -> None:
        if self.obj is None or requested != self._loaded:  # keep the identity of the same object
            self.obj, self._loaded = obj, requested
            self.pose, self.rows, self.others = None, {}, []  # of the former object
        if fitted:
            self.busy = False
        self.changed.emit()

    def _reject(self, name: str | None, fitted: bool, failed: Failed) -> None:
        """Register no object, and stop tracking; a rejected one stays selected, for undo."""
        self.busy = False
        if name == self.object_name and not fitted:
            self.problem = failed.message
            self._request(None)
            with self._undo.unrecorded():
                self._state.change(pose_track=False)
        self.changed.emit()

    def _on_shown(self, result: Result) -> None:
        index, new = result.frame.index, result.pose is not None and result.pose is not self.pose
        stale = bool(self.others) and index != self._searched
        if stale:
            self.others = []
        if result.pose is not None and new:
            self.pose, self.pose_frame, self._start_set = result.pose, index, False
            self.touched = result.estimate is None or result.estimate.status != "no_contact"
            if len(result.pose.others):
                self.others, self._searched = [*result.pose.others], index
            self.rows[index] = pose_row(result)
        before, self.here = self.here, index == self.pose_frame
        if new or stale or before != self.here:
            self.changed.emit()
