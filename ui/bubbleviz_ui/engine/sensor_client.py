"""One sensor in the window: submits work to its solver thread, holds the latest results."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from PySide6.QtCore import QObject, Signal

from bubbleviz.diagnostics import Inspection, Numbers
from bubbleviz.pipeline import OBJECT_PRODUCTS, FrameOptions, Product
from bubbleviz.recordings import Frame, Gap
from bubbleviz.result import Result
from bubbleviz_ui.engine.solver import Opened, OpenRequest, Solved, Solver
from bubbleviz_ui.engine.worker import CLOSE_TIMEOUT_S, KEYS, OPEN, Failed, Worker
from bubbleviz_ui.model.demand import Demand
from bubbleviz_ui.model.frame_history import FrameHistory, grown
from bubbleviz_ui.model.messages import Warnings
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.source_facts import NO_RESULT, SourceFacts
from bubbleviz_ui.model.throttle import RateMeter, Throttle

IMAGES_EVERY_S = 0.15
"""Period at which images are updated during playback."""
TARGET_WAIT_S = 0.004
"""Target time between a result and its drawing; above 0, so that the window never waits for it."""
GAIN, WAITS = 0.4, 5
"""Of the integral control of the delay, and the number of results whose shortest wait counts."""
MAX_DELAY_S = 0.1  # longer delays are noticeable
WARNINGS_EVERY_MS = 1000
"""Period at which warnings about the solved frames, with their counts, are updated."""
SAMPLED_FRAMES = 16
"""Frames of a recording solved in advance for its scales, while the solver is idle."""
IDLE_S = 0.5
"""How long after the last request such work begins, so that it delays neither the first picture nor
a seek."""


class RequestDelay:
    """Delays requests while the window draws, as a frame taken too early is old when drawn.

    By the shortest of the last waits: longer ones are for the other sensor's picture, or another
    process, and a delay would not shorten them.
    """

    def __init__(self) -> None:
        self.delay_s = 0.0  # Between the last result and the next request
        self._waits_s: deque[float] = deque(maxlen=WAITS)

    def update(self, seconds: float) -> None:
        """Adapt the delay to the time a result waited for the window."""
        self._waits_s.append(seconds)
        too_long_s = min(self._waits_s) - TARGET_WAIT_S
        self.delay_s = min(max(self.delay_s + GAIN * too_long_s, 0.0), MAX_DELAY_S)


class SensorClient(QObject):
    """A sensor's solver thread, and the latest results from it.

    The panels show one sensor; the second one of a session has its own client.
    """

    opened_source = Signal(object)  # An `Opened`
    solved = Signal(object, bool)  # A `Solved`; True if it is the newest frame of a live source
    patched = Signal(object)  # `Result` of the shown frame with another patch, or without its pose
    paused = Signal()  # A live source sent no frame in time, or one that failed
    failed = Signal(object)  # A `Failed`
    scaled = Signal()  # The frames given to `scale_to` are covered

    def __init__(self, state: SessionState) -> None:
        super().__init__()
        self.solver = Solver()  # Used in the worker's thread
        self.worker = Worker("solver", KEYS, self._close_source)
        self.dropped = 0  # Requests replaced by a newer one before they ran
        self.session = object()  # Identity of the open source
        self.opened: Opened | None = None  # None before the first source
        self.facts = SourceFacts()  # Updated as a live source grows
        self.history = FrameHistory(self.facts.frames)
        self.result = NO_RESULT  # Shown last
        self.inspection = Inspection()  # Diagnostics of `result`
        self.demand = Demand(frozenset())  # Of the last request
        # Computed for every live frame in addition to what is visible
        self.extra_products: frozenset[Product] = frozenset()
        self.solve_rate = RateMeter()
        self.name = ""  # Of one of several sensors, in warnings
        self.frames_counted = Throttle(self, self._request_warnings, WARNINGS_EVERY_MS)
        self._warned: Warnings = {}
        self._state = state
        self._awaiting = self._failing = False
        self._imaged_s = 0.0
        self._imaged_frame: Frame | None = None
        self._cold_solved: Frame | None = None
        self._shown_demand = self.demand
        self._delay = RequestDelay()
        self._unscaled: tuple[int, ...] = ()
        self._background_s = 0.0  # earliest start of work that nobody waits for
        self.worker.failed.connect(self._on_failed)
        state.playing_changed.connect(self._scale_on)

    @property
    def images_outdated(self) -> bool:
        """Whether the images belong to an earlier frame than the one shown."""
        return bool(self.demand.images) and self._imaged_frame is not self.result.frame

    @property
    def shown_thinned(self) -> bool:
        """Whether the cloud shown was thinned for playback."""
        return self._shown_demand.options.cloud_points != self.demand.options.cloud_points

    @property
    def cold_solved(self) -> bool:
        """Whether the frame shown was solved from rest."""
        result = self.result
        return result.estimate is None or self._cold_solved is result.frame

    def close(self, timeout_s: float = CLOSE_TIMEOUT_S) -> bool:
        """End the solver thread; returns as `Worker.close`.

        Until it has ended, the application keeps the worker, which keeps this object: the thread
        may hold the last other reference, and would delete its timer.
        """
        self.frames_counted.stop()
        return self.worker.close(timeout_s)

    def _close_source(self) -> None:
        """As `Solver.close`; a method of this object, so that the worker keeps it."""
        self.solver.close()

    def open(self, request: OpenRequest) -> None:
        """Open a source in place of the current one."""
        self.worker.submit(
            partial(self.solver.open, request), self._take_opened, key=OPEN, request=request
        )

    def request_cold_solve(self) -> None:
        """Request a cold solve of the shown frame; its pose is kept."""
        due = self._due(self.demand)
        products = self._shown_demand.products - OBJECT_PRODUCTS | due.images
        demand = replace(due, products=products, options=self._options)
        function = partial(self.solver.frame, self.result.frame.index, demand, cold=True)
        self.worker.submit(function, self._take_cold_solve, key="cold_solve")

    def request_frame(self, index: int, demand: Demand, *, new_reference: bool = False) -> None:
        """Request a frame; `new_reference`: search the contact-free colour images again."""
        if not self._comparable(demand):
            self.history.forget()
        self.demand, self._background_s = demand, time.perf_counter() + IDLE_S
        if self._unscaled:
            self._scale_on()
        self.worker.drop("cold_solve")  # of the previous frame
        work = self.frame_job(index, demand, new_reference=new_reference)
        key = "reference" if new_reference else "frame"
        self.dropped += self.worker.submit(*work, key=key)

    def frame_job(
        self, index: int, demand: Demand, *, new_reference: bool = False
    ) -> tuple[Callable[[], Solved], Callable[[Solved], None]]:
        """Function for the worker that solves a frame, and receiver of its result."""
        function = partial(self.solver.frame, index, self._due(demand), new_reference=new_reference)
        return function, partial(self._take_frame, time.perf_counter())

    def request_newest(self, demand: Demand, *, at_once: bool = False) -> None:
        """Request the newest frame of a live source, unless that was done already.

        Unless `at_once`, the solver waits until the window has drawn the last one.
        """
        if self._awaiting:
            return
        self._awaiting, self.demand = True, demand
        wanted = self._due(demand)
        function = partial(
            self.solver.newest,
            replace(wanted, products=wanted.products | self.extra_products),
            partial(self.worker.has_more_urgent, "newest"),
            needs_colour=demand.needs_colour,
        )
        then = partial(self._take_newest, at_once=at_once, imaged=bool(wanted.images))
        due_s = 0.0 if at_once else time.perf_counter() + self._delay.delay_s
        self.worker.submit(function, then, key="newest", due_s=due_s)

    def request_patch(self) -> None:
        """Request the patch of the shown result at the current κ."""
        result, requested = self.result, self.demand
        if result.estimate is None or "patch" not in requested.products:
            return
        products = requested.products - requested.images - {"kappa_curve"}
        demand = replace(requested, products=products, options=self._options)
        function = partial(self.solver.patch, result, demand)
        self.worker.submit(function, partial(self._take_patch, demand), key="patch")

    def scale_to(self, frames: Sequence[int]) -> None:
        """Extend the scales to frames while the solver is idle, then emit `scaled`.

        Frames of an earlier call that are not done yet are left out.
        """
        unknown = {*self.history.missing(frozenset({"estimate"})).tolist()}
        self._unscaled = tuple(frame for frame in frames if frame in unknown)
        self._scale_on()

    def _scale_on(self) -> None:
        """Request some of these frames; not during playback, which they would delay."""
        if not self._unscaled:
            self.scaled.emit()
        elif not self._state.playing:
            function = partial(self.solver.preview, self._unscaled, self._options)
            take = partial(self._take_extremes, self._unscaled)
            due_s, failed = self._background_s, self._on_unscaled
            self.worker.submit(function, take, failed=failed, key="scale", due_s=due_s)

    def forget_pose(self) -> None:
        """Remove the pose from the shown result, as another object or initial pose is used."""
        if self.result.pose is not None:
            self.result = replace(self.result, pose=None, object_patch=None)
            self.patched.emit(self.result)

    @property
    def _options(self) -> FrameOptions:
        """Current options; those of the patch may have changed since the last request."""
        return Demand.of(self._state.settings).options

    def _due(self, demand: Demand) -> Demand:
        """The demand reduced for playback: fewer points, and images at a lower rate."""
        now = time.perf_counter()
        if self._state.advancing:
            demand = demand.thinned(self._state.cloud_decimation)
            if now - self._imaged_s < IMAGES_EVERY_S:
                return demand.without_images()
        self._imaged_s = now
        return demand

    # -- answers ------------------------------------------------------------------------------

    def _on_failed(self, failed: Failed) -> None:
        """Report a failure with the sensor's name; while frames advance, once until one is solved.

        A recording shown by the panels stops at its failure, which is reported each time. The next
        frame of a live source is requested as after a pause.
        """
        newest = failed.key == "newest"
        self._awaiting &= not newest
        stops = self.facts is self._state.facts and not self.facts.grows
        repeated = self._failing and self._state.advancing and not stops
        self._failing = newest or failed.key == "frame"
        if not (repeated and self._failing):
            # what else is opened in its place has another name
            opens_other = failed.key == OPEN and self.opened is not None
            message = failed.message if opens_other else f"{self.prefix}{failed.message}"
            self.failed.emit(replace(failed, message=message))
        if newest:
            self.paused.emit()

    def _take_opened(self, opened: Opened) -> None:
        self.session = object()
        self.opened, self.facts, self.demand = opened, opened.facts, opened.request.demand
        self.history = FrameHistory(opened.facts.frames)
        self._awaiting = self._failing = False
        self.result, self.inspection = opened.result, _inspection(opened.result)
        self._cold_solved = None
        self._shown_demand = self.demand.without_images()
        self._imaged_frame = opened.result.frame
        self._background_s = time.perf_counter() + IDLE_S
        self._remember(opened.result.frame.index, opened.numbers, self.demand)
        if not opened.facts.grows and opened.result.frame.wrench is not None:
            self.history.wrench_bias_n = np.full(3, np.nan)  # until it is known
            function = partial(
                self.solver.wrench_bias, partial(self.worker.has_more_urgent, "wrench")
            )
            self.worker.submit(
                function, self._take_wrench_bias, key="wrench", due_s=self._background_s
            )
        self.opened_source.emit(opened)  # it may begin to play
        self._warned = {}  # they were of the previous source
        self._warn(opened.facts.remark)
        self.frames_counted.request()
        if opened.facts.frames > 1 and not opened.facts.grows:
            last = opened.facts.frames - 1
            self.scale_to(sorted({round(k) for k in np.linspace(0, last, SAMPLED_FRAMES)}))

    def _take_wrench_bias(self, bias_n: np.ndarray) -> None:
        self.history.wrench_bias_n = bias_n
        self._state.history_changed.emit()

    def _take_extremes(self, frames: tuple[int, ...], numbers: list[Numbers]) -> None:
        for frame, known in zip(frames, numbers, strict=False):
            self.history.extremes.include(frame, known)
        self._state.history_changed.emit()
        if frames is self._unscaled:
            self._unscaled = frames[len(numbers) :]
            self._scale_on()

    def _on_unscaled(self, _: Failed) -> None:
        """Ignore the failure: a frame that cannot be solved is reported when it is shown."""
        self._unscaled = ()
        self.scaled.emit()

    def _take_frame(self, requested_s: float, solved: Solved) -> None:
        now = time.perf_counter()
        self.solve_rate.tick(now)
        index, numbers = solved.result.frame.index, solved.numbers
        numbers = replace(numbers, latency_ms=1e3 * (now - requested_s))
        self._remember(index, numbers, solved.demand)
        self._show(solved)
        self._announce(solved)

    def _take_newest(self, solved: Solved | None, *, at_once: bool, imaged: bool) -> None:
        self._awaiting = False
        if solved is None:
            if imaged:  # no frame came: they are still due
                self._imaged_s = 0.0
            self.paused.emit()
            return
        now, frame, numbers = time.perf_counter(), solved.result.frame, solved.numbers
        self.solve_rate.tick(now)
        if not at_once:  # else it waited for the other sensor to be drawn
            self._delay.update(now - solved.done_s)
        self._grow(frame, solved.outages)
        if frame.arrival_ns:
            numbers = replace(numbers, latency_ms=1e-6 * (time.time_ns() - frame.arrival_ns))
        self._remember(frame.index, numbers, solved.demand)
        if not self._state.frozen:
            self._show(solved)
        self._announce(solved, newest=True)

    def _announce(self, solved: Solved, *, newest: bool = False) -> None:
        if newest or not self.facts.grows:  # else an earlier frame, while the newest ones fail
            self._failing = False
        self.solved.emit(solved, newest)
        self._warn(solved.remark)
        self.frames_counted.request()

    def _request_warnings(self) -> None:
        self.worker.submit(self.solver.warnings, self._take_warnings, key="warnings")

    def _take_warnings(self, texts: dict[str, str]) -> None:
        named = {subject: f"{self.prefix}{text}." for subject, text in texts.items()}
        self._warned = self._state.messages.revise(self._warned, named, self.prefix)

    def _warn(self, text: str) -> None:
        if text:
            self._state.messages.add("warning", f"{self.prefix}{text}", topic=self.prefix)

    @property
    def prefix(self) -> str:
        """Beginning of a message about one of several sensors, else empty."""
        return f"{self.name}: " if self.name else ""

    def _show(self, solved: Solved) -> None:
        self.result = solved.result
        self._cold_solved = solved.result.frame if solved.final else None
        self._shown_demand = solved.demand.without_images()
        seen = _inspection(solved.result)
        if solved.demand.images or not self.demand.images:
            self.inspection, self._imaged_frame = seen, solved.result.frame
        else:  # keep the last images
            curve, parts = seen.kappa_curve, seen.components
            self.inspection = replace(self.inspection, kappa_curve=curve, components=parts)

    def _take_cold_solve(self, solved: Solved) -> None:
        self.solve_rate.tick(time.perf_counter())
        shown, new, requested = self.result, solved.result, solved.demand
        self._remember(new.frame.index, solved.numbers, requested)
        same = shown.frame.index == new.frame.index
        wanted = self._shown_demand.products | self.demand.images
        # else another frame, or more products of this one, are shown by now
        if same and wanted <= requested.products | OBJECT_PRODUCTS:
            pose, by_object = shown.pose, shown.object_patch
            self.result = replace(new, frame=shown.frame, pose=pose, object_patch=by_object)
            self._shown_demand = replace(self._shown_demand, options=requested.options)
            self.inspection = _inspection(new)
            self._cold_solved = self._imaged_frame = shown.frame
        self._announce(solved)

    def _take_patch(self, demand: Demand, answer: tuple[Result, Numbers]) -> None:
        result, (patched, numbers) = self.result, answer
        if result.estimate is patched.estimate:  # else another is shown
            self._remember(result.frame.index, numbers, demand)
            if "components" in demand.products:
                parts = _inspection(patched).components
                self.inspection = replace(self.inspection, components=parts)
            self.result = replace(result, patch=patched.patch)
        self.patched.emit(patched)

    def _comparable(self, demand: Demand) -> bool:
        """Whether its numbers are comparable with those of the last request in a recording.

        Forces by depth alone and by depth and colour differ; each frame has one of them.
        """
        colour = self.facts.colour and not self.facts.grows
        return not colour or demand.flow == self.demand.flow

    def _remember(self, index: int, numbers: Numbers, demand: Demand) -> None:
        if not self._comparable(demand):
            return
        same_patch = demand.patch_rule == self._state.settings.patch_rule
        self.history.record(index, numbers, patch=same_patch)

    def _grow(self, frame: Frame, outages: tuple[Gap, ...]) -> None:
        """Append a frame of a live source, after those that failed since the last one."""
        known, count = self.facts.frames, frame.index + 1
        times = grown(self.facts.times_s, count, np.nan)
        times[known:] = frame.time_s
        self.facts = replace(self.facts, times_s=times, outages=outages)
        self.history.grow(count)


def _inspection(result: Result) -> Inspection:
    return result.inspection or Inspection()
