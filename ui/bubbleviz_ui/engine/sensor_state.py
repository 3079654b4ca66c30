"""One sensor of a session: its solver thread and what is known so far."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bubbleviz_ui.engine.requests import Opened, Solved
from bubbleviz_ui.engine.solver_thread import Worker
from bubbleviz_ui.model.frame_history import History, grown


@dataclass(frozen=True)
class SensorState:
    """What is handed over when the panels turn to the other sensor.

    Attributes
    ----------
    worker : Worker
    opened : Opened
        As it was opened, with the frame, the result and the facts of now.
    history : History
    awaiting : bool
        The newest frame is being waited for.
    """

    worker: Worker
    opened: Opened
    history: History
    awaiting: bool

    def with_newest(self, answer: Solved) -> SensorState:
        """One frame further; the history is the same object, one frame longer."""
        facts, frame = self.opened.facts, answer.result.frame
        times = grown(facts.times_s, frame.index + 1, np.nan)
        times[-1] = frame.time_s
        self.history.grow(frame.index + 1)
        self.history.take(frame.index, answer.numbers, patch=True)
        longer = replace(self.opened, facts=replace(facts, times_s=times))
        return replace(self, opened=longer).showing(answer)

    def showing(self, answer: Solved) -> SensorState:
        """With another result on show."""
        opened = replace(
            self.opened,
            frame=answer.result.frame.index,
            result=answer.result,
            numbers=answer.numbers,
            inspection=answer.inspection,
        )
        return replace(self, opened=opened)
