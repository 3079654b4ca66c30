"""Analysis of all frames, while the solver has nothing else to do."""

from __future__ import annotations

from collections.abc import Callable

from PySide6.QtCore import QObject, Signal

from bubbleviz.pipeline import FrameOptions, Product
from bubbleviz_ui.engine.requests import Analysed, AnalyseRequest
from bubbleviz_ui.model.demand import Demand, plotted
from bubbleviz_ui.model.session_state import SessionState


class Analysis(QObject):
    """Has the numbers computed that are not known yet, a part of the frames at a time.

    Parameters
    ----------
    state : SessionState
        Remembers the numbers.
    ask : callable
        Takes a request to the solver thread.

    Attributes
    ----------
    progressed : Signal
        Frames done and frames asked for; equal when it is over.
    """

    progressed = Signal(int, int)

    def __init__(self, state: SessionState, ask: Callable[[AnalyseRequest], None]) -> None:
        super().__init__()
        self._state, self._ask = state, ask
        self._session = 0
        self._frames: tuple[int, ...] = ()
        self._products: frozenset[Product] = frozenset()
        self._count = 0

    @property
    def busy(self) -> bool:
        """It goes on."""
        return bool(self._frames)

    def start(self) -> None:
        """Compute what the chosen plots need and is not known yet, of all frames."""
        self._products = plotted(self._state.choices)
        missing = self._state.history.missing(self._products)
        self._frames = tuple(int(k) for k in missing)
        self._count = len(self._frames)
        self._ask_rest()

    def stop(self) -> None:
        """Leave the rest; what was computed stays."""
        self._frames, self._count = (), 0
        self.progressed.emit(0, 0)

    def turn_to(self, session: int) -> None:
        """Stop; what is asked from now on is of another session."""
        self._session = session
        self.stop()

    def take(self, answer: Analysed) -> None:
        """Remember numbers, and ask for more; anew where κ is another by now."""
        frames, count = answer.request.frames, len(answer.numbers)
        same = answer.request.demand.rule == self._state.choices.rule
        self._state.remember(frames[:count], answer.numbers, same_patch=same)
        if frames is self._frames:
            self._frames = frames[count:] if same else frames
            self._ask_rest()

    def _ask_rest(self) -> None:
        self.progressed.emit(self._count - len(self._frames), self._count)
        if self._frames:
            options = FrameOptions(*self._state.choices.rule)
            demand = Demand(self._products, options=options)
            self._ask(AnalyseRequest(self._session, demand, self._frames))
