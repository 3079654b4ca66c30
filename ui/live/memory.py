"""Memory that nobody uses goes back to the system: images come and go for hours."""

from __future__ import annotations

import ctypes
import sys

EVERY_S = 3.0
"""At 60 Hz some 3 MB a second are held for nothing."""


def give_back() -> None:
    """Have the C library let go of what it holds for nothing, where it knows how (glibc)."""
    if sys.platform.startswith("linux"):
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)
