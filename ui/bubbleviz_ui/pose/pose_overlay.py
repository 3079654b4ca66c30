"""The object of the pose panel in the 3-D view."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import QObject

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
        session.changed.connect(self._draw)
        state.follow({"panels"}, self._draw)

    def _draw(self) -> None:
        session, scene = self._session, self._scene
        pose, start = session.pose, session.start
        scene.object.set_object(session.obj)
        found = session.here and pose is not None and pose.status == "ok"
        if not (found or "pose" in self._state.settings.panels):
            pose = None
            scene.object.put(None)
        elif session.at_start and start is None and session.obj is not None:
            above = np.eye(4)
            above[2, 3] = ABOVE_M + float(np.ptp(session.obj.vertices[:, 2]))
            scene.object.put(above, theme.NEUTRAL)
        elif session.at_start:
            scene.object.put(start)
        elif pose is not None:
            stage = self._state.settings.pose_stage
            scene.object.show_pose(pose, stage, touched=session.touched)
        scene.fit.show_pose(pose)
        self._view.refresh()
