"""What keeps the GUI thread from events is told."""

from __future__ import annotations

import threading

from PySide6.QtCore import QTimer
from pytestqt.qtbot import QtBot

from bubbleviz_ui.bench.block_watch import BLOCKED_S, BlockWatch


def test_the_calls_of_a_blocked_thread_are_told(qtbot: QtBot) -> None:
    watch, done = BlockWatch(), threading.Event()

    def keep_the_window_waiting() -> None:
        threading.Event().wait(5.0 * BLOCKED_S)
        done.set()

    with watch.watching():
        QTimer.singleShot(0, keep_the_window_waiting)
        qtbot.waitUntil(lambda: done.is_set() and watch.longest_s > 0.0, timeout=240_000)
    assert watch.longest_s > 2.0 * BLOCKED_S
    assert "keep_the_window_waiting" in watch.stack
