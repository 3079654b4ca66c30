"""Memory that the C library holds for nothing goes back to the system once the window rests."""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
import pytest
from window_driver import Driver

from bubbleviz_ui.bench.memory_at_rest import resident_mib
from bubbleviz_ui.engine.memory_release import REST_MS

MIB = 150.0
PIECE = 100 << 10
"""Bytes; too little for memory of its own, which begins at 128 KiB with glibc."""


def held_for_nothing() -> np.ndarray:
    """Take memory and let go of all but the last piece, which keeps the heap from shrinking."""
    before, pieces = resident_mib(), list[np.ndarray]()
    while resident_mib() < before + MIB:
        pieces.append(np.ones(PIECE, np.uint8))
    return pieces[-1]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only glibc is asked to")
def test_unused_memory_is_given_back_at_rest_and_not_while_playing(
    drive: Callable[..., Driver],
) -> None:
    driver = drive()
    before = resident_mib()
    driver.state.set_playing(True)
    last = held_for_nothing()
    driver.bot.wait(REST_MS + 1000)
    assert resident_mib() > before + 0.7 * MIB
    driver.state.set_playing(False)
    driver.wait(lambda: resident_mib() < before + 0.3 * MIB)
    assert last.all()
