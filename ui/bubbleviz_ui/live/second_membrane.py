"""The membrane of another recording next to that of the open one, at the same time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from PySide6.QtCore import QObject

from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.live.sensor_group import APART
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.render_view import View
from bubbleviz_ui.view3d.scene import OtherSensor, Scene

if TYPE_CHECKING:
    from bubbleviz_ui.panels.other_recording import AlignedRun


class SecondMembrane(QObject):
    """Draws the membrane of the other run next to the first one, at the time of the frame shown."""

    def __init__(self, controller: Controller, scene: Scene, view: View) -> None:
        super().__init__()
        self._controller, self._scene, self._view = controller, scene, view
        self._drawing: OtherSensor | None = None
        self._aligned: AlignedRun | None = None
        controller.shown.connect(self._show)
        controller.state.settings_changed.connect(self._show)

    def take(self, aligned: AlignedRun | None) -> None:
        """Draw another run, or none."""
        if aligned is None and self._aligned is None:
            return
        self._aligned = aligned
        if self._drawing is None:
            self._drawing = self._scene.add_sensor()
        if aligned is None:
            self._drawing.remove()
            self._scene.place()
        else:
            model, T = aligned.run.model, np.eye(4)
            T[0, 3] = APART * np.ptp(model.mesh.nodes[:, 0])
            self._drawing.put(model.sensor, model.mesh, T, theme.COMPARED[1])
            self._scene.place(colour=theme.COMPARED[0])
            self._show()
        self._scene.reset_view()

    def _show(self, _: object = None) -> None:
        shown, aligned = self._controller.result, self._aligned
        if aligned is None or self._drawing is None:
            return
        k = int(np.abs(aligned.times_s - shown.frame.time_s).argmin())
        result, settings = aligned.run[k].result, self._controller.state.settings
        self._drawing.show(result, settings, aligned.history)
        self._view.refresh()
