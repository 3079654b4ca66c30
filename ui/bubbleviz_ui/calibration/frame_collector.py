"""Collecting frames of a live source until there are enough, or γ0 is known well enough."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject, Signal

from bubbleviz.calibration import Settings, Step
from bubbleviz.progress import Progress
from bubbleviz.recordings import Frame, HeldFrames
from bubbleviz.result import Result
from bubbleviz.sensor import Sensor
from bubbleviz_ui.engine.worker import Failed, Worker

if TYPE_CHECKING:
    from bubbleviz.calibration import Quantity


FIRST_LOOK, LOOK_EVERY = 10, 10
"""Frames before γ0 is first estimated, and between estimates."""


class Collector(QObject):
    """Takes frames as they are shown."""

    changed = Signal()  # another frame, another estimate, or collecting began or ended
    # the `HeldFrames`: enough of them, or γ0's interval is as small as wanted
    complete = Signal(object)

    def __init__(self) -> None:
        super().__init__()
        self.frames: list[Frame] = []
        self.tension: Quantity | None = None  # γ0 so far, N/m
        self.active = False
        self.message = ""
        self._count, self._target, self._only_untouched = 0, 0.0, True
        self._fits = False  # the sensor in use has explained a frame without contact
        self.name, self._sensor = "", None  # type: tuple[str, Sensor | None]
        self._looked_at = 0
        self._worker = Worker("calibration")

    def start(
        self,
        name: str,  # of the source
        sensor: Sensor,  # to start from
        count: int,  # frames to collect at most
        target: float | None,  # half of γ0's 95 % interval over γ0 at which to stop before
        only_untouched: bool,  # leave out frames in which the sensor in use sees a contact
    ) -> None:
        self.name, self._sensor = name, sensor
        self._count, self._target, self._only_untouched = count, target or 0.0, only_untouched
        self._fits = False
        self.frames, self.tension, self._looked_at, self.message = [], None, 0, ""
        self.active = True
        self.changed.emit()

    def take(self, result: Result) -> None:
        """Take the frame of a result, unless it is touched or was taken before."""
        if not self.active:
            return
        status = result.estimate.status if result.estimate is not None else None
        self._fits = self._fits or status == "no_contact"
        doubtful = self._fits and status in ("implausible", "not_converged")
        if status == "no_data" or (self._only_untouched and (status == "ok" or doubtful)):
            return
        frame = result.frame
        if any(frame.depth_m is kept.depth_m for kept in self.frames):
            return  # the same noise again tells nothing new
        self.frames.append(frame)
        if len(self.frames) >= self._count:
            self.finish()
            return
        self._look()
        self.changed.emit()

    def finish(self) -> None:
        """Stop and use these frames."""
        frames = self.frames
        self.cancel()
        if frames:
            self.complete.emit(HeldFrames(frames, self.name))

    def cancel(self) -> None:
        self._worker.cancel()
        self.active = False
        self.frames = []
        self.changed.emit()

    def close(self) -> None:
        self._worker.cancel()
        self._worker.close()

    def _look(self) -> None:
        many = len(self.frames)
        due = many >= max(FIRST_LOOK, self._looked_at + LOOK_EVERY)
        if not due or not self._target or self._worker.busy or self._sensor is None:
            return
        self._looked_at = many
        frames = HeldFrames(self.frames, self.name)
        function = partial(_estimate, frames, self._sensor, self._worker.progress)
        self._worker.submit(function, self._on_estimate, self._on_failed)

    def _on_failed(self, failed: Failed) -> None:
        self.message, self.tension = failed.message, None
        self.changed.emit()

    def _on_estimate(self, tension: Quantity | None) -> None:
        self.message, self.tension = "", tension
        if self.tension is not None and (
            self.tension.half_width <= self._target * self.tension.value
        ):
            self.finish()
        self.changed.emit()


def _estimate(frames: HeldFrames, sensor: Sensor, progress: Progress) -> Quantity | None:
    from bubbleviz.calibration import Workbench  # the window starts without

    nodes = sensor.membrane.nodes
    settings = Settings(last_step=Step.TENSION, ranges=((0, len(frames)),), nodes=nodes)
    found = Workbench(frames, sensor).work(settings, progress).found
    # more frames do not narrow what comes of the gauge pressure
    return found.tension.of_shape if found is not None else None
