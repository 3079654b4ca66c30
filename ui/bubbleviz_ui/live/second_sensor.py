"""The sensor of a session that the panels do not show: solved and drawn all the same."""

from __future__ import annotations

import time
from dataclasses import replace

from PySide6.QtCore import QObject, Signal

from bubbleviz.pipeline import Product
from bubbleviz.sensor import Sensor
from bubbleviz_ui.engine.requests import (
    Answer,
    Failed,
    FrameRequest,
    NewestRequest,
    Opened,
    OpenRequest,
    Solved,
    Waited,
)
from bubbleviz_ui.engine.sensor_state import SensorState
from bubbleviz_ui.engine.solver_thread import Worker
from bubbleviz_ui.live.live_frames import LiveFrames, LiveOpener
from bubbleviz_ui.model.demand import products
from bubbleviz_ui.model.frame_history import History
from bubbleviz_ui.model.rate_meter import RateMeter
from bubbleviz_ui.model.session_state import SessionState


class SecondSensor(QObject):
    """Asks a solver thread of its own for what is visible in the view, and no more.

    Time is the session's: while that stands still, it shows the frame of the same moment.

    Attributes
    ----------
    shown : Signal
        Another `Result` to draw; the next one is made once `follow` is called.
    opened : Signal
        Its first result is there.
    failed : Signal
        A `Failed`.
    solves : RateMeter
    extra : frozenset of Product
        Asked of every frame besides what is visible.
    """

    shown = Signal(object)
    opened = Signal()
    failed = Signal(object)

    def __init__(self, session: SessionState, sensor: Sensor, frames: LiveFrames) -> None:
        super().__init__()
        self.solves = RateMeter()
        self.extra: frozenset[Product] = frozenset()
        self._session = session
        self._state: SensorState | None = None
        self._awaiting = False
        self._worker = Worker()
        self._worker.answered.connect(self._on_answer)
        choices = session.choices
        self._worker.ask(
            OpenRequest(
                session=1,
                what=frames.name,
                open_source=LiveOpener(frames),
                open_sensor=lambda: sensor,
                frame=0,
                products=self._needed,
                kappa=choices.kappa,
                cloud_points=choices.cloud_points,
                solver=choices.solver,
                playing=True,
                live=True,
            )
        )

    @property
    def open(self) -> Opened | None:
        """What is open, with the result that is shown; None before the first."""
        return None if self._state is None else self._state.opened

    def give_up(self) -> SensorState:
        """Hand the solver thread over, with all that is known."""
        state = self._state
        if state is None:
            raise RuntimeError("nothing is open yet")
        self._worker.answered.disconnect(self._on_answer)
        return replace(state, awaiting=self._awaiting)

    def take(self, state: SensorState) -> None:
        """Go on with another solver thread, of the other sensor."""
        self._state, self._worker, self._awaiting = state, state.worker, state.awaiting
        self._worker.answered.connect(self._on_answer)
        self.follow()

    def follow(self) -> None:
        """Do what the session does: go on, or show the frame of its moment."""
        state, session = self._state, self._session
        if state is None or session.facts is None:
            return
        if session.playing and not session.frozen:
            self._ask_newest(state)
            return
        frames = _frames(state)
        time_s = float(session.facts.times_s[session.frame])
        choices, number = session.choices, state.opened.request.session
        self._worker.ask(
            FrameRequest(
                number,
                0,
                frames.at(time_s),
                self._needed,
                choices.kappa,
                choices.cloud_points,
                least_area_m2=choices.least_area_m2,
            )
        )

    def close(self) -> None:
        """Stop the solver thread."""
        self._worker.close()
        self._state = None

    @property
    def _needed(self) -> frozenset[Product]:
        return products(replace(self._session.choices, panels=frozenset()))

    def _ask_newest(self, state: SensorState) -> None:
        if self._awaiting:
            return
        self._awaiting = True
        choices = self._session.choices
        self._worker.ask(
            NewestRequest(
                state.opened.request.session,
                self._needed | self.extra,
                choices.kappa,
                choices.cloud_points,
                least_area_m2=choices.least_area_m2,
            )
        )

    def _on_answer(self, answer: Answer) -> None:
        if isinstance(answer, Opened):
            self._state = SensorState(self._worker, answer, History(answer.facts.frames), False)
            self.opened.emit()
            self.follow()
        elif isinstance(answer, Failed):
            self._awaiting = False
            self.failed.emit(answer)
        elif isinstance(answer, Waited):
            self._awaiting = False
            self._go_on()
        elif isinstance(answer, Solved) and self._state is not None:
            self._on_solved(answer, self._state)

    def _on_solved(self, answer: Solved, state: SensorState) -> None:
        if isinstance(answer.request, NewestRequest):
            self._awaiting = False
            self.solves.tick(time.perf_counter())
            state = self._state = state.with_newest(answer)
        else:
            state = self._state = state.showing(answer)
        self.shown.emit(state.opened.result)

    def _go_on(self) -> None:
        if self._state is not None and self._session.playing and not self._session.frozen:
            self._ask_newest(self._state)


def _frames(state: SensorState) -> LiveFrames:
    opener = state.opened.request.open_source
    if not isinstance(opener, LiveOpener):
        raise TypeError("the second sensor of a session is live")
    return opener.frames
