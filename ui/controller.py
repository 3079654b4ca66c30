"""Between model, clock and solver thread: decides what is asked for and when."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from PySide6.QtCore import QObject, Qt, QTimer, Signal

from bubbleviz.frames.source import FrameSource
from bubbleviz.inspection import Inspection, Look
from bubbleviz.inverse.estimator import EstimatorOptions
from bubbleviz.numbers import Numbers
from bubbleviz.pipeline import Product
from bubbleviz.result import Result
from bubbleviz.sensor import Sensor
from ui.clock import PlayClock
from ui.history import History
from ui.live.lead import Lead
from ui.needs import looks, products
from ui.rates import RateMeter
from ui.requests import (
    Analysed,
    AnalyseRequest,
    Answer,
    Compared,
    CompareRequest,
    Failed,
    Followed,
    FollowRequest,
    FrameRequest,
    NewestRequest,
    Opened,
    OpenRequest,
    PatchRequest,
    Solved,
    Thresholded,
    Waited,
)
from ui.seat import Seat
from ui.state import (
    PATCH_CHOICES,
    ChoicesChanged,
    Event,
    FrameChanged,
    FrozenChanged,
    PlayingChanged,
    RangeChanged,
    SessionState,
)
from ui.worker import Worker

POSE: frozenset[Product] = frozenset({"estimate", "patch", "pose"})
TICK_MS = 8
"""How often playback looks at its clock."""
LOOK_EVERY_S = 0.15
"""How often closer looks are taken while playing."""
AHEAD_S = 0.025
"""How early the next frame may be asked for, so that the solver has work while this is drawn."""


class Controller(QObject):
    """Asks the solver thread for what the visible things need of the frame at the cursor.

    Attributes
    ----------
    said : Signal
        A sentence for the user.
    opened : Signal
        An `Opened`: another source or sensor is open.
    shown : Signal
        A `Result` to draw.
    failed : Signal
        A `Failed` to tell the user about.
    opening : Signal
        What is being opened; empty when it is, or is not going to be.
    analysed : Signal
        Frames done and frames asked for of an analysis of all frames; equal when it is over.
    followed : Signal
        A `Followed`: another object is looked for, or none.
    solves : RateMeter
        Frames that came back from the solver.
    compared : Signal
        A `Compared`: two settings on one frame.
    inspection : Inspection
        Closer look at the frame that is shown.
    extra : frozenset of Product
        Asked of every live frame besides what is visible.
    skipped : int
        Frames playback passed by because they were over before they could be asked for.
    """

    said = Signal(str)
    opened = Signal(object)
    shown = Signal(object)
    failed = Signal(object)
    opening = Signal(str)
    analysed = Signal(int, int)
    compared = Signal(object)
    followed = Signal(object)

    def __init__(self, state: SessionState, worker: Worker) -> None:
        super().__init__()
        self.state = state
        self.worker = worker
        self.sensor: Sensor | None = None
        self.result: Result | None = None
        self.solves = RateMeter()
        self.skipped = 0
        self._session = 0
        self._opening = 0
        self._requests = 0
        self._open_source: Callable[[Sensor], FrameSource] | None = None
        self._asked: frozenset[Product] = frozenset()
        self._looked: frozenset[Look] = frozenset()
        self.inspection = Inspection()
        self._clock: PlayClock | None = None
        self._clock_read_s = 0.0
        self._came = -1
        self._awaiting = False
        self._lead = Lead()
        self._opened: Opened | None = None
        self._numbers = Numbers()
        self.extra: frozenset[Product] = frozenset()
        self._to_analyse: tuple[int, ...] = ()
        self._analysing = 0
        self._timer = QTimer(self)
        self._timer.setTimerType(Qt.TimerType.PreciseTimer)
        self._timer.setInterval(TICK_MS)
        self._timer.timeout.connect(lambda: self._tick())
        worker.answered.connect(self._on_answer)
        state.subscribe(self._on_event)

    @property
    def dropped(self) -> int:
        """Frames left out on purpose since the source was opened."""
        return self.skipped + self.worker.dropped

    @property
    def open_source(self) -> Callable[[Sensor], FrameSource] | None:
        """Opener of what is open; None before the first."""
        return self._open_source

    @property
    def solved_session(self) -> int:
        """Generation of the session that is open; 0 before the first."""
        return self._session

    def open(
        self,
        what: str,
        open_source: Callable[[Sensor], FrameSource],
        open_sensor: Callable[[], Sensor],
        *,
        frame: int = 0,
        playing: bool = True,
        live: bool = False,
    ) -> None:
        """Open a source with a sensor in the solver thread; what is open stays until it works."""
        self._opening += 1
        needed = products(self.state.choices)
        request = OpenRequest(
            session=self._opening,
            what=what,
            open_source=open_source,
            open_sensor=open_sensor,
            frame=frame,
            products=needed,
            kappa=self.state.choices.kappa,
            cloud_points=self.state.choices.cloud_points,
            solver=self.state.choices.solver,
            looks=looks(self.state.choices),
            playing=playing,
            live=live,
        )
        self.cancel_opening()
        self._waiting = request
        self.worker.ask(request)
        self.opening.emit(what)

    def cancel_opening(self) -> None:
        """Open nothing; what is open stays, and the solver stops at its next step."""
        if self._waiting is not None:
            self._waiting.cancelled.set()
            self._waiting = None
            self.opening.emit("")

    _waiting: OpenRequest | None = None

    def open_recording(
        self, path: Path, sensor_file: Path | None = None, truth: Path | None = None
    ) -> None:
        """Open a recording with a sensor, with the present one, or with the preset that fits."""
        from bubbleviz.sensor import load_sensor
        from ui.sources import recording, sensor_for

        sensor = self.sensor
        if sensor_file is not None:
            self.open(path.name, recording(path, truth), lambda: load_sensor(sensor_file))
        elif sensor is not None:
            self.open(path.name, recording(path, truth), lambda: sensor_for(path, sensor))

    def open_truth(self, path: Path) -> None:
        """Have the recording that is open, one of a simulation, known by its TRUTH.npz."""
        from ui.sources import RecordingOpener

        opener, sensor = self._open_source, self.sensor
        if isinstance(opener, RecordingOpener) and sensor is not None:
            self._open_source_again(path.name, replace(opener, truth=path), lambda: sensor)
        else:
            self.said.emit(f"{path}: open the recording of that simulation first")

    def open_sensor(self, path: Path) -> None:
        """Use another sensor with the present source."""
        from bubbleviz.sensor import load_sensor

        self._open_again(path.name, lambda: load_sensor(path))

    def use_sensor(self, sensor: Sensor) -> None:
        """Use another sensor, which is loaded already, with the present source."""
        self._open_again(sensor.name, lambda: sensor)

    def _open_again(self, what: str, open_sensor: Callable[[], Sensor]) -> None:
        """Open the present source anew, at the present frame."""
        if self._open_source is not None:
            self._open_source_again(what, self._open_source, open_sensor)

    def _open_source_again(
        self,
        what: str,
        open_source: Callable[[Sensor], FrameSource],
        open_sensor: Callable[[], Sensor],
    ) -> None:
        """Open another form of the present source, at the present frame."""
        if self.state.facts is not None:
            self.open(
                what,
                open_source,
                open_sensor,
                frame=self.state.frame,
                playing=self.state.playing,
                live=self.state.facts.live,
            )

    def close(self) -> None:
        """Stop the timer and the solver thread."""
        self._timer.stop()
        self.worker.close()

    def analyse(self, needed: frozenset[Product]) -> None:
        """Compute what is not known yet of all frames while the solver has nothing else to do."""
        self._to_analyse = tuple(int(k) for k in self.state.history.missing(needed))
        self._analysing = len(self._to_analyse)
        self._analysed_products = needed
        self._ask_analysis()

    def follow(
        self,
        object_name: str | None,
        unit: Literal["m", "mm"] | None,
        start: np.ndarray | None,
        *,
        fit: bool,
    ) -> None:
        """Look for another object, or for none; `fit` it to the frame at the cursor at once."""
        if self.state.facts is None:
            return
        needed = products(self.state.choices) | POSE
        request = self._frame_request(needed) if fit else None
        kappa = self.state.choices.kappa
        self.worker.ask(FollowRequest(self._session, object_name, unit, start, kappa, request))

    def compare(self, settings: tuple[EstimatorOptions, EstimatorOptions]) -> None:
        """Measure two settings on the frame at the cursor, when the solver has nothing else."""
        kappa, _ = self._rule
        self.worker.ask(CompareRequest(self._session, self.state.frame, settings, kappa))

    @property
    def _rule(self) -> tuple[float | None, float]:
        """What makes a patch of a contact pressure."""
        return self.state.choices.kappa, self.state.choices.least_area_m2

    @property
    def analysing(self) -> bool:
        """An analysis of all frames goes on."""
        return bool(self._to_analyse)

    def stop_analysis(self) -> None:
        """Leave the rest; what was computed stays."""
        self._to_analyse, self._analysing = (), 0
        self.analysed.emit(0, 0)

    # -- events of the model ----------------------------------------------------------------

    def _on_event(self, event: Event) -> None:
        if isinstance(event, FrameChanged):
            if not (event.by_playback and self._grows):
                self._ask_frame()
            if not event.by_playback and not self.state.frozen:
                self._start_clock()
        elif isinstance(event, PlayingChanged):
            if not event.playing and self._looked and self.result is not None:
                self._ask_frame()
            self._start_clock()
            self._timer.start() if event.playing and not self._grows else self._timer.stop()
            self._ask_newest()
        elif isinstance(event, FrozenChanged):
            self._ask_newest()
        elif isinstance(event, RangeChanged) and self.state.facts is not None:
            if not self._grows:
                self._clock = PlayClock(self.state.facts.times_s, event.frames)
            self._start_clock()
        elif isinstance(event, ChoicesChanged):
            self._on_choices(event.names)

    def _on_choices(self, names: frozenset[str]) -> None:
        if names & {"speed", "loop", "every_frame"}:
            self._start_clock()
        sensor = self.sensor
        if "solver" in names and sensor is not None:
            self._open_again(self.state.choices.solver or "default solver", lambda: sensor)
        elif "cloud_points" in names or self._lacks_something:
            self._ask_frame()
        elif names & PATCH_CHOICES:
            self._ask_patch()

    @property
    def _lacks_something(self) -> bool:
        """Something is visible that was not asked for."""
        choices = self.state.choices
        return not (products(choices) <= self._asked and looks(choices) <= self._looked)

    def _start_clock(self) -> None:
        if self._clock is not None:
            self._clock_read_s = 0.0
            frame = self.state.now if self.state.frozen else self.state.frame
            self._clock.start(frame, time.perf_counter(), self.state.choices.speed)

    def _tick(self, ahead_s: float = 0.0) -> None:
        if self._clock is None or not self.state.playing:
            return
        now = max(time.perf_counter() + ahead_s, self._clock_read_s)  # never back
        self._clock_read_s = now
        loop = self.state.choices.loop
        if self.state.choices.every_frame:
            if self._came != self.state.frame and not self.state.frozen:
                return
            index, ended = self._clock.following(now, loop=loop)
        else:
            index, skipped, ended = self._clock.due(now, loop=loop)
            self.skipped += 0 if self.state.frozen else skipped
        self.state.go_on(index)
        if ended:
            self.state.set_playing(False)

    def change_seat(self, seat: Seat, placed: Callable[[], None]) -> Seat:
        """Turn to the other sensor of a session; gives back the one the panels showed.

        Parameters
        ----------
        seat : Seat
        placed : callable
            Called before anything is drawn.
        """
        if self._opened is None or self.result is None or self.state.facts is None:
            raise RuntimeError("nothing is open yet")
        playing, frozen = self.state.playing, self.state.frozen
        shown = replace(
            self._opened,
            facts=self.state.facts,
            frame=self.result.frame.index,
            result=self.result,
            numbers=self._numbers,
            inspection=self.inspection,
        )
        mine = Seat(self.worker, shown, self.state.history, self._awaiting)
        self.worker.answered.disconnect(self._on_answer)
        self.worker = seat.worker
        self.worker.answered.connect(self._on_answer)
        self._opening = max(self._opening, seat.opened.request.session)
        placed()
        self._change(seat.opened, seat.history, awaiting=seat.awaiting)
        self._show(seat.opened.result)
        self.state.set_playing(playing)
        self.state.freeze(frozen)
        self._ask_frame()
        return mine

    # -- live sources -----------------------------------------------------------------------

    @property
    def _grows(self) -> bool:
        return self.state.facts is not None and self.state.facts.grows

    def _ask_newest(self) -> None:
        """Ask for the newest frame of a live source, unless that is asked for or unwanted now."""
        state = self.state
        if self._awaiting or not self._grows or not state.playing or state.frozen:
            return
        self._awaiting = True
        choices, now = state.choices, time.perf_counter()
        self._asked, self._looked = products(choices), looks(choices)
        self.worker.ask(
            NewestRequest(
                self._session,
                self._asked | self.extra,
                choices.kappa,
                choices.cloud_points,
                now,
                self._looks_due(),
                choices.least_area_m2,
                now + self._lead.hold_s,
            )
        )

    def _on_newest(self, answer: Solved) -> None:
        """Ask for the next before this one is drawn, so that the solver has work meanwhile."""
        frame, state = answer.result.frame, self.state
        self._awaiting, now = False, time.perf_counter()
        self.solves.tick(now)
        self._lead.waited(now - answer.done_s)
        state.grow(frame.time_s)
        self._ask_newest()
        waited_s = (time.time_ns() - frame.arrival_ns) * 1e-9
        numbers = replace(answer.numbers, latency_ms=1e3 * waited_s)
        self._remember(frame.index, numbers, _rule_of(answer.request))
        if state.frame == frame.index:
            self.inspection, self._numbers = self._newest_look(answer), answer.numbers
            self._show(answer.result)

    # -- requests and answers ---------------------------------------------------------------

    def _ask_frame(self) -> None:
        if self.state.facts is None:
            return
        self._asked, self._looked = products(self.state.choices), looks(self.state.choices)
        self.worker.ask(self._frame_request(self._asked))

    def _frame_request(self, needed: frozenset[Product]) -> FrameRequest:
        """Request for products of the frame at the cursor."""
        self._requests += 1
        return FrameRequest(
            self._session,
            self._requests,
            self.state.frame,
            needed,
            self.state.choices.kappa,
            self.state.choices.cloud_points,
            time.perf_counter(),
            self._looks_due(),
            self.state.choices.least_area_m2,
        )

    def _looks_due(self) -> frozenset[Look]:
        """Closer looks to ask for now: while playing not at every frame, nobody sees so many."""
        now = time.perf_counter()
        if self.state.playing and now - self._looked_s < LOOK_EVERY_S:
            return frozenset()
        self._looked_s = now
        return looks(self.state.choices)

    def _newest_look(self, answer: Solved) -> Inspection:
        """Closer look of an answer, or the last one where it was left out."""
        left_out = bool(self._looked) and not answer.request.looks
        return self.inspection if left_out else answer.inspection

    _looked_s = 0.0

    def _ask_patch(self) -> None:
        result = self.result
        if result is None or result.estimate is None or "patch" not in self._asked:
            return
        self._requests += 1
        self.worker.ask(
            PatchRequest(
                self._session,
                self._requests,
                result,
                self.state.choices.kappa,
                pixel_mask="pixel_mask" in self._asked,
                looks=self._looked & {"components"},
                least_area_m2=self.state.choices.least_area_m2,
            )
        )

    def _on_answer(self, answer: Answer) -> None:
        if self._waiting is not None and answer.request is self._waiting:
            self._waiting = None
            self.opening.emit("")
        if isinstance(answer, Failed):
            self._awaiting &= not isinstance(answer.request, NewestRequest)
            if isinstance(answer.request, AnalyseRequest):
                self.stop_analysis()
            self.failed.emit(answer)
        elif isinstance(answer, Opened):
            self._on_opened(answer)
        elif answer.request.session != self._session:
            return
        elif isinstance(answer, Followed):
            self.followed.emit(answer)
            if answer.solved is not None:
                self._on_solved(answer.solved)
        elif isinstance(answer, Waited):
            self._awaiting = False
            self._ask_newest()
        elif isinstance(answer, Solved):
            newest = isinstance(answer.request, NewestRequest)
            self._on_newest(answer) if newest else self._on_solved(answer)
        elif isinstance(answer, Analysed):
            self._on_analysed(answer)
        elif isinstance(answer, Compared):
            self.compared.emit(answer)
        elif (
            isinstance(answer, Thresholded)
            and self.result is not None
            and self.result.estimate is answer.request.result.estimate
        ):
            self._remember(answer.result.frame.index, answer.numbers, _rule_of(answer.request))
            if "components" in answer.request.looks:
                parts = answer.inspection.components
                self.inspection = replace(self.inspection, components=parts)
            self._show(replace(self.result, patch=answer.result.patch))

    def _on_solved(self, answer: Solved) -> None:
        now = time.perf_counter()
        self.solves.tick(now)
        frame, request = answer.result.frame, answer.request
        self._came = frame.index
        self._tick(AHEAD_S)
        waited_s = now - request.asked_s
        if frame.arrival_ns:
            waited_s = (time.time_ns() - frame.arrival_ns) * 1e-9
        numbers = replace(answer.numbers, latency_ms=1e3 * waited_s)
        self._remember(frame.index, numbers, _rule_of(request))
        self.inspection, self._numbers = self._newest_look(answer), answer.numbers
        self._show(answer.result)
        if _rule_of(request) != self._rule:
            self._ask_patch()

    def _remember(self, frame: int, numbers: Numbers, rule: tuple[float | None, float]) -> None:
        self.state.remember([frame], [numbers], same_patch=rule == self._rule)

    def _ask_analysis(self) -> None:
        done = self._analysing - len(self._to_analyse)
        self.analysed.emit(done, self._analysing)
        if self._to_analyse:
            wanted = self._analysed_products
            request = AnalyseRequest(self._session, self._to_analyse, wanted, *self._rule)
            self.worker.ask(request)

    def _on_analysed(self, answer: Analysed) -> None:
        frames, count = answer.request.frames, len(answer.numbers)
        same = _rule_of(answer.request) == self._rule
        self.state.remember(frames[:count], answer.numbers, same_patch=same)
        if frames is self._to_analyse:
            self._to_analyse = frames[count:] if same else frames
            self._ask_analysis()

    _analysed_products: frozenset[Product] = frozenset()

    def _on_opened(self, answer: Opened) -> None:
        """Show what was opened."""
        self._change(answer, None, awaiting=False)
        self._remember(answer.frame, answer.numbers, (answer.request.kappa, 0.0))
        self._show(answer.result)
        if self._lacks_something:
            self._ask_frame()
        elif self._rule[1] > 0.0:
            self._ask_patch()

    def _change(self, answer: Opened, history: History | None, *, awaiting: bool) -> None:
        """Turn to another source, of which a history may be known."""
        self._opened, self._numbers = answer, answer.numbers
        self._session, self._awaiting = answer.request.session, awaiting
        self.result = None  # the old source's: nothing may show it on the new sensor
        self._open_source = answer.request.open_source
        self.sensor = answer.sensor
        self._asked, self._looked = answer.request.products, answer.request.looks
        self.stop_analysis()
        self.skipped = self.worker.dropped = 0
        self.opened.emit(answer)
        self.state.set_playing(False)
        self._clock = None
        self.state.open(answer.facts, answer.frame, playing=False, history=history)
        if not answer.facts.grows:
            self._clock = PlayClock(answer.facts.times_s, self.state.play_range)
        self.state.set_playing(answer.request.playing)
        self._came = answer.frame
        self.inspection = answer.inspection

    def _show(self, result: Result) -> None:
        self.result = result
        self.shown.emit(result)


def _rule_of(
    request: FrameRequest | NewestRequest | PatchRequest | AnalyseRequest,
) -> tuple[float | None, float]:
    return request.kappa, request.least_area_m2
