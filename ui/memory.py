"""Memory that nobody uses goes back to the system: images come and go for hours."""

from __future__ import annotations

import ctypes
import sys
from threading import Event, Thread

EVERY_S = 3.0
"""At 60 Hz some 3 MB a second are held for nothing."""


class GivingBack:
    """Lets go of unused memory every few seconds, in a thread of its own, until it is closed."""

    def __init__(self) -> None:
        self._over = Event()
        self._thread = Thread(target=self._run, name="memory", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop the thread."""
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._over.wait(EVERY_S):
            give_back()


def give_back() -> None:
    """Have the C library let go of what it holds for nothing, where it knows how (glibc)."""
    if sys.platform.startswith("linux"):
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)
