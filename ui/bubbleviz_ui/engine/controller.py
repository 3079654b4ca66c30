"""Between model and solver thread: decides what is asked for and when."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np
from PySide6.QtCore import QObject, Signal

from bubbleviz.diagnostics.frame_numbers import Numbers
from bubbleviz.diagnostics.inspector import Inspection, Look
from bubbleviz.inverse.estimator import EstimatorOptions
from bubbleviz.pipeline import Product
from bubbleviz.result import Result
from bubbleviz.sensor import Sensor
from bubbleviz_ui.engine.analysis import Analysis
from bubbleviz_ui.engine.opening import Opening
from bubbleviz_ui.engine.request_delay import RequestDelay
from bubbleviz_ui.engine.requests import (
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
    PatchRequest,
    Request,
    Solved,
    Thresholded,
    Waited,
)
from bubbleviz_ui.engine.sensor_state import SensorState
from bubbleviz_ui.engine.solver_thread import Worker
from bubbleviz_ui.model.choices import PATCH_CHOICES, Rule, rule_of
from bubbleviz_ui.model.demand import looks, products
from bubbleviz_ui.model.frame_history import History
from bubbleviz_ui.model.rate_meter import RateMeter
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.playback.player import Player

POSE: frozenset[Product] = frozenset({"estimate", "patch", "pose"})
LOOK_EVERY_S = 0.15
"""How often closer looks are taken while playing."""


class Controller(QObject):
    """Asks the solver thread for what the visible things need of the frame at the cursor.

    Attributes
    ----------
    opened : Signal
        An `Opened`: another source or sensor is open.
    shown : Signal
        A `Result` to draw.
    failed : Signal
        A `Failed` to tell the user about.
    followed : Signal
        A `Followed`: another object is looked for, or none.
    compared : Signal
        A `Compared`: two settings on one frame.
    opening : Opening
        Opens other things.
    analysis : Analysis
        Of all frames.
    player : Player
        Of recordings.
    solves : RateMeter
        Frames that came back from the solver.
    inspection : Inspection
        Closer look at the frame that is shown.
    extra : frozenset of Product
        Asked of every live frame besides what is visible.
    """

    opened = Signal(object)
    shown = Signal(object)
    failed = Signal(object)
    compared = Signal(object)
    followed = Signal(object)

    def __init__(self, state: SessionState, worker: Worker) -> None:
        super().__init__()
        self.state = state
        self.worker = worker
        self.opening = Opening(state, self._ask)
        self.analysis = Analysis(state, self._ask)
        self.player = Player(state)
        self.result: Result | None = None
        self.inspection = Inspection()
        self.solves = RateMeter()
        self.extra: frozenset[Product] = frozenset()
        self._session = self._requests = 0
        self._asked: frozenset[Product] = frozenset()
        self._looked: frozenset[Look] = frozenset()
        self._looked_s = 0.0
        self._numbers = Numbers()
        self._awaiting = False
        self._request_delay = RequestDelay()
        worker.answered.connect(self._on_answer)
        state.frame_changed.connect(self._on_frame)
        state.playing_changed.connect(self._on_playing)
        state.frozen_changed.connect(self._ask_newest)
        state.choices_changed.connect(self._on_choices)

    @property
    def dropped(self) -> int:
        """Frames left out on purpose since the source was opened."""
        return self.player.skipped + self.worker.dropped

    @property
    def sensor(self) -> Sensor | None:
        """The sensor in use; None before the first."""
        return self.opening.sensor

    @property
    def solved_session(self) -> int:
        """Generation of the session that is open; 0 before the first."""
        return self._session

    def close(self) -> None:
        """Stop playback and the solver thread."""
        self.player.close()
        self.worker.close()

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

    def compare(self, settings: tuple[EstimatorOptions, ...]) -> None:
        """Measure two settings, or none, on the frame at the cursor when there is time."""
        kappa, _ = rule_of(self.state.choices)
        self.worker.ask(CompareRequest(self._session, self.state.frame, settings, kappa))

    # -- the model changed --------------------------------------------------------------------

    def _on_frame(self, _: int, by_playback: bool) -> None:
        if not (by_playback and self._grows):
            self._ask_frame()

    def _on_playing(self, playing: bool) -> None:
        if not playing and self._looked and self.result is not None:
            self._ask_frame()
        self._ask_newest()

    def _on_choices(self, names: frozenset[str]) -> None:
        sensor = self.sensor
        if "solver" in names and sensor is not None:
            self.opening.reopen(self.state.choices.solver or "default solver", lambda: sensor)
        elif "cloud_points" in names or self._lacks_something:
            self._ask_frame()
        elif names & PATCH_CHOICES:
            self._ask_patch()

    @property
    def _lacks_something(self) -> bool:
        """Something is visible that was not asked for."""
        choices = self.state.choices
        return not (products(choices) <= self._asked and looks(choices) <= self._looked)

    def swap_sensor(self, other: SensorState, placed: Callable[[], None]) -> SensorState:
        """Turn to the other sensor of a session; gives back the one the panels showed.

        Parameters
        ----------
        other : SensorState
        placed : callable
            Called before anything is drawn.
        """
        opened = self.opening.present
        if opened is None or self.result is None or self.state.facts is None:
            raise RuntimeError("nothing is open yet")
        playing, frozen = self.state.playing, self.state.frozen
        shown = replace(
            opened,
            facts=self.state.facts,
            frame=self.result.frame.index,
            result=self.result,
            numbers=self._numbers,
            inspection=self.inspection,
        )
        mine = SensorState(self.worker, shown, self.state.history, self._awaiting)
        self.worker.answered.disconnect(self._on_answer)
        self.worker = other.worker
        self.worker.answered.connect(self._on_answer)
        placed()
        self._change(other.opened, other.history, awaiting=other.awaiting)
        self._show(other.opened.result)
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
                now + self._request_delay.hold_s,
            )
        )

    def _on_newest(self, answer: Solved) -> None:
        """Ask for the next before this one is drawn, so that the solver has work meanwhile."""
        frame, state = answer.result.frame, self.state
        self._awaiting, now = False, time.perf_counter()
        self.solves.tick(now)
        self._request_delay.waited(now - answer.done_s)
        state.grow(frame.time_s)
        self._ask_newest()
        waited_s = (time.time_ns() - frame.arrival_ns) * 1e-9
        numbers = replace(answer.numbers, latency_ms=1e3 * waited_s)
        self._remember(frame.index, numbers, rule_of(answer.request))
        if state.frame == frame.index:
            self.inspection, self._numbers = self._newest_look(answer), answer.numbers
            self._show(answer.result)

    # -- requests and answers ---------------------------------------------------------------

    def _ask(self, request: Request) -> None:
        """Ask the solver thread that is in use now."""
        self.worker.ask(request)

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
        self.opening.look_at(answer)
        if isinstance(answer, Failed):
            self._awaiting &= not isinstance(answer.request, NewestRequest)
            if isinstance(answer.request, AnalyseRequest):
                self.analysis.stop()
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
            self.analysis.take(answer)
        elif isinstance(answer, Compared):
            self.compared.emit(answer)
        elif (
            isinstance(answer, Thresholded)
            and self.result is not None
            and self.result.estimate is answer.request.result.estimate
        ):
            self._remember(answer.result.frame.index, answer.numbers, rule_of(answer.request))
            if "components" in answer.request.looks:
                parts = answer.inspection.components
                self.inspection = replace(self.inspection, components=parts)
            self._show(replace(self.result, patch=answer.result.patch))

    def _on_solved(self, answer: Solved) -> None:
        now = time.perf_counter()
        self.solves.tick(now)
        frame, request, numbers = answer.result.frame, answer.request, answer.numbers
        self.player.came(frame.index)
        if frame.arrival_ns:
            numbers = replace(numbers, latency_ms=1e-6 * (time.time_ns() - frame.arrival_ns))
        elif request.asked_s is not None:
            numbers = replace(numbers, latency_ms=1e3 * (now - request.asked_s))
        self._remember(frame.index, numbers, rule_of(request))
        self.inspection, self._numbers = self._newest_look(answer), answer.numbers
        self._show(answer.result)
        if rule_of(request) != rule_of(self.state.choices):
            self._ask_patch()

    def _remember(self, frame: int, numbers: Numbers, rule: Rule) -> None:
        self.state.remember([frame], [numbers], same_patch=rule == rule_of(self.state.choices))

    def _on_opened(self, answer: Opened) -> None:
        """Show what was opened."""
        self._change(answer, None, awaiting=False)
        self._remember(answer.frame, answer.numbers, (answer.request.kappa, 0.0))
        self._show(answer.result)
        if self._lacks_something:
            self._ask_frame()
        elif self.state.choices.least_area_m2 > 0.0:
            self._ask_patch()

    def _change(self, answer: Opened, history: History | None, *, awaiting: bool) -> None:
        """Turn to another source, of which a history may be known."""
        self._numbers = answer.numbers
        self._session, self._awaiting = answer.request.session, awaiting
        self.result = None  # the old source's: nothing may show it on the new sensor
        self._asked, self._looked = answer.request.products, answer.request.looks
        self.opening.turn_to(answer)
        self.analysis.turn_to(self._session)
        self.player.turn_to(answer.frame)
        self.worker.dropped = 0
        self.opened.emit(answer)
        self.state.set_playing(False)
        self.state.open(answer.facts, answer.frame, playing=False, history=history)
        self.state.set_playing(answer.request.playing)
        self.inspection = answer.inspection

    def _show(self, result: Result) -> None:
        self.result = result
        self.shown.emit(result)
