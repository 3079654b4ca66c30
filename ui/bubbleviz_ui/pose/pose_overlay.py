"""The object of the pose panel in the 3-D view."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import QObject

from bubbleviz.result import Pose
from bubbleviz.rigid_object import RigidObject
from bubbleviz_ui.pose.pose_session import PoseSession
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.render_view import View
from bubbleviz_ui.view3d.scene import Scene

ABOVE_M = 0.02
"""Height of an object without a pose above the origin of B, in addition to its own height."""


class PoseOverlay(QObject):
    """Draws the object and its fit where a session has changed them last."""

    def __init__(self, view: View, scene: Scene, session: PoseSession) -> None:
        super().__init__(session)
        self._view, self._scene, self._session = view, scene, session
        self._obj: RigidObject | None = None
        self._start: np.ndarray | None = None
        self._pose: Pose | None = None
        self._stage = session.stage
        session.changed.connect(self._on_changed)

    def _on_changed(self) -> None:
        session, layer = self._session, self._scene.object
        if session.obj is not self._obj:
            self._obj = session.obj
            layer.set_object(session.obj)
        moved = session.pose is not self._pose
        if (session.start is not self._start and session.start is not None) or session.pose is None:
            self._draw_start(session.start)
        elif moved or session.stage != self._stage:
            layer.show_pose(session.pose, session.stage)
        if moved:
            self._scene.fit.show_pose(session.pose)
        self._start, self._pose, self._stage = session.start, session.pose, session.stage
        self._view.refresh()

    def _draw_start(self, start: np.ndarray | None) -> None:
        """Draw the object at its initial pose, or above the membrane if there is none."""
        if start is None and self._obj is not None:
            above = np.eye(4)
            above[2, 3] = ABOVE_M + float(np.ptp(self._obj.vertices[:, 2]))
            self._scene.object.put(above, theme.NEUTRAL)
        else:
            self._scene.object.put(start)
