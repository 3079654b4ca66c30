"""Calibration session: settings with undo, results computed in a thread."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from PySide6.QtCore import QObject, Signal

from bubbleviz.calibration import Identification, Settings, Step
from bubbleviz.progress import Progress, part_of
from bubbleviz.recordings import FrameSource, HeldFrames, TimeAxis
from bubbleviz.sensor import Sensor
from bubbleviz.wording import count_of
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.engine.solver import Opened, OpenRequest
from bubbleviz_ui.engine.source import NO_SOURCE, Source
from bubbleviz_ui.engine.worker import Failed, Worker
from bubbleviz_ui.model.messages import CALIBRATION
from bubbleviz_ui.model.undo import UndoRecorder, UndoStep

if TYPE_CHECKING:
    from bubbleviz.calibration import SensorComparison, Workbench


# Results of the calibration thread: an identification and its images.

IMAGES_AT = 0.95
"""Progress at which the images are computed."""


@dataclass(frozen=True)
class Work:
    """Input of a calibration; undo restores an older one."""

    settings: Settings = field(default_factory=Settings)
    collected: HeldFrames | None = None  # frames of a live source; None: frames of the recording


@dataclass(frozen=True)
class Answer:
    """Results of a calibration."""

    work: Work
    found: Identification  # as far as its steps were done
    source: FrameSource | None = None  # of its frames; may be closed
    axis: TimeAxis = field(default_factory=lambda: TimeAxis(np.zeros(0)))  # of the source's frames
    # last frame minus surface, before and after rectification, (H, W) each, m
    last: tuple[np.ndarray, np.ndarray] | None = None
    local_tension: np.ndarray | None = None  # (H, W), N/m
    comparison: SensorComparison | None = None  # with the sensor in use
    compared_with: Sensor | None = None

    @property
    def frames(self) -> int:
        return len(self.axis)


def answer(bench: Workbench, work: Work, in_use: Sensor, progress: Progress) -> Answer:
    """Calibrate and compute everything shown; runs in the calibration thread."""
    found = bench.work(work.settings, part_of(progress, 0.0, IMAGES_AT))
    axis = TimeAxis(bench.source.times_s)
    if not found.complete:
        return Answer(work, found, bench.source, axis)
    progress("images", IMAGES_AT)
    # not at start
    from bubbleviz.calibration import SensorComparison, before_after, local_tension_image

    return Answer(
        work,
        found,
        bench.source,
        axis,
        last=before_after(found),
        local_tension=local_tension_image(found),
        comparison=SensorComparison.of(in_use, found),
        compared_with=in_use,
    )


CACHED_ANSWERS = 2
"""Results that undo can restore without computing."""


class Calibration(QObject):
    """State of the calibration panel."""

    changed = Signal()  # settings or results changed, or computing began or ended
    restarted = Signal()  # another source was opened
    progressed = Signal(str, float)  # description of the step, and its completed share

    def __init__(self, controller: Controller, undo: UndoRecorder) -> None:
        super().__init__()
        self.controller, self.undo = controller, undo
        self.work = Work()
        # of `work`, unless it is being computed or has failed
        self.answer = self._empty = Answer(self.work, Identification())
        self.live = False
        self.name = ""
        self.initial_sensor: Sensor | None = None
        self.saved: Work | None = None  # last one written to a sensor file
        self._source: Source | None = None
        self._shown_source: Source | None = None
        self._suspended = False
        self._failed_work: Work | None = None
        self._cache: OrderedDict[Work, Answer] = OrderedDict()
        self._bench = CurrentWorkbench()
        self._worker = Worker("calibration")
        self._worker.progressed.connect(self.progressed)
        controller.opened.connect(self._on_opened)

    @property
    def busy(self) -> bool:
        return self._worker.busy

    @property
    def outdated(self) -> bool:
        """Whether the results shown belong to other settings: computing, or failed."""
        return self.work != self.answer.work

    @property
    def failed(self) -> bool:
        """Whether the last computation failed, and no setting has been changed since."""
        return self._failed_work == self.work and self.outdated and not self.busy

    @property
    def unsaved(self) -> bool:
        """Whether there is an identification that was not saved."""
        return self.answer.found.complete and self.saved != self.answer.work

    def would_lose_work(self, request: OpenRequest) -> bool:
        """Whether opening another source would discard an unsaved identification."""
        if not self.unsaved or request.source is self._shown_source:
            return False
        return not self._continues_with(request, request.open_sensor)

    @property
    def settings(self) -> Settings:
        return self.work.settings

    def edit(self, text: str, *, dragged: bool = False, **changes: Any) -> None:
        """Change settings by name, as an undo step; all numbers of a drag are one step."""
        new = replace(self.work, settings=replace(self.settings, **changes))
        self._push(text, new, self.undo.gesture(text) if dragged else None)

    def use_collected(self, frames: HeldFrames, settings: Settings) -> None:
        self._push(f"Collect {count_of(len(frames), 'frame')}", Work(settings, frames), None)

    def reach(self, step: Step, text: str) -> None:
        """Compute the steps up to this one, if not done yet."""
        if self.settings.last_step < step:
            self.edit(text, last_step=step)

    def repeat(self) -> None:
        """Compute the step that failed again, with the same settings."""
        self._compute(self.work)
        self.changed.emit()

    def cancel(self) -> None:
        """Stop computing and restore the previous settings."""
        if not self.busy:
            return
        self._worker.cancel()
        self._suspended = True
        while self.outdated and self._is_own(self.undo.stack.index() - 1):
            self.undo.stack.undo()
        if self.outdated:  # another setting was changed meanwhile
            self.undo.push("Cancel", self._apply, self.work, self.answer.work)
        self._suspended = False
        self.changed.emit()

    def start(self, job: Callable[[Progress], Any], then: Callable[[Any], None]) -> None:
        """Run another long job in the calibration thread; `then` receives its return value."""

        def take(answer: Any) -> None:
            then(answer)
            self.changed.emit()

        self._run(job, take)
        self.changed.emit()

    def close(self) -> None:
        self._worker.cancel()
        self._worker.submit(self._bench.close)
        self._worker.close(0.0)

    def _run(self, job: Callable[[Progress], Any], then: Callable[[Any], None]) -> None:
        """Run a job in place of the running one."""
        self._worker.cancel()
        self._worker.submit(partial(job, self._worker.progress), then, self._report_failure)

    def _push(self, text: str, new: Work, gesture: Hashable) -> None:
        if new != self.work:
            self.undo.push(text, self._apply, self.work, new, gesture)

    def _is_own(self, index: int) -> bool:
        command = self.undo.stack.command(index) if index >= 0 else None
        return isinstance(command, UndoStep) and command.apply == self._apply

    def _apply(self, work: Work) -> None:
        """Set the current work; its results come from the cache or are computed."""
        self.work = work
        if self._suspended:
            return
        empty = self._empty if work == self._empty.work else None
        known = empty or self._cache.get(work)
        if known is not None:
            self._worker.cancel()
            self.answer = known
        else:
            self._compute(work)
        self.changed.emit()

    def _compute(self, work: Work) -> None:
        source, initial, in_use = self._source, self.initial_sensor, self.controller.sensor
        if source is None or initial is None or in_use is None:
            return

        def compute(progress: Progress) -> Answer:
            return answer(self._bench.of(work, source, initial), work, in_use, progress)

        self._run(compute, self._on_computed)

    def _on_computed(self, answer: Answer) -> None:
        self.answer = self._cache[answer.work] = answer
        while len(self._cache) > CACHED_ANSWERS:
            self._cache.popitem(last=False)
        self.changed.emit()

    def _report_failure(self, failed: Failed) -> None:
        self._failed_work = self.work
        self.controller.state.messages.add(
            "error", failed.message, failed.details, topic=CALIBRATION
        )
        self.changed.emit()

    def _on_opened(self, opened: Opened) -> None:
        if opened.request.source is self._shown_source:
            return  # the same source with another sensor, perhaps the one just identified
        self._shown_source = opened.request.source
        self.undo.stack.clear()  # its steps belong to the previous source
        if self._continues_with(opened.request, lambda: opened.sensor):
            self._continue(opened)
            return
        self._worker.cancel()
        # its frames are a hundred MB; no longer busy when they are released
        self._worker.submit(self._bench.close, lambda _: self.changed.emit())
        self._cache.clear()
        self._source, self.initial_sensor = opened.request.source, opened.sensor
        self.live, self.name = opened.facts.live, opened.facts.title
        self.work = Work(Settings(nodes=opened.sensor.membrane.nodes))
        self.answer = self._empty = Answer(self.work, Identification())
        self.saved = None
        self.restarted.emit()
        self.changed.emit()

    def _continues_with(self, request: OpenRequest, sensor: Callable[[], Sensor]) -> bool:
        """Whether work can continue with another source: none, the same recording or camera."""
        present, source = self._source, request.source
        if present is None or self.initial_sensor is None:
            return False
        if source is NO_SOURCE:
            return True
        if source.path is not None:
            return (source.path, source.depth_topic) == (present.path, present.depth_topic)
        return source.live and self.live and _size(sensor()) == _size(self.initial_sensor)

    def _continue(self, opened: Opened) -> None:
        """Keep settings and results."""
        if opened.request.source is not NO_SOURCE:
            self._source = opened.request.source
        if opened.facts.live:
            self.initial_sensor, self.name = opened.sensor, opened.facts.title
        self.changed.emit()


def _size(sensor: Sensor) -> tuple[int, int]:
    return sensor.camera.width, sensor.camera.height


class CurrentWorkbench:
    """The workbench of the open source or of collected frames; used in the calibration thread."""

    def __init__(self) -> None:
        self._frames: Source | HeldFrames | None = None
        self._bench: Workbench | None = None

    def of(self, work: Work, source: Source, initial: Sensor) -> Workbench:
        """Workbench for a work; the one of other frames is closed."""
        from bubbleviz.calibration import Workbench  # not at start

        if self._bench is None or self._frames is not (work.collected or source):
            self.close()
            self._frames = work.collected or source
            self._bench = Workbench(work.collected or source.open(initial), initial)
        return self._bench

    def close(self) -> None:
        if self._bench is not None:
            self._bench.source.close()
        self._bench = None
