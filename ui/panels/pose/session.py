"""What the pose panel shows and changes: the object, its start, and the poses found so far."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from PySide6.QtCore import QObject, Signal

from bubbleviz.objects import RigidObject
from bubbleviz.pose.export import PoseRow, write_poses
from bubbleviz.result import Pose, Result
from ui.controller import Controller
from ui.requests import Failed, Followed, FollowRequest, Opened

FileUnit = Literal["m", "mm"]


class PoseSession(QObject):
    """The object that is looked for.

    Attributes
    ----------
    changed : Signal
        Another object, start or pose, or a fit began or ended.
    object_name : str or None
        Preset or file; None for none.
    obj : RigidObject or None
        What the solver thread made of it.
    start : (4, 4) array or None
        T_B_O to begin at; None to search.
    pose : Pose or None
        Of the frame that is shown, or the last one there was.
    busy : bool
        A one-shot fit runs.
    rows : dict
        `PoseRow` by frame: every pose since the object was chosen.
    """

    changed = Signal()

    def __init__(self, controller: Controller) -> None:
        super().__init__()
        self._controller, self._state = controller, controller.state
        self.object_name: str | None = None
        self.unit: FileUnit | None = None
        self.obj: RigidObject | None = None
        self.start: np.ndarray | None = None
        self.pose: Pose | None = None
        self.busy = False
        self.rows: dict[int, PoseRow] = {}
        controller.opened.connect(self._on_opened)
        controller.followed.connect(self._on_followed)
        controller.failed.connect(self._on_failed)
        controller.shown.connect(self._on_shown)

    def choose(self, name: str | None, unit: FileUnit | None = None) -> None:
        """Look for another object, or for none."""
        self.object_name, self.unit = name, unit
        self.start = None
        self._forget()
        self._follow(fit=False)

    def set_start(self, T_B_O: np.ndarray | None) -> None:
        """Begin at a pose (4, 4), or search."""
        self.start = T_B_O
        if self._state.choices.pose_track:
            self._follow(fit=False)
        self.changed.emit()

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
        self._state.choose(pose_track=on)
        self.changed.emit()

    def reset(self) -> None:
        """Forget every pose and stop tracking; object and start stay."""
        self._state.choose(pose_track=False)
        self._forget()
        self._follow(fit=False)

    def export(self, path: Path, form: Literal["csv", "tum"]) -> int:
        """Write the poses found so far; count of lines.

        Raises
        ------
        InputError
            The file exists or cannot be written.
        """
        return write_poses(path, [self.rows[k] for k in sorted(self.rows)], form)

    def _forget(self) -> None:
        self.pose, self.rows = None, {}
        self.changed.emit()

    def _follow(self, *, fit: bool) -> None:
        self._controller.follow(self.object_name, self.unit, self.start, fit=fit)
        self.changed.emit()

    def _on_opened(self, opened: Opened) -> None:
        self.pose, self.rows, self.busy = None, {}, False
        if self.object_name is not None:
            self._follow(fit=False)
        self.changed.emit()

    _loaded: tuple[str | None, FileUnit | None] = (None, None)

    def _on_followed(self, followed: Followed) -> None:
        request = followed.request
        asked = (request.object_name, request.unit)
        if self.obj is None or asked != self._loaded:  # the same one stays the same
            self.obj, self._loaded = followed.obj, asked
        if request.fit is not None:
            self.busy = False
        self.changed.emit()

    def _on_failed(self, failed: Failed) -> None:
        if isinstance(failed.request, FollowRequest):
            self.busy = False
            if failed.request.object_name is not None and failed.request.fit is None:
                self.choose(None)
            self.changed.emit()

    def _on_shown(self, result: Result) -> None:
        if result.pose is None:
            return
        self.pose = result.pose
        self.rows[result.frame.index] = PoseRow.of(result)
        self.changed.emit()
