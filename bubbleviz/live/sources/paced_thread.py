"""A thread that delivers messages on schedule and can be stopped immediately."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable


class PacedThread:
    """Runs a function in a thread until it returns or is stopped.

    Parameters
    ----------
    run : callable
        Called with this object; it asks `wait_until` for the time and ends when that says no.
    name : str
        Of the thread.

    Attributes
    ----------
    problem : str
        What the function failed at; empty while it has not.
    """

    def __init__(self, run: Callable[[PacedThread], None], name: str) -> None:
        self.problem = ""
        self._run = run
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._main, name=name, daemon=True)
        self._thread.start()

    def wait_until(self, time_s: float) -> bool:
        """Sleep until a time of `time.monotonic`; False when stopped, True when it is due."""
        return not self._stop.wait(max(time_s - time.monotonic(), 0.0))

    @property
    def stopping(self) -> bool:
        """Whether stopping was requested."""
        return self._stop.is_set()

    @property
    def running(self) -> bool:
        """Whether the function has not returned yet."""
        return self._thread.is_alive()

    def stop(self, timeout_s: float | None = None) -> None:
        """Stop and wait until nothing runs any more, or until the timeout."""
        self._stop.set()
        if self._thread is not threading.current_thread():
            self._thread.join(timeout_s)

    def _main(self) -> None:
        try:
            self._run(self)
        except BaseException as error:  # shown by whoever looks at the source
            self.problem = " ".join(str(error).split()) or type(error).__name__
