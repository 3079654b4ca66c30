"""Garbage of any thread is collected, and in the GUI thread."""

from __future__ import annotations

import threading

from pytestqt.qtbot import QtBot


def test_garbage_of_another_thread_goes_in_the_gui_thread(qtbot: QtBot) -> None:
    wanted, gone_in = 5_000, []

    class Ring:
        def __init__(self) -> None:
            self.itself = self

        def __del__(self) -> None:
            gone_in.append(threading.get_ident())

    thread = threading.Thread(target=lambda: [Ring() for _ in range(wanted)] and None)
    thread.start()
    thread.join()
    assert not gone_in
    qtbot.waitUntil(lambda: len(gone_in) == wanted, timeout=60_000)
    assert set(gone_in) == {threading.get_ident()}
