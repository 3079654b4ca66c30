"""A box around the object with which it is moved and turned in the view."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from vtkmodules.vtkCommonTransforms import vtkTransform

from bubbleviz.rigid_object import RigidObject
from bubbleviz_ui.view3d.render_view import View


class Gizmo:
    """VTK's box widget: faces turn it, the ball in the middle moves it. GUI thread only.

    Parameters
    ----------
    view : View
    moved : callable
        Called with T_B_O (4, 4) while the box is dragged.
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
        """Put the box around the object at a pose (4, 4)."""
        from vtkmodules.vtkInteractionWidgets import vtkBoxWidget  # 0.1 s later than the window

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
        """Take the box away and let go of it."""
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
        turn = np.linalg.svd(T[:3, :3])  # the widget's numbers drift
        T[:3, :3] = turn.U @ turn.Vh
        self._moved(T)


def _transform(T: np.ndarray) -> Any:
    transform = vtkTransform()
    transform.SetMatrix(T.ravel().tolist())
    return transform
