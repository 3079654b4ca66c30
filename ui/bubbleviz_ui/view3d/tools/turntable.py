"""The scene turning by itself."""

from __future__ import annotations

import time

from PySide6.QtCore import QObject, Qt, QTimer

from bubbleviz_ui.view3d.render_view import View

EVERY_MS = 33  # 30 pictures a second
DEGREES_A_SECOND = 30.0  # once round in 12 s


class Turntable(QObject):
    """Turns the view about what is up, at a steady speed whatever a picture takes."""

    def __init__(self, view: View) -> None:
        super().__init__(view)
        self._view = view
        self._last_s = 0.0
        self._timer = QTimer(self, timerType=Qt.TimerType.PreciseTimer, interval=EVERY_MS)
        self._timer.timeout.connect(self._turn)

    @property
    def turning(self) -> bool:
        """Whether it turns."""
        return self._timer.isActive()

    def set_turning(self, turning: bool) -> None:
        """Start or stop."""
        self._last_s = time.perf_counter()
        self._timer.start() if turning else self._timer.stop()

    def _turn(self) -> None:
        now = time.perf_counter()
        self._view.camera.Azimuth(DEGREES_A_SECOND * (now - self._last_s))
        self._last_s = now
        self._view.refresh()
