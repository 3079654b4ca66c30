"""Collection of live frames until there are enough, or γ0 is precise enough."""

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


FIRST_ESTIMATE, ESTIMATE_EVERY = 10, 10
"""Frames before the first estimate of γ0, and between estimates."""


class Collector(QObject):
    """Collects the frames that are shown."""

    changed = Signal()  # another frame or estimate, or collecting began or ended
    complete = Signal(object)  # the `HeldFrames`

    def __init__(self) -> None:
        super().__init__()
        self.frames: list[Frame] = []
        self.tension: Quantity | None = None  # γ0 so far, N/m
        self.active = False
        self.message = ""
        self._count, self._target, self._only_contact_free = 0, 0.0, True
        self._fits = False  # the sensor in use has matched a contact-free frame
        self.name, self._sensor = "", None  # type: tuple[str, Sensor | None]
        self._estimated_at = 0
        self._worker = Worker("calibration")

    def start(
        self,
        name: str,  # of the source
        sensor: Sensor,  # nominal sensor
        count: int,  # largest number of frames
        target: float | None,  # stop earlier when half of γ0's 95 % interval over γ0 is below
        only_contact_free: bool,  # skip frames in which contact is detected with the sensor in use
    ) -> None:
        self.name, self._sensor = name, sensor
        self._count, self._target, self._only_contact_free = count, target or 0.0, only_contact_free
        self._fits = False
        self._begin()
        self.active = True
        self.changed.emit()

    def take(self, result: Result) -> None:
        """Collect the frame of a result, unless it has contact or was collected already."""
        if not self.active:
            return
        status = result.estimate.status if result.estimate is not None else None
        if status == "no_contact" and not self._fits:
            self._fits = True
            if self._only_contact_free:
                self._begin()  # frames before were implausible, perhaps of a deep press
        doubtful = self._fits and status in ("implausible", "not_converged")
        if status == "no_data" or (self._only_contact_free and (status == "ok" or doubtful)):
            return
        frame = result.frame
        if any(frame.depth_m is kept.depth_m for kept in self.frames):
            return  # the same image, shown again
        self.frames.append(frame)
        if len(self.frames) >= self._count:
            self.finish()
            return
        self._estimate_if_due()
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

    def _begin(self) -> None:
        self._worker.cancel()
        self.frames, self.tension, self._estimated_at, self.message = [], None, 0, ""

    def _estimate_if_due(self) -> None:
        many = len(self.frames)
        due = many >= max(FIRST_ESTIMATE, self._estimated_at + ESTIMATE_EVERY)
        if not due or not self._target or self._worker.busy or self._sensor is None:
            return
        self._estimated_at = many
        frames = HeldFrames(self.frames, self.name)
        function = partial(_estimate, frames, self._sensor, self._worker.progress)
        self._worker.submit(function, self._on_estimate, self._on_failed)

    def _on_failed(self, failed: Failed) -> None:
        self.message, self.tension = failed.message, None
        self.changed.emit()

    def _on_estimate(self, tension: Quantity) -> None:
        self.message, self.tension = "", tension
        if tension.half_width <= self._target * tension.value:
            self.finish()
        self.changed.emit()


def _estimate(frames: HeldFrames, sensor: Sensor, progress: Progress) -> Quantity:
    from bubbleviz.calibration import Workbench  # not at start

    nodes = sensor.membrane.nodes
    settings = Settings(last_step=Step.TENSION, ranges=((0, len(frames)),), nodes=nodes)
    # more frames do not reduce the contribution of the gauge pressure
    return Workbench(frames, sensor).work(settings, progress).tension_by_shape
