"""What keeps the GUI thread from events is told."""

from __future__ import annotations

import threading

from PySide6.QtCore import QTimer
from pytestqt.qtbot import QtBot

from benchmarks.window.block_watch import BLOCKED_S, BlockWatch


def test_the_calls_of_a_blocked_thread_are_told(qtbot: QtBot) -> None:
    watch, timer = BlockWatch(), QTimer()

    def keep_the_window_waiting() -> None:
        # a machine that is busy may block it before, and for longer
        threading.Event().wait(max(5.0 * BLOCKED_S, 1.5 * watch.longest_s))

    timer.timeout.connect(keep_the_window_waiting)
    with watch.watching():
        timer.start(int(5e3 * BLOCKED_S))
        qtbot.waitUntil(lambda: "keep_the_window_waiting" in watch.stack, timeout=240_000)
        timer.stop()
    assert watch.longest_s > 2.0 * BLOCKED_S
