"""What the mouse points at, in an image or in 3-D: one place, shown in both."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import QObject, Signal

from bubbleviz.diagnostics import Pixel, Probe, Probed
from bubbleviz.result import Result
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.engine.solver import Opened


class Hover(QObject):
    """Follows the mouse, and the frames while it stands still."""

    changed = Signal(object)  # A `Probed`, or None when the mouse is elsewhere

    def __init__(self, controller: Controller) -> None:
        super().__init__()
        self._controller = controller
        self._probe: Probe | None = None
        self._held: Pixel | np.ndarray | None = None
        self.place: Probed | None = None
        controller.opened.connect(self._on_opened)
        controller.shown.connect(self._on_shown)

    def at_pixel(self, row: int, column: int) -> None:
        """Point at a pixel."""
        self._hold((row, column))

    def at_point(self, point_m: np.ndarray) -> None:
        """Point at a place (3,) in B."""
        self._hold(point_m)

    def leave(self) -> None:
        """Point at nothing."""
        self._hold(None)

    def _hold(self, held: Pixel | np.ndarray | None) -> None:
        self._held = held
        self._find(self._controller.result)

    def _find(self, result: Result | None) -> None:
        place, held = None, self._held
        if self._probe is not None and result is not None and held is not None:
            if isinstance(held, tuple):
                place = self._probe.at_pixel(held, result)
            else:
                place = self._probe.at_point(held, result)
        if place is not None or self.place is not None:
            self.place = place
            self.changed.emit(place)

    def _on_opened(self, opened: Opened) -> None:
        self._probe = Probe(opened.camera, opened.mesh)
        self.leave()

    def _on_shown(self, result: Result) -> None:
        if self._held is not None:
            self._find(result)
