"""Work that may wait for a disk or a network, done in order, away from the window."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from PySide6.QtCore import QObject, Qt, Signal

from bubbleviz.errors import InputError

Then = Callable[[Any, str], None]
"""Gets what the work returned, or None and why it failed, in words."""


class Background(QObject):
    """One thread; what is to be done when something is through is done in the GUI thread."""

    _through = Signal(object, object, str)

    def __init__(self, name: str) -> None:
        super().__init__()
        self._pool = ThreadPoolExecutor(1, thread_name_prefix=name)
        self._through.connect(self._hand_over, Qt.ConnectionType.QueuedConnection)

    def do(self, work: Callable[[], Any], then: Then | None = None) -> None:
        """Do something after all that waits already, `then` something in the GUI thread."""

        def run() -> None:
            outcome, problem = None, ""
            try:
                outcome = work()
            except (InputError, OSError) as error:
                problem = str(error)
            if then is not None:
                self._through.emit(then, outcome, problem)

        self._pool.submit(run)

    def close(self) -> None:
        """Wait until all of it is done."""
        self._pool.shutdown(wait=True)

    def _hand_over(self, then: Then, outcome: Any, problem: str) -> None:
        then(outcome, problem)
