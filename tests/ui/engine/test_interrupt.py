"""^C ends the event loop that runs, and no other."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest
from PySide6.QtCore import QEventLoop, QTimer
from PySide6.QtWidgets import QApplication

from bubbleviz_ui.engine.interrupt import EXIT_CODE, Interrupt


@pytest.fixture
def interrupt(qapp: QApplication) -> Iterator[Interrupt]:
    made = Interrupt()
    made.end(qapp)
    yield made
    made.close()


def test_a_loop_that_runs_ends(qapp: QApplication, interrupt: Interrupt) -> None:
    QTimer.singleShot(0, lambda: signal.raise_signal(signal.SIGTERM))
    assert qapp.exec() == EXIT_CODE
    assert interrupt.came


def test_the_loop_of_the_next_window_goes_on(qapp: QApplication, interrupt: Interrupt) -> None:
    """It came while a window was opened, which handles events without a loop of Qt's."""
    signal.raise_signal(signal.SIGINT)
    qapp.processEvents()
    assert interrupt.came
    interrupt.close()
    loop, done = QEventLoop(), list[str]()
    QTimer.singleShot(0, lambda: (done.append("its work"), loop.quit()))
    assert loop.exec() == 0
    assert done == ["its work"]
