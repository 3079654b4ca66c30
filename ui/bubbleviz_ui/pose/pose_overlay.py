"""The object in the 3-D view, and the box widget that moves it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from PySide6.QtCore import QObject
from vtkmodules.vtkCommonTransforms import vtkTransform

from bubbleviz.result import Pose
from bubbleviz.rigid_object import RigidObject
from bubbleviz_ui.pose.pose_panel import PosePanel
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.render_view import View

if TYPE_CHECKING:
    from bubbleviz_ui.view3d.scene import Scene


# A box widget that moves and rotates the object in the view.


class Gizmo:
    """VTK's box widget: faces rotate the object, the ball in the middle moves it.

    `moved`: Called with T_B_O (4, 4) while the box is dragged.
    """

    def __init__(self, view: View, moved: Callable[[np.ndarray], None]) -> None:
        self._view, self._moved = view, moved
        self._widget: Any = None
        self._tag = 0

    @property
    def on(self) -> bool:
        """Whether the box is shown."""
        return self._widget is not None

    def show(self, obj: RigidObject, T_B_O: np.ndarray) -> None:
        """Show the box around the object at a pose (4, 4)."""
        from vtkmodules.vtkInteractionWidgets import vtkBoxWidget  # not at start

        self.hide()
        self._widget = vtkBoxWidget()
        self._widget.SetInteractor(self._view.iren.interactor)
        self._widget.SetCurrentRenderer(self._view.renderer)
        self._widget.SetDefaultRenderer(self._view.renderer)
        self._widget.SetPlaceFactor(1.1)
        self._widget.ScalingEnabledOff()
        low, high = obj.vertices.min(axis=0), obj.vertices.max(axis=0)
        self._widget.PlaceWidget([e for pair in zip(low, high, strict=True) for e in pair])
        self._widget.SetTransform(_transform(T_B_O))
        self._tag = self._widget.AddObserver("InteractionEvent", self._on_drag)
        self._widget.On()
        self._view.refresh()

    def hide(self) -> None:
        """Remove the box."""
        if self._widget is None:
            return
        self._widget.RemoveObserver(self._tag)
        self._widget.Off()
        self._widget.SetInteractor(None)
        self._widget = None
        self._view.refresh()

    def _on_drag(self, *_: Any) -> None:
        transform = vtkTransform()
        self._widget.GetTransform(transform)
        matrix = transform.GetMatrix()
        T = np.array([[matrix.GetElement(i, j) for j in range(4)] for i in range(4)])
        turn = np.linalg.svd(T[:3, :3])  # the widget's rotation drifts
        T[:3, :3] = turn.U @ turn.Vh
        self._moved(T)


def _transform(T: np.ndarray) -> Any:
    transform = vtkTransform()
    transform.SetMatrix(T.ravel().tolist())
    return transform


ABOVE_M = 0.02
"""Height of an object without a pose above the origin of B, in addition to its own height."""


class PoseOverlay(QObject):
    """Draws the object of the pose panel and its fit in the view."""

    def __init__(self, view: View, scene: Scene, panel: PosePanel) -> None:
        super().__init__(panel)
        self._view, self._scene, self._panel = view, scene, panel
        self._obj: RigidObject | None = None
        self._start: np.ndarray | None = None
        self._pose: Pose | None = None
        self._stage = panel.session.stage
        self.gizmo = Gizmo(view, panel.session.set_start)
        panel.session.changed.connect(self._on_changed)
        panel.move_in_view.toggled.connect(self._on_gizmo)

    def _on_changed(self) -> None:
        session, layer = self._panel.session, self._scene.object
        if session.obj is not self._obj:
            self._obj = session.obj
            self.gizmo.hide()
            self._panel.move_in_view.setChecked(False)
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
            self._scene.object.put(self._above(self._obj), theme.NEUTRAL)
        else:
            self._scene.object.put(start)

    def _on_gizmo(self, on: bool) -> None:
        session = self._panel.session
        if not on or session.obj is None:
            self.gizmo.hide()
            return
        place = self._scene.object.T_B_O
        T = self._above(session.obj) if place is None else place
        session.set_start(T)
        self.gizmo.show(session.obj, T)

    def _above(self, obj: RigidObject) -> np.ndarray:
        T = np.eye(4)
        T[2, 3] = ABOVE_M + float(np.ptp(obj.vertices[:, 2]))
        return T
