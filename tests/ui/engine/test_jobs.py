"""Jobs run in order off the GUI thread; a cancelled one is not heard of, and lets go."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest
from PySide6.QtCore import QCoreApplication
from pytestqt.qtbot import QtBot

from bubbleviz.errors import InputError
from bubbleviz.progress import Progress
from bubbleviz_ui.engine.jobs import Done, Jobs


@pytest.fixture
def jobs(qtbot: QtBot) -> Iterator[Jobs]:
    made = Jobs("jobs of a test")
    yield made
    made.cancel()
    made.close(60.0)


def test_jobs_end_in_order_in_the_gui_thread(qtbot: QtBot, jobs: Jobs) -> None:
    ended: list[tuple[int, bool]] = []
    here = threading.current_thread()

    def then(done: Done) -> None:
        ended.append((done.answer[0], threading.current_thread() is here))
        assert done.answer[1] is not here

    for number in range(5):
        jobs.run(lambda _, number=number: (number, threading.current_thread()), then)
    qtbot.waitUntil(lambda: len(ended) == 5, timeout=240_000)
    assert ended == [(number, True) for number in range(5)]
    assert not jobs.busy


def test_what_goes_wrong_is_said_and_the_next_job_runs(qtbot: QtBot, jobs: Jobs) -> None:
    ended: list[Done] = []

    def refuse(_: Progress) -> None:
        raise InputError("x.toml: not there")

    def break_down(_: Progress) -> None:
        raise ZeroDivisionError("by nothing")

    for job in (refuse, break_down, lambda _: 3):
        jobs.run(job, ended.append)
    qtbot.waitUntil(lambda: len(ended) == 3, timeout=240_000)
    assert ended[0] == Done(message="x.toml: not there")
    assert ended[1].message == "ZeroDivisionError: by nothing" and "refuse" not in ended[1].details
    assert "break_down" in ended[1].details
    assert ended[2] == Done(3)


def test_progress_is_told_and_ends_a_job_that_is_replaced(qtbot: QtBot, jobs: Jobs) -> None:
    told: list[tuple[str, float]] = []
    jobs.progressed.connect(lambda step, done: told.append((step, done)))
    began, ended = threading.Event(), list[Done]()

    def endless(progress: Progress) -> None:
        while True:
            began.set()
            progress("on and on", 0.5)

    jobs.run(endless, ended.append)
    qtbot.waitUntil(lambda: bool(told), timeout=240_000)
    assert began.is_set() and told[0] == ("on and on", 0.5)
    jobs.replace(lambda _: "new", ended.append)
    qtbot.waitUntil(lambda: bool(ended), timeout=240_000)
    assert ended == [Done("new")]


def test_an_answer_that_comes_too_late_is_let_go(qtbot: QtBot, jobs: Jobs) -> None:
    began, go = threading.Event(), threading.Event()
    ended, unwanted = list[Done](), list[str]()

    def slow(_: Progress) -> str:
        began.set()
        assert go.wait(240.0)
        return "a source that is open"

    jobs.run(slow, ended.append, unwanted.append)
    assert began.wait(240.0)
    jobs.cancel()
    go.set()
    jobs.close()
    assert unwanted == ["a source that is open"] and not ended


def test_closing_waits_for_what_is_wanted(jobs: Jobs) -> None:
    done: list[int] = []
    for number in range(20):
        jobs.run(lambda _, number=number: done.append(number))
    jobs.close()
    assert done == list(range(20))


def test_a_job_that_outlasts_closing_does_not_change_the_exit_code() -> None:
    """SciPy's factorisations of a thread that is left behind would (scipy#25404)."""
    words = """
import threading
from PySide6.QtCore import QCoreApplication
from scipy.sparse import eye_array
from scipy.sparse.linalg import splu
from bubbleviz_ui.engine.jobs import Jobs
application, jobs, made = QCoreApplication([]), Jobs("slow"), threading.Event()
def job(progress):
    kept = splu(eye_array(9, format="csc"))
    made.set()
    threading.Event().wait(1.0)  # longer than closing waits
    print(kept.shape)
jobs.run(job)
made.wait()
jobs.cancel()
jobs.close(0.01)
"""
    process = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True)
    assert (process.returncode, process.stdout, process.stderr) == (0, "(9, 9)\n", "")


def test_closing_waits_no_longer_than_it_is_told(qtbot: QtBot) -> None:
    jobs, go_on, ended = Jobs("held"), threading.Event(), threading.Event()

    def hold(_: Progress) -> None:
        go_on.wait()
        ended.set()

    jobs.run(hold)
    jobs.close(0.0)
    assert not ended.is_set()
    go_on.set()
    assert ended.wait(240.0)  # it is not lost


def test_jobs_that_end_after_their_window_do_no_harm(qtbot: QtBot) -> None:
    """Their threads are the last to know of them, while their ends are told in the GUI thread."""
    for _ in range(5_000):
        jobs, go_on = Jobs("held"), threading.Event()
        jobs.run(lambda _, go_on=go_on: go_on.wait())
        jobs.close(0.0)
        del jobs
        go_on.set()
        for _ in range(5):
            QCoreApplication.processEvents()
