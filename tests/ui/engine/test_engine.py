"""Threads, memory and signals behind the window: in order, in the right thread, and let go."""

import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from threading import Event

import numpy as np
import pytest
from fakes import DentSource
from PySide6.QtCore import QCoreApplication, QEventLoop, QTimer
from window_driver import PATIENCE_MS, run_python

from bubbleviz.diagnostics import Numbers
from bubbleviz.errors import InputError
from bubbleviz.membrane import mesh_cap, spherical_cap
from bubbleviz.progress import Cancelled
from bubbleviz.result import Estimate, FineContact
from bubbleviz_ui.engine.solver import EstimateCache, OpenRequest, Solver
from bubbleviz_ui.engine.source import Source
from bubbleviz_ui.engine.upkeep import EXIT_CODE, Interrupt, MemoryRelease
from bubbleviz_ui.engine.worker import KEYS, Deferred, Failed, Worker
from bubbleviz_ui.model.demand import Demand
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.source_facts import SourceFacts


@pytest.fixture
def wait(qtbot):
    return lambda done: qtbot.waitUntil(done, timeout=PATIENCE_MS)


# -- functions in order -------------------------------------------------------------------------


@pytest.fixture
def jobs(qtbot):
    made = Worker("worker of a test")
    yield made
    made.cancel()
    made.close(60.0)


def test_functions_end_in_order_in_the_gui_thread_and_say_what_goes_wrong(wait, jobs):
    ended, here = [], threading.current_thread()
    threads = set[threading.Thread]()

    def refuse():
        threads.add(threading.current_thread())
        raise InputError("x.toml: not there")

    def break_down():
        raise ZeroDivisionError("by nothing")

    def then(end):
        assert threading.current_thread() is here
        ended.append(end)

    for function in (refuse, break_down, lambda: 3, lambda: 4):
        jobs.submit(function, then, then)
    wait(lambda: len(ended) == 4)
    assert here not in threads and not jobs.busy
    assert ended[0] == Failed("", "x.toml: not there")
    assert ended[1].message == "ZeroDivisionError: by nothing" and "refuse" not in ended[1].details
    assert "break_down" in ended[1].details
    assert ended[2:] == [3, 4]


def test_progress_is_told_and_ends_a_function_that_is_cancelled(wait, jobs):
    told, ended = list[tuple[str, float]](), []
    jobs.progressed.connect(lambda step, done: told.append((step, done)))

    def endless():
        while True:
            jobs.progress("on and on", 0.5)

    jobs.submit(endless, ended.append, ended.append)
    wait(lambda: bool(told))
    assert told[0] == ("on and on", 0.5)
    jobs.cancel()
    jobs.submit(lambda: "new", ended.append)
    wait(lambda: bool(ended))
    assert ended == ["new"]


def test_a_late_answer_is_dropped(jobs):
    began, go = Event(), Event()
    ended, discard = [], list[str]()

    def slow():
        began.set()
        assert go.wait(240.0)
        return "a source that is open"

    jobs.submit(slow, ended.append, ended.append, discard=discard.append)
    assert began.wait(240.0)
    jobs.cancel()
    go.set()
    jobs.close()
    assert discard == ["a source that is open"] and not ended


def test_closing_waits_for_what_is_wanted_and_no_longer_than_it_is_told(qtbot):
    jobs, done = Worker("wanted"), list[int]()
    for number in range(20):
        jobs.submit(lambda number=number: done.append(number))
    assert jobs.close()
    assert done == list(range(20))
    jobs, go_on, ended = Worker("held"), Event(), Event()
    jobs.submit(lambda: (go_on.wait(), ended.set()))
    assert not jobs.close(0.0)
    assert not ended.is_set()
    go_on.set()
    assert ended.wait(240.0)  # it is not lost


def test_a_function_that_outlasts_closing_does_not_change_the_exit_code():
    """SciPy's factorisations of a thread that is left behind would (scipy#25404)."""
    words = """
import threading
from PySide6.QtCore import QCoreApplication
from scipy.sparse import eye_array
from scipy.sparse.linalg import splu
from bubbleviz_ui.engine.worker import Worker
application, worker, made = QCoreApplication([]), Worker("slow"), threading.Event()
def function():
    kept = splu(eye_array(9, format="csc"))
    made.set()
    threading.Event().wait(0.5)  # longer than closing waits
    print(kept.shape)
worker.submit(function)
made.wait()
worker.cancel()
worker.close(0.01)
"""
    process = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True)
    assert (process.returncode, process.stdout, process.stderr) == (0, "(9, 9)\n", "")


def test_functions_that_end_after_their_window_do_no_harm(qtbot):
    """Their threads are the last to know of them, while their ends are told in the GUI thread."""
    for _ in range(2_000):
        jobs, go_on = Worker("held"), Event()
        jobs.submit(go_on.wait)
        jobs.close(0.0)
        del jobs
        go_on.set()
        for _ in range(5):
            QCoreApplication.processEvents()


# -- the solver's thread ------------------------------------------------------------------------


@pytest.fixture
def worker(qtbot):
    made = Worker("solver", KEYS)
    yield made
    made.close(60.0)


def opened(wait, worker):
    """Wait until what was submitted to open something has been delivered."""
    done = []
    worker.submit(lambda: None, done.append, key="open")
    wait(lambda: bool(done))


def holding(worker, key="object"):
    """Have the worker wait until the event is set; submitted so, others wait behind it."""
    begun, go_on = Event(), Event()
    worker.submit(lambda: (begun.set(), go_on.wait(240.0)), lambda _: None, key=key)
    assert begun.wait(240.0)
    return go_on


def test_the_latest_of_each_key_runs_the_most_urgent_first(wait, worker):
    opened(wait, worker)
    go_on, came = holding(worker), []
    worker.submit(lambda: "left", came.append, key="cold_solve")
    replaced = [worker.submit(lambda k=k: k, came.append, key="frame") for k in range(4)]
    worker.submit(lambda: "settled", came.append, key="cold_solve")
    worker.submit(lambda: "patch", came.append, key="patch")
    assert worker.has_more_urgent("frame") and not worker.has_more_urgent("patch")
    go_on.set()
    wait(lambda: len(came) == 3)
    assert came == ["patch", 3, "settled"] and replaced == [False, True, True, True]
    go_on = holding(worker)
    worker.submit(lambda: "left", came.append, key="cold_solve")
    assert worker.drop("cold_solve") and not worker.drop("cold_solve")
    worker.submit(lambda: "last", came.append, key="analyse")
    go_on.set()
    wait(lambda: came[-1] == "last")
    assert came[3:] == ["last"]


def test_what_is_not_due_or_deferred_lets_others_go_first(wait, worker):
    """A drag of κ is answered although the next live frame is not to be taken yet."""
    opened(wait, worker)
    came, calls = [], []
    worker.submit(lambda: None, came.append, key="newest", due_s=time.perf_counter() + 1e6)
    worker.submit(lambda: "patch", came.append, key="patch")
    wait(lambda: came == ["patch"])

    def newest():
        calls.append(worker.has_more_urgent("newest"))
        if len(calls) == 1:
            worker.submit(lambda: "patch again", came.append, key="patch")
            raise Deferred
        return "newest"

    worker.submit(newest, came.append, key="newest")
    wait(lambda: len(came) == 3)
    assert came[1:] == ["patch again", "newest"] and calls == [False, False]


def test_what_was_meant_for_another_source_does_not_run(wait, worker):
    came = []
    worker.submit(lambda: "of nothing", came.append, key="frame")  # nothing is open yet
    opened(wait, worker)
    go_on = holding(worker, "open")
    worker.submit(lambda: "of the former", came.append, key="frame")
    go_on.set()
    opened(wait, worker)
    worker.submit(lambda: "of the new", came.append, key="frame")
    wait(lambda: bool(came))
    assert came == ["of the new"]


def test_what_fails_is_told_with_its_key_and_the_rest_goes_on(wait, worker):
    failures, came = [], []
    opened(wait, worker)
    worker.failed.connect(failures.append)

    def refuse():
        raise InputError("no such file")

    def open_nothing():
        raise Cancelled

    worker.submit(refuse, came.append, key="open", request="file")
    wait(lambda: len(failures) == 1)
    worker.submit(open_nothing, came.append, key="open")  # nobody waits for it any more
    worker.submit(lambda: 1 / 0, came.append, key="patch")
    worker.submit(lambda: "frame", came.append, key="frame")  # what was open stays
    wait(lambda: came == ["frame"])
    assert [(f.key, f.message, f.request) for f in failures] == [
        ("open", "no such file", "file"),
        ("patch", "ZeroDivisionError: division by zero", None),
    ]
    assert "Traceback" in failures[1].details and not failures[0].details


def test_what_closing_did_not_wait_for_is_waited_for_before_the_end(qtbot):
    ended, came = Event(), []
    worker = Worker("solver", KEYS, ended.set)
    go_on = holding(worker, "open")
    worker.submit(lambda: "next", came.append, key="open")
    assert not worker.close(timeout_s=0.0)
    assert not ended.is_set()
    go_on.set()
    assert worker.close(240.0)
    assert ended.is_set()
    QCoreApplication.processEvents()
    assert not came  # what waited is dropped


def test_a_frame_past_the_end_opens_at_the_last(sensor):
    solver, demand = Solver(), Demand(frozenset({"cloud"}))
    opened = solver.open(OpenRequest(Source("dent", DentSource), lambda: sensor, 99, demand))
    assert opened.frame == opened.facts.frames - 1
    solver.close()


# -- memory -------------------------------------------------------------------------------------


def test_garbage_of_another_thread_goes_in_the_gui_thread(wait):
    wanted, gone_in = 5_000, list[int]()

    class Ring:
        def __init__(self):
            self.itself = self

        def __del__(self):
            gone_in.append(threading.get_ident())

    thread = threading.Thread(target=lambda: [Ring() for _ in range(wanted)])
    thread.start()
    thread.join()
    assert not gone_in
    wait(lambda: len(gone_in) == wanted)
    assert set(gone_in) == {threading.get_ident()}


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only glibc is asked to")
def test_what_nobody_uses_goes_back_to_the_system():
    done = run_python("""
import numpy as np
from benchmarks.window.process_usage import resident_mib
from bubbleviz_ui.engine.source import Source
from bubbleviz_ui.engine.upkeep import release_memory
before = resident_mib()
pieces = [np.ones(100 << 10, np.uint8) for _ in range(1500)]  # too small for memory of their own
last = pieces[-1]  # keeps the heap from shrinking
del pieces
held = resident_mib()
release_memory()
print(held - before, resident_mib() - before)
""")
    held, kept = map(float, done.stdout.split())
    assert held > 100.0
    assert kept < 30.0


def test_memory_is_given_back_at_rest_and_not_while_playing(qtbot, wait):
    state, given, idle_ms = SessionState(), Event(), 20
    state.open(SourceFacts("press", "dome", np.arange(10) / 20.0), playing=True)
    giving = MemoryRelease(state, given.set, idle_ms)
    timer = QTimer(interval=idle_ms)  # as often as the other looks, which began before
    timer.start()
    for _ in range(3):
        qtbot.waitSignal(timer.timeout, timeout=PATIENCE_MS).wait()
    assert not given.is_set()
    state.set_playing(False)
    wait(given.is_set)
    giving.close()


def test_the_oldest_kept_estimate_is_dropped_first_and_finer_meshes_count():
    nothing = np.zeros(1000)
    estimate = Estimate("no_contact", nothing, nothing.copy(), 0.0, 0.0, 0.0)
    size = 2 * nothing.nbytes
    kept = EstimateCache(3 * size)
    for frame in (0, 1, 2, 0, 3):  # frame 0 is computed again
        kept.keep(frame, Numbers(area_m2=frame), estimate)
    assert kept.get(1) is None
    assert [kept.get(frame)[0].area_m2 for frame in (0, 2, 3)] == [0, 2, 3]

    mesh, kept = mesh_cap(spherical_cap(0.045, 0.02), 1000), EstimateCache(5 * size)
    zero = np.zeros(len(mesh.nodes))
    fine = FineContact(mesh, np.zeros((len(zero), 2), int), zero, mesh.nodes, 1e-3)
    for frame in range(3):
        kept.keep(frame, Numbers(), replace(estimate, fine=fine))
    _ = mesh.rings  # found later, and kept by the mesh
    kept.keep(3, Numbers(), estimate)
    assert [frame for frame in range(4) if kept.get(frame)] == [3]


# -- ^C -----------------------------------------------------------------------------------------


@pytest.fixture
def interrupt(qapp):
    made = Interrupt()
    made.end(qapp)
    yield made
    made.close()


def test_an_interrupt_ends_the_loop_that_runs_and_no_other(qapp, interrupt):
    QTimer.singleShot(0, lambda: signal.raise_signal(signal.SIGTERM))
    assert qapp.exec() == EXIT_CODE
    assert interrupt.received


def test_the_loop_of_the_next_window_goes_on(qapp, interrupt):
    """It came while a window was opened, which handles events without a loop of Qt's."""
    signal.raise_signal(signal.SIGINT)
    qapp.processEvents()
    assert interrupt.received
    interrupt.close()
    loop, done = QEventLoop(), list[str]()
    QTimer.singleShot(0, lambda: (done.append("its work"), loop.quit()))
    assert loop.exec() == 0
    assert done == ["its work"]
