"""Analysis of all frames, while the solver has nothing else to do."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from PySide6.QtCore import QObject, Signal

from bubbleviz.pipeline import FrameOptions, Product
from bubbleviz_ui.engine.requests import Analysed, AnalyseRequest
from bubbleviz_ui.model.choices import PATCH_CHOICES
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
        self._count, self._kept_only = 0, False
        state.choices_changed.connect(self._on_choices)

    @property
    def busy(self) -> bool:
        """It goes on."""
        return bool(self._frames)

    def start(self) -> None:
        """Compute what the chosen plots need and is not known yet, of all frames."""
        products = plotted(self._state.choices)
        self._begin(products, self._state.history.missing(products), kept_only=False)

    def _find_patches_again(self) -> None:
        """Find those that another κ has made untrue, of estimates that are kept."""
        if self.busy and not self._kept_only:
            self.start()
        else:
            self._begin(frozenset({"patch"}), self._state.history.forgotten, kept_only=True)

    def stop(self) -> None:
        """Leave the rest; what was computed stays."""
        self._frames, self._count = (), 0
        self.progressed.emit(0, 0)

    def turn_to(self, session: int) -> None:
        """Stop; what is asked from now on is of another session."""
        self._session = session
        self.stop()

    def take(self, answer: Analysed) -> None:
        """Remember numbers, and ask for more."""
        frames, count = answer.request.frames, len(answer.numbers)
        same = answer.request.demand.rule == self._state.choices.rule
        known = {k: each for k, each in zip(frames, answer.numbers, strict=False) if each}
        self._state.remember(tuple(known), tuple(known.values()), same_patch=same)
        if frames is self._frames:
            self._frames = frames[count:]
            self._ask_rest()

    def _on_choices(self, names: frozenset[str]) -> None:
        if names & PATCH_CHOICES:
            self._find_patches_again()

    def _begin(self, products: frozenset[Product], frames: np.ndarray, *, kept_only: bool) -> None:
        self._products, self._kept_only = products, kept_only
        self._frames = tuple(int(k) for k in frames)
        self._count = len(self._frames)
        self._ask_rest()

    def _ask_rest(self) -> None:
        self.progressed.emit(self._count - len(self._frames), self._count)
        if self._frames:
            choices = self._state.choices
            options = FrameOptions(*choices.rule)
            demand = Demand(self._products, options=options, shear=Demand.of(choices).shear)
            request = AnalyseRequest(self._session, demand, self._frames, self._kept_only)
            self._ask(request)
