"""One sensor as the window knows it: asks its solver thread, and keeps what came back."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from PySide6.QtCore import QObject, Signal

from bubbleviz.diagnostics import Inspection
from bubbleviz.pipeline import OF_OBJECT, FrameOptions, Product
from bubbleviz.recordings import Frame, Gap
from bubbleviz.result import Result
from bubbleviz_ui.engine.requests import (
    Answer,
    Failed,
    Followed,
    FrameRequest,
    NewestRequest,
    Opened,
    PatchRequest,
    RequestDelay,
    SettleRequest,
    Solved,
    Thresholded,
    Waited,
)
from bubbleviz_ui.engine.solver_thread import Worker
from bubbleviz_ui.model.demand import Demand
from bubbleviz_ui.model.frame_history import History, grown
from bubbleviz_ui.model.messages import RateMeter
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.source_facts import SourceFacts

LOOK_EVERY_S = 0.15
"""How often closer looks are taken while playing: nobody sees more."""


class SensorClient(QObject):
    """What is open in a solver thread, and the newest that came of it.

    The panels show one sensor; where a session has two, the other one is another client.

    Parameters
    ----------
    state : SessionState
        Of the window.
    worker : Worker
        The client closes it.

    Attributes
    ----------
    answered : Signal
        An `Answer` that belongs to what is open, once the client has taken it.
    opened : Opened or None
        None before the first source.
    facts : SourceFacts or None
        Of the source as it is now: a live one grows.
    history : History
    result : Result or None
        Shown last.
    inspection : Inspection
        Closer look at that.
    demand : Demand
        What was asked for last.
    extra : frozenset of Product
        Asked of every live frame besides what is visible.
    solves : RateMeter
        Frames that came back from the solver.
    """

    answered = Signal(object)

    def __init__(self, state: SessionState, worker: Worker) -> None:
        super().__init__()
        self.worker = worker
        self.opened: Opened | None = None
        self.facts: SourceFacts | None = None
        self.history = History(0)
        self.result: Result | None = None
        self.inspection = Inspection()
        self.demand = Demand(frozenset())
        self.extra: frozenset[Product] = frozenset()
        self.solves = RateMeter()
        self._state = state
        self._awaiting = False
        self._looked_s = 0.0
        self._looked_at: Frame | None = None
        self._settled: Frame | None = None
        self._shown_as = self.demand
        self._delay = RequestDelay()
        worker.answered.connect(self._on_answer)

    @property
    def session(self) -> int:
        """Generation of the session that is open; 0 before the first."""
        return 0 if self.opened is None else self.opened.request.session

    @property
    def look_is_old(self) -> bool:
        """Whether the closer look is at a frame before the one that is shown."""
        shown = None if self.result is None else self.result.frame
        return bool(self.demand.looks) and self._looked_at is not shown

    @property
    def shown_thinned(self) -> bool:
        """Whether what is shown has fewer points than were asked for, as one frame of many."""
        return self._shown_as.options.cloud_points != self.demand.options.cloud_points

    @property
    def settled(self) -> bool:
        """Whether what is shown is the same whatever was looked at before it."""
        result = self.result
        return result is not None and (result.estimate is None or self._settled is result.frame)

    def ask_settled(self) -> None:
        """Ask for the frame that is shown once more, settled; its pose is kept."""
        if self.result is not None:
            due = self._due(self.demand)
            products = self._shown_as.products - OF_OBJECT | due.looks
            demand = replace(due, products=products, options=self._options)
            self.worker.ask(SettleRequest(self.session, demand, self.result.frame.index))

    def ask_frame(self, index: int, demand: Demand) -> None:
        """Ask for a frame."""
        self.demand = demand
        self.worker.ask(self.frame_request(index, demand))

    def frame_request(self, index: int, demand: Demand) -> FrameRequest:
        """Request for a frame that is wanted now."""
        return FrameRequest(self.session, self._due(demand), index, time.perf_counter())

    def ask_newest(self, demand: Demand, *, at_once: bool = False) -> None:
        """Ask for the newest frame of a live source, unless that is asked for already.

        Not `at_once`: when the window will have drawn the last one.
        """
        if self._awaiting:
            return
        self._awaiting, self.demand = True, demand
        wanted = self._due(demand)
        wanted = replace(wanted, products=wanted.products | self.extra)
        from_s = 0.0 if at_once else time.perf_counter() + self._delay.hold_s
        self.worker.ask(NewestRequest(self.session, wanted, from_s, demand.of_colour))

    def ask_patch(self) -> None:
        """Threshold the present result anew, where there is something to threshold."""
        result, asked = self.result, self.demand
        if result is None or result.estimate is None or "patch" not in asked.products:
            return
        demand = asked.looking(asked.looks & {"components"})
        demand = replace(demand, options=self._options)
        self.worker.ask(PatchRequest(self.session, demand, result))

    @property
    def _options(self) -> FrameOptions:
        """As chosen now; the patch's may have changed since a frame was asked for."""
        return Demand.of(self._state.choices).options

    def close(self) -> None:
        """Stop the solver thread."""
        self.worker.close()

    def _due(self, demand: Demand) -> Demand:
        """What to ask for now: while playing fewer points, and no closer look at every frame."""
        now = time.perf_counter()
        if self._state.playing and not self._state.frozen:
            demand = demand.thinned(self._state.thinned)
            if now - self._looked_s < LOOK_EVERY_S:
                return demand.looking()
        self._looked_s = now
        return demand

    # -- answers ------------------------------------------------------------------------------

    def _on_answer(self, answer: Answer) -> None:
        if isinstance(answer, Opened):
            self._take_opened(answer)
        elif isinstance(answer, Failed):
            self._awaiting &= not isinstance(answer.request, NewestRequest)
        elif answer.request.session != self.session:
            return
        elif isinstance(answer, Waited):
            self._awaiting = False
            if answer.request.demand.looks:  # nothing was looked at
                self._looked_s = 0.0
        elif isinstance(answer, Solved):
            self._take_solved(answer)
        elif isinstance(answer, Followed) and answer.solved is not None:
            self._take_solved(answer.solved)
        elif isinstance(answer, Thresholded):
            self._take_patch(answer)
        self.answered.emit(answer)
        if isinstance(answer, Solved) and answer.remark:
            settles = isinstance(answer.request, SettleRequest)
            self.answered.emit(Failed(answer.request, answer.remark, "", warning=settles))

    def _take_opened(self, answer: Opened) -> None:
        self.opened, self.facts, self.demand = answer, answer.facts, answer.request.demand
        self.history = History(answer.facts.frames)
        self._awaiting = False
        self.result, self.inspection = answer.result, _inspection(answer.result)
        self._shown_as = answer.request.demand.looking()
        self._looked_at = answer.result.frame
        same_patch = self.demand.rule == self._state.choices.rule
        self.history.take(answer.frame, answer.numbers, patch=same_patch)

    def _take_solved(self, answer: Solved) -> None:
        request, frame, numbers = answer.request, answer.result.frame, answer.numbers
        now = time.perf_counter()
        self.solves.tick(now)
        newest = isinstance(request, NewestRequest)
        if isinstance(request, NewestRequest):
            self._awaiting = False
            if request.from_s:  # else it waited for the picture of another sensor
                self._delay.waited(now - answer.done_s)
            self._grow(frame.time_s, answer.outages)
        if newest and frame.arrival_ns:
            numbers = replace(numbers, latency_ms=1e-6 * (time.time_ns() - frame.arrival_ns))
        elif isinstance(request, FrameRequest) and request.asked_s is not None:
            numbers = replace(numbers, latency_ms=1e3 * (now - request.asked_s))
        same_patch = request.demand.rule == self._state.choices.rule
        self.history.take(frame.index, numbers, patch=same_patch)
        if isinstance(request, SettleRequest):
            self._take_settled(answer)
        elif not (newest and self._state.frozen):
            self.result, self._settled = answer.result, None
            self._shown_as = request.demand.looking()
            if request.demand.looks or not self.demand.looks:  # else it was left out
                self.inspection, self._looked_at = _inspection(answer.result), frame

    def _take_settled(self, answer: Solved) -> None:
        shown, new = self.result, answer.result
        if shown is None or shown.frame.index != new.frame.index:
            return  # another frame is looked at by now
        asked = answer.request.demand
        if not self._shown_as.products | self.demand.looks <= asked.products | OF_OBJECT:
            return  # more is looked at by now
        pose, by_object = shown.pose, shown.object_patch
        self.result = replace(new, frame=shown.frame, pose=pose, object_patch=by_object)
        self._shown_as = replace(self._shown_as, options=asked.options)
        self.inspection = _inspection(new)
        self._settled = self._looked_at = shown.frame

    def _take_patch(self, answer: Thresholded) -> None:
        result, demand = self.result, answer.request.demand
        if result is None or result.estimate is not answer.request.result.estimate:
            return  # another frame is shown by now
        same_patch = demand.rule == self._state.choices.rule
        self.history.take(result.frame.index, answer.numbers, patch=same_patch)
        if "components" in demand.looks:
            parts = _inspection(answer.result).components
            self.inspection = replace(self.inspection, components=parts)
        self.result = replace(result, patch=answer.result.patch)

    def _grow(self, time_s: float, outages: tuple[Gap, ...]) -> None:
        """Make room for one more frame of a live source."""
        if self.facts is not None:
            count = self.facts.frames + 1
            times = grown(self.facts.times_s, count, np.nan)
            times[-1] = time_s
            self.facts = replace(self.facts, times_s=times, outages=outages)
            self.history.grow(count)


def _inspection(result: Result) -> Inspection:
    return result.inspection or Inspection()
