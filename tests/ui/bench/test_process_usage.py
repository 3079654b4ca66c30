"""Processor time by thread."""

from __future__ import annotations

import os
import threading

from benchmarks.window.process_usage import process_seconds, thread_seconds

ENOUGH_S = 0.05


def test_who_computes_is_told_by_name() -> None:
    done, go_on = threading.Event(), threading.Event()

    def compute() -> None:
        while process_seconds(os.getpid()) < before + ENOUGH_S:
            pass
        done.set()
        go_on.wait()

    before = process_seconds(os.getpid())
    busy = threading.Thread(target=compute, name="busy")
    idle = threading.Thread(target=go_on.wait, name="idle")
    for thread in (busy, idle):
        thread.start()
    assert done.wait(60.0)
    used = thread_seconds()
    go_on.set()
    for thread in (busy, idle):
        thread.join()
    assert used["busy"] > 0.5 * ENOUGH_S > used["idle"]
