"""Worker threads, memory and signals of the window."""

import gc
import signal
import sys
import threading
import time
import weakref
from dataclasses import replace
from threading import Event
from unittest.mock import Mock

import numpy as np
import pytest
from fakes import DentSource
from PySide6.QtCore import QCoreApplication, QEventLoop, QTimer
from window_driver import PATIENCE_MS, run_python

from bubbleviz.diagnostics import Numbers
from bubbleviz.errors import InputError
from bubbleviz.inverse import Start
from bubbleviz.membrane import mesh_cap, spherical_cap
from bubbleviz.pipeline import Pipeline
from bubbleviz.progress import Cancelled
from bubbleviz.result import Estimate, FineContact
from bubbleviz_ui.engine.sensor_client import SensorClient
from bubbleviz_ui.engine.solver import EstimateCache, Kept, OpenRequest, Solver
from bubbleviz_ui.engine.source import Source
from bubbleviz_ui.engine.upkeep import EXIT_CODE, Interrupt, MemoryRelease
from bubbleviz_ui.engine.worker import CLOSE_TIMEOUT_S, KEYS, Deferred, Failed, Worker
from bubbleviz_ui.model.demand import Demand
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.source_facts import SourceFacts
from tests.program import python


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


def test_results_and_errors_arrive_in_order_in_the_gui_thread(wait, jobs):
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


def test_progress_is_reported_and_stops_a_cancelled_function(wait, jobs):
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


def test_result_of_a_cancelled_function_is_discarded(jobs):
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


def test_closing_waits_for_functions(qtbot):
    jobs, done = Worker("wanted"), list[int]()
    for number in range(20):
        jobs.submit(lambda number=number: done.append(number))
    assert jobs.close()
    assert done == list(range(20))


def test_function_running_after_close_does_not_change_the_exit_code():
    """SciPy factorisations in a thread that is still running would change it (scipy#25404)."""
    code = """
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
    assert python(code) == "(9, 9)\n"


def test_functions_may_end_after_their_window(qtbot):
    """Their threads hold the last references while the results are delivered in the GUI thread."""
    for _ in range(2_000):
        jobs, go_on = Worker("held"), Event()
        jobs.submit(go_on.wait)
        jobs.close(0.0)
        del jobs
        go_on.set()
        for _ in range(5):
            QCoreApplication.processEvents()


def test_the_meta_object_that_the_thread_shares_is_complete_before(qtbot):
    """PySide adds slots that a class does not declare when they are connected."""
    made = Worker("any")
    assert made.metaObject().methodCount() == Worker.staticMetaObject.methodCount()


# -- the solver's thread ------------------------------------------------------------------------


@pytest.fixture
def worker(qtbot):
    made = Worker("solver", KEYS)
    yield made
    made.close(60.0)


def opened(wait, worker):
    """Open a source and wait for the delivery of its result."""
    done = []
    worker.submit(lambda: None, done.append, key="open")
    wait(lambda: bool(done))


def holding(worker, key="object"):
    """Block the worker until the returned event is set."""
    begun, go_on = Event(), Event()
    worker.submit(lambda: (begun.set(), go_on.wait(240.0)), lambda _: None, key=key)
    assert begun.wait(240.0)
    return go_on


def test_latest_function_of_each_key_runs_most_urgent_first(wait, worker):
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


def test_functions_not_due_or_deferred_do_not_block_others(wait, worker):
    """A new patch is computed while the next live frame is not due yet."""
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


def test_functions_for_a_previous_source_do_not_run(wait, worker):
    came = []
    worker.submit(lambda: "of nothing", came.append, key="frame")  # no source is open yet
    opened(wait, worker)
    go_on = holding(worker, "open")
    worker.submit(lambda: "of the former", came.append, key="frame")
    go_on.set()
    opened(wait, worker)
    worker.submit(lambda: "of the new", came.append, key="frame")
    wait(lambda: bool(came))
    assert came == ["of the new"]


def test_failure_is_reported_with_its_key_and_others_continue(wait, worker):
    failures, came = [], []
    opened(wait, worker)
    worker.failed.connect(failures.append)

    def refuse():
        raise InputError("no such file")

    def open_nothing():
        raise Cancelled

    worker.submit(refuse, came.append, key="open", request="file")
    wait(lambda: len(failures) == 1)
    worker.submit(open_nothing, came.append, key="open")  # cancelled
    worker.submit(lambda: 1 / 0, came.append, key="patch")
    worker.submit(lambda: "frame", came.append, key="frame")  # the open source stays
    wait(lambda: came == ["frame"])
    assert [(f.key, f.message, f.request) for f in failures] == [
        ("open", "no such file", "file"),
        ("patch", "ZeroDivisionError: division by zero", None),
    ]
    assert "Traceback" in failures[1].details and not failures[0].details


def test_second_close_waits_for_a_function_that_exceeded_the_timeout(qtbot):
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


def test_a_sensor_whose_thread_ends_late_is_deleted_then(qtbot, wait):
    application, go_on = QCoreApplication.instance(), Event()
    client = SensorClient(SessionState())
    client.worker.submit(go_on.wait, key="open")
    assert not client.close(0.0)
    kept = weakref.ref(client)
    del client
    gc.collect()
    assert kept() is not None
    go_on.set()
    wait(lambda: not application.findChildren(Worker))
    gc.collect()
    assert kept() is None


def test_closing_asks_all_threads_to_end_before_it_waits_for_any(drive):
    """An import that ends only when the source is closed, in another thread."""
    began, closed, seen = Event(), Event(), list[bool]()

    class Closing(DentSource):
        def close(self):
            closed.set()

    def import_all():
        began.set()
        seen.append(closed.wait(0.5 * CLOSE_TIMEOUT_S))

    driver = drive(Closing)
    driver.window.menus.importing.submit(import_all)
    assert began.wait(60.0)
    driver.window.close_without_asking()
    assert seen == [True]


def test_frame_beyond_the_end_opens_at_the_last(sensor):
    solver, demand = Solver(), Demand(frozenset({"cloud"}))
    opened = solver.open(OpenRequest(Source("dent", DentSource), lambda: sensor, 99, demand))
    assert opened.result.frame.index == opened.facts.frames - 1
    solver.close()


# -- memory -------------------------------------------------------------------------------------


def test_garbage_of_another_thread_is_collected_in_the_gui_thread(wait):
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


LARGE = """
limit_heaps()
np.ones(24 << 20, np.uint8)  # by default, blocks up to this size would share a heap from now on
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only glibc is asked to")
@pytest.mark.parametrize(
    ("first", "kib", "after"),
    [("", 100, "release_memory()"), (LARGE, 6 << 10, "")],
    ids=["too small for memory of their own", "large"],
)
def test_freed_blocks_are_returned_to_the_system_on_request_and_large_ones_at_once(
    first, kib, after
):
    done = run_python(f"""
import numpy as np
from bubbleviz_ui.engine.source import Source
from bubbleviz_ui.engine.upkeep import limit_heaps, release_memory, resident_mib
{first}
before = resident_mib()
blocks = [np.ones({kib} << 10, np.uint8) for _ in range(150_000 // {kib})]
last = blocks.pop()  # keeps the heap from shrinking
held = resident_mib()
del blocks
{after}
print(held - before, resident_mib() - before)
""")
    held, kept = map(float, done.stdout.split())
    assert held > 100.0
    assert kept < 30.0


def test_memory_is_released_when_idle_or_a_source_is_closed_and_not_else(qtbot, wait):
    state, given, tick_ms = SessionState(), Event(), 20
    state.open(SourceFacts("press", "dome", np.arange(10) / 20.0), playing=True)
    giving = MemoryRelease(state, given.set, tick_ms)
    timer = QTimer(interval=tick_ms)  # same period as the tested timer
    timer.timeout.connect(lambda: state.frame_changed.emit(1, True))
    timer.start()
    for _ in range(6):
        qtbot.waitSignal(timer.timeout, timeout=PATIENCE_MS).wait()
    assert not given.is_set()
    state.open(SourceFacts("drag", "dome", np.arange(10) / 20.0), playing=True)
    wait(given.is_set)  # for what the closed source held
    given.clear()
    timer.stop()
    wait(given.is_set)
    giving.close()


def test_closed_sources_are_collected_when_idle(wait):
    class Held:
        """Refers to itself, as the objects of a source do."""

        def __init__(self):
            self.itself = self

    state, given = SessionState(), Event()
    giving = MemoryRelease(state, given.set, 20)
    closed = weakref.ref(Held())
    assert closed() is not None
    state.open(SourceFacts("press", "dome", np.arange(10) / 20.0), playing=False)
    wait(given.is_set)
    assert closed() is None
    giving.close()


def test_estimate_cache_drops_the_oldest_and_counts_refined_meshes():
    nothing = np.zeros(1000)
    estimate = Estimate("no_contact", nothing, nothing.copy(), 0.0, 0.0, 0.0)
    size = 2 * nothing.nbytes
    kept = EstimateCache(3 * size)
    for frame in (0, 1, 2, 0, 3):  # frame 0 is computed again
        kept.keep(frame, Kept(Numbers(area_m2=frame), estimate))
    assert kept.get(1) is None
    assert [kept.get(frame)[0].area_m2 for frame in (0, 2, 3)] == [0, 2, 3]

    mesh, kept = mesh_cap(spherical_cap(0.045, 0.02), 1000), EstimateCache(5 * size)
    zero = np.zeros(len(mesh.nodes))
    fine = FineContact(mesh, np.zeros((len(zero), 2), int), 1e-3, zero, mesh.nodes, 1e-3)
    for frame in range(3):
        kept.keep(frame, Kept(Numbers(), replace(estimate, fine=fine)))
    _ = mesh.rings  # computed lazily and cached by the mesh
    kept.keep(3, Kept(Numbers(), estimate))
    assert [frame for frame in range(4) if kept.get(frame)] == [3]


def test_a_seek_starts_from_the_nearest_frame_solved_but_the_next_frame_from_the_last():
    nothing, kept = np.zeros(3), EstimateCache()
    estimate, contact = Estimate("ok", nothing, nothing, 0.0, 0.0, 0.0), Start()
    kept.keep(60, Kept(Numbers(), estimate, contact))
    kept.keep(10, Kept(Numbers(), estimate))
    pipeline = Mock(Pipeline)
    for frame in (10, 11, 9, 30):
        kept.restart(pipeline, frame)
    pipeline.restart.assert_not_called()
    kept.restart(pipeline, 80)
    pipeline.restart.assert_called_once_with(contact)
    kept.keep(80, Kept(Numbers(), estimate, contact))
    kept.restart(pipeline, 20)
    pipeline.restart.assert_called_with(None)


# -- ^C -----------------------------------------------------------------------------------------


@pytest.fixture
def interrupt(qapp):
    made = Interrupt()
    made.end(qapp)
    yield made
    made.close()


def test_interrupt_ends_only_the_running_event_loop(qapp, interrupt):
    QTimer.singleShot(0, lambda: signal.raise_signal(signal.SIGTERM))
    assert qapp.exec() == EXIT_CODE
    assert interrupt.received


def test_interrupt_does_not_end_the_next_event_loop(qapp, interrupt):
    """The interrupt arrived while a window was opening, without a running Qt event loop."""
    signal.raise_signal(signal.SIGINT)
    qapp.processEvents()
    assert interrupt.received
    interrupt.close()
    loop, done = QEventLoop(), list[str]()
    QTimer.singleShot(0, lambda: (done.append("its work"), loop.quit()))
    assert loop.exec() == 0
    assert done == ["its work"]
