"""One sensor as the window knows it: submits work to its worker, keeps what came back."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from PySide6.QtCore import QObject, Signal

from bubbleviz.diagnostics import Inspection, Numbers
from bubbleviz.pipeline import OBJECT_PRODUCTS, FrameOptions, Product
from bubbleviz.recordings import Frame, Gap
from bubbleviz.result import Result
from bubbleviz_ui.engine.solver import Opened, OpenRequest, Solved, Solver
from bubbleviz_ui.engine.worker import KEYS, OPEN, Failed, Worker
from bubbleviz_ui.model.demand import Demand
from bubbleviz_ui.model.frame_history import FrameHistory, grown
from bubbleviz_ui.model.messages import RateMeter
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.source_facts import SourceFacts

LOOK_EVERY_S = 0.15
"""How often closer looks are taken while playing: nobody sees more."""
SLACK_S = 0.004
"""How long a result may wait for the window: a little, so that the window does not wait for it."""
GAIN = 0.4  # of the delay's integral control; chosen
MOST_S = 0.1  # s; longer delays are felt


class RequestDelay:
    """Delays requests while the window draws: a frame taken too early would be old by then."""

    def __init__(self) -> None:
        self.hold_s = 0.0  # How long after the last result the next frame is to be taken

    def waited(self, seconds: float) -> None:
        """Take note of how long a result waited for the window."""
        self.hold_s = min(max(self.hold_s + GAIN * (seconds - SLACK_S), 0.0), MOST_S)


class SensorClient(QObject):
    """What is open in a solver thread, and the newest that came of it.

    The panels show one sensor; where a session has two, the other one is another client.
    """

    turned = Signal(object)  # An `Opened`: another source is open
    solved = Signal(object, bool)  # A `Solved`, and whether it is the newest frame of a live source
    patched = Signal(object)  # The shown frame has its patch at another κ
    paused = Signal()  # No frame of a live source came while one was waited for
    failed = Signal(object)  # A `Failed`

    def __init__(self, state: SessionState) -> None:
        super().__init__()
        self.solver = Solver()  # Used in the worker's thread
        self.worker = Worker("solver", KEYS, self.solver.close)
        self.dropped = 0  # Frames replaced by a newer one before their turn
        self.session = object()  # Stands for the open source; another one for each
        self.opened: Opened | None = None  # None before the first source
        self.facts: SourceFacts | None = None  # Of the source as it is now: a live one grows
        self.history = FrameHistory(0)
        self.result: Result | None = None  # Shown last
        self.inspection = Inspection()  # Closer look at that
        self.demand = Demand(frozenset())  # What was asked for last
        # Asked of every live frame besides what is visible
        self.extra: frozenset[Product] = frozenset()
        self.solves = RateMeter()  # Frames that came back from the solver
        self._state = state
        self._awaiting = False
        self._looked_s = 0.0
        self._looked_at: Frame | None = None
        self._settled: Frame | None = None
        self._shown_as = self.demand
        self._delay = RequestDelay()
        self.worker.failed.connect(self._on_failed)

    @property
    def look_is_old(self) -> bool:
        """Whether the closer look is at a frame before the one that is shown."""
        shown = None if self.result is None else self.result.frame
        return bool(self.demand.diagnostics) and self._looked_at is not shown

    @property
    def shown_thinned(self) -> bool:
        """Whether what is shown has fewer points than were asked for, as one frame of many."""
        return self._shown_as.options.cloud_points != self.demand.options.cloud_points

    @property
    def settled(self) -> bool:
        """Whether what is shown is the same whatever was looked at before it."""
        result = self.result
        return result is not None and (result.estimate is None or self._settled is result.frame)

    def open(self, request: OpenRequest) -> None:
        """Open a source in place of the present one."""
        self.worker.submit(
            partial(self.solver.open, request), self._take_opened, key=OPEN, request=request
        )

    def ask_settled(self) -> None:
        """Ask for the frame that is shown once more, settled; its pose is kept."""
        if self.result is not None:
            due = self._due(self.demand)
            products = self._shown_as.products - OBJECT_PRODUCTS | due.diagnostics
            demand = replace(due, products=products, options=self._options)
            function = partial(self.solver.frame, self.result.frame.index, demand, settled=True)
            self.worker.submit(function, self._take_settled, key="settle")

    def ask_frame(self, index: int, demand: Demand, *, anew: bool = False) -> None:
        """Ask for a frame; `anew` with the contact-free colour images found anew."""
        self.demand = demand
        self.worker.drop("settle")  # of the frame that the user has left
        key, work = "collect" if anew else "frame", self.framing(index, demand, anew=anew)
        self.dropped += self.worker.submit(*work, key=key)

    def framing(
        self, index: int, demand: Demand, *, anew: bool = False
    ) -> tuple[Callable[[], Solved], Callable[[Solved], None]]:
        """Function for the worker that solves a frame, and what takes its answer."""
        function = partial(self.solver.frame, index, self._due(demand), anew=anew)
        return function, partial(self._take_frame, time.perf_counter())

    def ask_newest(self, demand: Demand, *, at_once: bool = False) -> None:
        """Ask for the newest frame of a live source, unless that is asked for already.

        Not `at_once`: when the window will have drawn the last one.
        """
        if self._awaiting:
            return
        self._awaiting, self.demand = True, demand
        wanted = self._due(demand)
        function = partial(
            self.solver.newest,
            replace(wanted, products=wanted.products | self.extra),
            partial(self.worker.urgent, "newest"),
            needs_colour=demand.needs_colour,
        )
        then = partial(self._take_newest, at_once=at_once, looks=bool(wanted.diagnostics))
        due_s = 0.0 if at_once else time.perf_counter() + self._delay.hold_s
        self.worker.submit(function, then, key="newest", due_s=due_s)

    def ask_patch(self) -> None:
        """Threshold the present result anew, where there is something to threshold."""
        result, asked = self.result, self.demand
        if result is None or result.estimate is None or "patch" not in asked.products:
            return
        demand = asked.with_diagnostics(asked.diagnostics & {"components"})
        demand = replace(demand, options=self._options)
        function = partial(self.solver.patch, result, demand)
        self.worker.submit(function, partial(self._take_patch, demand), key="patch")

    @property
    def _options(self) -> FrameOptions:
        """As chosen now; the patch's may have changed since a frame was asked for."""
        return Demand.of(self._state.settings).options

    def _due(self, demand: Demand) -> Demand:
        """What to ask for now: while playing fewer points, and no closer look at every frame."""
        now = time.perf_counter()
        if self._state.playing and not self._state.frozen:
            demand = demand.thinned(self._state.cloud_decimation)
            if now - self._looked_s < LOOK_EVERY_S:
                return demand.with_diagnostics()
        self._looked_s = now
        return demand

    # -- answers ------------------------------------------------------------------------------

    def _on_failed(self, failed: Failed) -> None:
        self._awaiting &= failed.key != "newest"
        self.failed.emit(failed)

    def _take_opened(self, opened: Opened) -> None:
        self.session = object()
        self.opened, self.facts, self.demand = opened, opened.facts, opened.request.demand
        self.history = FrameHistory(opened.facts.frames)
        self._awaiting = False
        self.result, self.inspection = opened.result, _inspection(opened.result)
        self._shown_as = self.demand.with_diagnostics()
        self._looked_at = opened.result.frame
        self._remember(opened.frame, opened.numbers, self.demand)
        self.turned.emit(opened)

    def _take_frame(self, asked_s: float, solved: Solved) -> None:
        now = time.perf_counter()
        self.solves.tick(now)
        index, numbers = solved.result.frame.index, solved.numbers
        numbers = replace(numbers, latency_ms=1e3 * (now - asked_s))
        self._remember(index, numbers, solved.demand)
        self._show(solved)
        self.solved.emit(solved, False)

    def _take_newest(self, solved: Solved | None, *, at_once: bool, looks: bool) -> None:
        self._awaiting = False
        if solved is None:
            if looks:  # nothing was looked at
                self._looked_s = 0.0
            self.paused.emit()
            return
        now, frame, numbers = time.perf_counter(), solved.result.frame, solved.numbers
        self.solves.tick(now)
        if not at_once:  # else it waited for the picture of another sensor
            self._delay.waited(now - solved.done_s)
        self._grow(frame.time_s, solved.outages)
        if frame.arrival_ns:
            numbers = replace(numbers, latency_ms=1e-6 * (time.time_ns() - frame.arrival_ns))
        self._remember(frame.index, numbers, solved.demand)
        if not self._state.frozen:
            self._show(solved)
        self.solved.emit(solved, True)
        if solved.remark:
            self.failed.emit(Failed("newest", solved.remark))

    def _show(self, solved: Solved) -> None:
        self.result, self._settled = solved.result, None
        self._shown_as = solved.demand.with_diagnostics()
        if solved.demand.diagnostics or not self.demand.diagnostics:  # else it was left out
            self.inspection = _inspection(solved.result)
            self._looked_at = solved.result.frame

    def _take_settled(self, solved: Solved) -> None:
        self.solves.tick(time.perf_counter())
        shown, new, asked = self.result, solved.result, solved.demand
        self._remember(new.frame.index, solved.numbers, asked)
        same = shown is not None and shown.frame.index == new.frame.index
        wanted = self._shown_as.products | self.demand.diagnostics
        # else another frame, or more of this one, is looked at by now
        if shown is not None and same and wanted <= asked.products | OBJECT_PRODUCTS:
            pose, by_object = shown.pose, shown.object_patch
            self.result = replace(new, frame=shown.frame, pose=pose, object_patch=by_object)
            self._shown_as = replace(self._shown_as, options=asked.options)
            self.inspection = _inspection(new)
            self._settled = self._looked_at = shown.frame
        self.solved.emit(solved, False)
        if solved.remark:
            self.failed.emit(Failed("settle", solved.remark, warning=True))

    def _take_patch(self, demand: Demand, answer: tuple[Result, Numbers]) -> None:
        result, (patched, numbers) = self.result, answer
        if result is not None and result.estimate is patched.estimate:  # else another is shown
            self._remember(result.frame.index, numbers, demand)
            if "components" in demand.diagnostics:
                parts = _inspection(patched).components
                self.inspection = replace(self.inspection, components=parts)
            self.result = replace(result, patch=patched.patch)
        self.patched.emit(patched)

    def _remember(self, index: int, numbers: Numbers, demand: Demand) -> None:
        same_patch = demand.patch_rule == self._state.settings.patch_rule
        self.history.record(index, numbers, patch=same_patch)

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
