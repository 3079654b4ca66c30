"""How old a live frame is when its picture is on the screen."""

from __future__ import annotations

import time

from PySide6.QtCore import QObject

from bubbleviz.frames.frame import Frame
from bubbleviz.live.latency import LatencyMeter, LatencyReport
from bubbleviz.result import Result
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.view3d.render_view import View


class PictureAge(QObject):
    """Measures from stamp to picture; from the arrival where the robot has another clock."""

    def __init__(self, controller: Controller, view: View) -> None:
        super().__init__()
        self._shown: Frame | None = None
        self._meter = LatencyMeter()
        controller.opened.connect(self._on_opened)
        controller.shown.connect(self._on_shown)
        view.rendered.connect(self._on_rendered)

    def begin(self, pictures: int = 600) -> None:
        """Forget what was measured; from now on the last so many pictures count."""
        self._shown, self._meter = None, LatencyMeter(pictures)

    def _on_opened(self, _: object) -> None:
        self.begin()

    @property
    def ages_s(self) -> list[float]:
        """Age of each picture that counts, s."""
        return self._meter.ages_s

    def report(self) -> LatencyReport | None:
        """Ages of the last pictures; None where none was live."""
        return self._meter.report()

    def _on_shown(self, result: Result) -> None:
        fresh = result.frame.arrival_ns > 0 and result.frame is not self._shown
        self._shown = result.frame if fresh else None

    def _on_rendered(self) -> None:
        frame, self._shown = self._shown, None
        if frame is not None:
            self._meter.add(frame, time.time_ns())
