"""The object of the pose panel in the 3-D view."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import QObject

from bubbleviz.result import Pose
from bubbleviz.rigid_object import RigidObject
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.pose.pose_session import PoseSession
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.render_view import View
from bubbleviz_ui.view3d.scene import Scene

ABOVE_M = 0.02
"""Height of an object without a pose above the origin of B, in addition to its own height."""


class PoseOverlay(QObject):
    """Draws the object of a session and its fit.

    Without the Pose panel only where it was found in the frame shown.
    """

    def __init__(self, view: View, scene: Scene, session: PoseSession, state: SessionState) -> None:
        super().__init__(session)
        self._view, self._scene, self._session, self._state = view, scene, session, state
        self._obj: RigidObject | None = None
        self._start: np.ndarray | None = None
        self._pose: Pose | None = None
        self._at_start = True  # No pose was found since the initial pose was set
        session.changed.connect(self._on_changed)
        state.follow({"panels"}, self._on_changed)

    def _on_changed(self) -> None:
        session, scene = self._session, self._scene
        pose, start = session.pose, session.start
        if session.obj is not self._obj:
            self._obj = session.obj
            scene.object.set_object(session.obj)
        started = start is not self._start and start is not None
        self._at_start = started or pose is None or (self._at_start and pose is self._pose)
        self._start, self._pose = start, pose
        found = session.here and pose is not None and pose.status == "ok"
        if not (found or "pose" in self._state.settings.panels):
            pose = None
            scene.object.put(None)
        elif self._at_start:
            self._draw_start(start)
        elif pose is not None:
            scene.object.show_pose(pose, session.stage, touched=session.touched)
        scene.fit.show_pose(pose)
        self._view.refresh()

    def _draw_start(self, start: np.ndarray | None) -> None:
        """Draw the object at its initial pose, or above the membrane if there is none."""
        if start is None and self._obj is not None:
            above = np.eye(4)
            above[2, 3] = ABOVE_M + float(np.ptp(self._obj.vertices[:, 2]))
            self._scene.object.put(above, theme.NEUTRAL)
        else:
            self._scene.object.put(start)
