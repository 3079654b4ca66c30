"""Place under the mouse, in an image or in the 3-D view; shown in both."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import QObject, Signal

from bubbleviz.diagnostics import Pixel, Probe, Probed
from bubbleviz.result import Result
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.engine.solver import Opened


class Hover(QObject):
    """Probes the result under the mouse; updated when the mouse moves or the frame changes."""

    changed = Signal(object)  # A `Probed`, or None when the mouse is outside

    def __init__(self, controller: Controller) -> None:
        super().__init__()
        self._controller = controller
        self._probe: Probe | None = None
        self._target: Pixel | np.ndarray | None = None
        self.place: Probed | None = None
        controller.opened.connect(self._on_opened)
        controller.shown.connect(self._on_shown)

    def point_at(self, target: Pixel | np.ndarray | None) -> None:
        """The mouse is at a pixel, at a point (3,) in B, m, or outside."""
        self._target = target
        self._find(self._controller.result)

    def _find(self, result: Result) -> None:
        place, target = None, self._target
        if self._probe is not None and target is not None:
            if isinstance(target, tuple):
                place = self._probe.at_pixel(target, result)
            else:
                place = self._probe.at_point(target, result)
        if place is not None or self.place is not None:
            self.place = place
            self.changed.emit(place)

    def _on_opened(self, opened: Opened) -> None:
        self._probe = Probe(opened.camera, opened.mesh)
        self.point_at(None)

    def _on_shown(self, result: Result) -> None:
        if self._target is not None:
            self._find(result)
