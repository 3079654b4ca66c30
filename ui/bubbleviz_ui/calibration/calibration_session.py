"""The calibration session: every choice can be undone, every answer comes from a thread."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from PySide6.QtCore import QObject, Signal

from bubbleviz.calibration import Draft, Settings, Step
from bubbleviz.progress import Progress, part_of
from bubbleviz.recordings import FrameSource, HeldFrames, TimeAxis
from bubbleviz.sensor import Sensor
from bubbleviz.wording import count_of
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.engine.solver import Opened, OpenRequest
from bubbleviz_ui.engine.source import NO_SOURCE, Source
from bubbleviz_ui.engine.upkeep import release_memory
from bubbleviz_ui.engine.worker import Failed, Worker
from bubbleviz_ui.model.messages import UserMessage
from bubbleviz_ui.model.undo import UndoRecorder, UndoStep
from bubbleviz_ui.model.units import Units

if TYPE_CHECKING:
    from bubbleviz.calibration import Comparison, Verdict, Workbench


# What the calibration thread hands to the window: a draft and the pictures it needs.


PICTURES = 0.95
"""Share of the work that is done before the pictures of it are made."""


@dataclass(frozen=True)
class Work:
    """All that a person decided; undo puts an older one back."""

    settings: Settings = field(default_factory=Settings)
    collected: HeldFrames | None = None  # frames of a live source; None: the recording itself


@dataclass(frozen=True)
class Answer:
    """What came of it."""

    work: Work
    draft: Draft
    axis: TimeAxis = field(default_factory=lambda: TimeAxis(np.zeros(0)))  # of the source's frames
    # the last frame less the surface before and after rectification, (H, W) each, m
    last: tuple[np.ndarray, np.ndarray] | None = None
    local_tension: np.ndarray | None = None  # (H, W), N/m
    comparison: Comparison | None = None  # against the sensor that was in use
    compared_with: Sensor | None = None

    @property
    def frames(self) -> int:
        return len(self.axis)

    def verdict(self, units: Units) -> Verdict | None:
        """What the identification is worth, in the operator's units; None before there is one."""
        if self.draft.found is None:
            return None
        from bubbleviz.calibration import judge  # the window starts without

        return judge(self.draft.found, units.gas_pressure.text)


def answer(bench: Workbench, work: Work, in_use: Sensor, progress: Progress) -> Answer:
    """Do the work and everything that is shown of it; runs in the calibration thread."""
    draft = bench.work(work.settings, part_of(progress, 0.0, PICTURES))
    axis = TimeAxis(bench.source.times_s)
    if draft.found is None:
        return Answer(work, draft, axis)
    progress("pictures", PICTURES)
    # the window starts without
    from bubbleviz.calibration import before_after, compare, local_tension_image

    return Answer(
        work,
        draft,
        axis,
        last=before_after(draft.found),
        local_tension=local_tension_image(draft.found),
        comparison=compare(in_use, draft.found),
        compared_with=in_use,
    )


TOPIC = "calibration"
"""Of messages."""
REMEMBERED = 4
"""Answers that undo finds again without computing."""


class Calibration(QObject):
    """What the γ0 panel shows and changes."""

    changed = Signal()  # another choice, another answer, or work began or ended
    restarted = Signal()  # another source is open
    progressed = Signal(str, float)  # step in plain words and the share of it that is done
    notified = Signal(object)  # a `UserMessage`

    def __init__(self, controller: Controller, undo: UndoRecorder) -> None:
        super().__init__()
        self.controller, self.undo = controller, undo
        self.work = Work()
        # of `work` unless something is being computed or has failed
        self.answer = self._nothing = Answer(self.work, Draft(self.settings))
        self.live = False
        self.name = ""
        self.given: Sensor | None = None
        self.saved: Work | None = None  # of which a sensor file was written last
        self._opener: Source | None = None
        self._shown: Source | None = None
        self._holding = False
        self._remembered: OrderedDict[Work, Answer] = OrderedDict()
        self.benches = Benches()
        self._worker = Worker("calibration")
        self._worker.progressed.connect(self.progressed)
        controller.opened.connect(self._on_opened)

    @property
    def busy(self) -> bool:
        return self._worker.busy

    @property
    def outdated(self) -> bool:
        """What is shown is of other settings: it is being computed anew, or that was refused."""
        return self.work != self.answer.work

    @property
    def unsaved(self) -> bool:
        """Whether there is an identification that no sensor file was written of."""
        return self.answer.draft.found is not None and self.saved != self.answer.work

    @property
    def is_open(self) -> bool:
        """Whether the window shows the source that this works on."""
        return self._shown is self._opener

    def loses(self, request: OpenRequest) -> bool:
        """Whether an identification that was not saved would be lost by opening something."""
        if not self.unsaved or request.source is self._shown:
            return False
        return not self._goes_on(request, request.open_sensor)

    @property
    def settings(self) -> Settings:
        return self.work.settings

    def edit(self, text: str, gesture: Hashable = None, **changes: Any) -> None:
        """Change settings by name, so that it can be undone."""
        new = replace(self.work, settings=replace(self.settings, **changes))
        self._push(text, new, gesture)

    def use_collected(self, frames: HeldFrames, settings: Settings) -> None:
        self._push(f"Collect {count_of(len(frames), 'frame')}", Work(settings, frames), None)

    def reach(self, step: Step, text: str) -> None:
        """Do the steps up to one, unless they are done."""
        if self.settings.last_step < step:
            self.edit(text, last_step=step)

    def cancel(self) -> None:
        """Stop computing; everything is as it was before."""
        if not self.busy:
            return
        self._worker.cancel()
        self._holding = True
        while self.outdated and self._is_own(self.undo.stack.index() - 1):
            self.undo.stack.undo()
        if self.outdated:  # another setting was changed meanwhile
            self.undo.push("Cancel", self._apply, self.work, self.answer.work)
        self._holding = False
        self.changed.emit()

    def start(self, job: Callable[[Progress], Any], then: Callable[[Any], None]) -> None:
        """Run another long job of the session in its thread; `then` gets what it returns."""

        def take(answer: Any) -> None:
            then(answer)
            self.changed.emit()

        self._run(job, take)
        self.changed.emit()

    def close(self) -> None:
        """Stop the thread; it lets go of the source."""
        self._worker.cancel()
        self._worker.submit(self.benches.close)
        self._worker.close()

    def _run(self, job: Callable[[Progress], Any], then: Callable[[Any], None]) -> None:
        """Do a job in place of what runs."""
        self._worker.cancel()
        self._worker.submit(partial(job, self._worker.progress), then, self._tell_problem)

    def _push(self, text: str, new: Work, gesture: Hashable) -> None:
        if new != self.work:
            self.undo.push(text, self._apply, self.work, new, gesture)

    def _is_own(self, index: int) -> bool:
        command = self.undo.stack.command(index) if index >= 0 else None
        return isinstance(command, UndoStep) and command.apply == self._apply

    def _apply(self, work: Work) -> None:
        """Make it the present work: its answer is remembered, or computed now."""
        self.work = work
        if self._holding:
            return
        nothing = self._nothing if work == self._nothing.work else None
        known = nothing or self._remembered.get(work)
        if known is not None:
            self._worker.cancel()
            self.answer = known
        else:
            self._compute(work)
        self.changed.emit()

    def _compute(self, work: Work) -> None:
        opener, given, in_use = self._opener, self.given, self.controller.sensor
        if opener is None or given is None or in_use is None:
            return
        benches = self.benches

        def compute(progress: Progress) -> Answer:
            found = answer(benches.of(work, opener, given), work, in_use, progress)
            release_memory()  # hundreds of MB that it worked with
            return found

        self._run(compute, self._on_computed)

    def _on_computed(self, answer: Answer) -> None:
        self.answer = self._remembered[answer.work] = answer
        while len(self._remembered) > REMEMBERED:
            self._remembered.popitem(last=False)
        self.changed.emit()

    def _tell_problem(self, failed: Failed) -> None:
        self.notified.emit(UserMessage("error", failed.message, failed.details, topic=TOPIC))
        self.changed.emit()

    def _on_opened(self, opened: Opened) -> None:
        if opened.request.source is self._shown:
            return  # the same source with another sensor, perhaps the one identified here
        self._shown = opened.request.source
        self.undo.stack.clear()  # what could be undone belongs to the source that is gone
        if self._goes_on(opened.request, lambda: opened.sensor):
            self._go_on(opened)
            return
        self._worker.cancel()
        self._remembered.clear()
        self._opener, self.given = opened.request.source, opened.sensor
        self.live, self.name = opened.facts.live, opened.facts.title
        self.work = Work(Settings(nodes=opened.sensor.membrane.nodes))
        self.answer = self._nothing = Answer(self.work, Draft(self.settings))
        self.saved = None
        self.restarted.emit()
        self.changed.emit()

    def _goes_on(self, request: OpenRequest, sensor: Callable[[], Sensor]) -> bool:
        """Whether the work stays with another source: none, or the same recording or camera."""
        present, opener = self._opener, request.source
        if present is None or self.given is None:
            return False
        if opener is NO_SOURCE:
            return True
        if opener.path is not None:
            return opener.path == present.path
        return opener.live and self.live and _size(sensor()) == _size(self.given)

    def _go_on(self, opened: Opened) -> None:
        """Keep what was decided and found."""
        if opened.request.source is not NO_SOURCE:
            self._opener = opened.request.source
        if opened.facts.live:
            self.given, self.name = opened.sensor, opened.facts.title
        self.changed.emit()


def _size(sensor: Sensor) -> tuple[int, int]:
    return sensor.camera.width, sensor.camera.height


class Benches:
    """The workbench of the open source; lives in the calibration thread."""

    def __init__(self) -> None:
        self._opener: Source | None = None
        self._bench: Workbench | None = None
        self._collected: tuple[HeldFrames, Workbench] | None = None

    def of(self, work: Work, opener: Source, given: Sensor) -> Workbench:
        """Workbench of a work, made where it is not there yet."""
        from bubbleviz.calibration import Workbench  # the window starts without

        if work.collected is not None:
            if self._collected is None or self._collected[0] is not work.collected:
                self._collected = (work.collected, Workbench(work.collected, given))
            return self._collected[1]
        if self._bench is None or self._opener is not opener:
            self.close()
            self._bench, self._opener = Workbench(opener.open(given), given), opener
        return self._bench

    def source(self, work: Work) -> FrameSource:
        """Source of a work that was done."""
        if work.collected is not None:
            return work.collected
        if self._bench is None:
            raise AssertionError("nothing was done with the source")
        return self._bench.source

    def close(self) -> None:
        """Let go of the source."""
        if self._bench is not None:
            self._bench.source.close()
        self._bench = self._collected = None
