"""Memory that the C library holds for nothing goes back to the system once the window rests."""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
import pytest
from window_driver import Driver

from ui.benchmark_rest import resident_mib
from ui.memory import REST_MS

COUNT, KIB = 2000, 100
"""195 MiB in pieces that are too small for memory of their own (128 KiB with glibc)."""


def held_for_nothing() -> np.ndarray:
    """Take memory and let go of all but the last piece, which keeps the heap from shrinking."""
    pieces = [np.ones(KIB << 10, np.uint8) for _ in range(COUNT)]
    return pieces[-1]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only glibc is asked to")
def test_unused_memory_is_given_back_at_rest_and_not_while_playing(
    drive: Callable[..., Driver],
) -> None:
    driver = drive()
    before = resident_mib()
    driver.state.set_playing(True)
    last = held_for_nothing()
    assert resident_mib() - before > 100.0
    driver.bot.wait(REST_MS + 1000)
    assert resident_mib() - before > 100.0
    driver.state.set_playing(False)
    driver.wait(lambda: resident_mib() - before < 50.0)
    assert last.all()
