"""Memory that the C library holds for nothing goes back to the system once the window rests."""

from __future__ import annotations

import subprocess
import sys
from threading import Event

import numpy as np
import pytest
from PySide6.QtCore import QTimer
from pytestqt.qtbot import QtBot

from bubbleviz_ui.engine.memory_release import MemoryRelease
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.source_facts import SourceFacts

REST_MS = 20
PROGRAM = """
import numpy as np
from benchmarks.window.process_usage import resident_mib
from bubbleviz_ui.engine.memory_release import release_memory

before = resident_mib()
pieces = [np.ones(100 << 10, np.uint8) for _ in range(1500)]  # too small for memory of their own
last = pieces[-1]  # keeps the heap from shrinking
del pieces
held = resident_mib()
release_memory()
print(held - before, resident_mib() - before)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only glibc is asked to")
def test_what_nobody_uses_goes_back_to_the_system() -> None:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True
    )
    held, kept = map(float, done.stdout.split())
    assert held > 100.0
    assert kept < 30.0


def test_memory_is_given_back_at_rest_and_not_while_playing(qtbot: QtBot) -> None:
    state, given = SessionState(), Event()
    state.open(SourceFacts("press", "dome", np.arange(10) / 20.0), playing=True)
    giving = MemoryRelease(state, given.set, REST_MS)
    timer = QTimer(interval=REST_MS)  # as often as the other looks, which began before
    timer.start()
    for _ in range(3):
        qtbot.waitSignal(timer.timeout, timeout=240_000).wait()
    assert not given.is_set()
    state.set_playing(False)
    qtbot.waitUntil(given.is_set, timeout=240_000)
    giving.close()
