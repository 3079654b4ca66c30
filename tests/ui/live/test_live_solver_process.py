"""Solver processes of two cameras."""

import os
import signal
import threading
from contextlib import contextmanager
from multiprocessing import active_children

import numpy as np
import pytest
from live_bench import sensor_file, sensor_pair_preset

from benchmarks.window.live_soak import free_port
from bubbleviz.live import open_stream
from bubbleviz.zeros import PressureZero
from bubbleviz_ui.engine.live_frames import LiveFrames
from bubbleviz_ui.engine.solver import OpenRequest, Solver
from bubbleviz_ui.engine.source import Source
from bubbleviz_ui.engine.worker import Deferred
from bubbleviz_ui.live.connection import single
from bubbleviz_ui.model.demand import Demand
from tests.live.streams import robot


def connect_two(bench, port):
    """Connect the window to two sensors of a robot, whose frames are solved in processes."""
    pair, source, before = (
        sensor_pair_preset(bench.folder),
        f"zenoh:tcp/127.0.0.1:{port}",
        bench.state.facts,
    )
    places = tuple(each.model_copy(update={"source": source}) for each in pair.sensors)
    bench.live_controller.connect_to(pair.model_copy(update={"sensors": places}))
    bench.wait(lambda: in_use() == 2 and bench.state.facts is not before)


def in_use():
    """Number of solver processes."""
    return sum(thread.name == "solver watchdog" for thread in threading.enumerate())


def none_left():
    return not active_children() and not in_use()


@contextmanager
def opened(sensor, demand, *, zero_pa=0.0, paired=False):
    """A solver and the live frames that it has open."""
    zero, solver = PressureZero(sensor.pneumatics), Solver()
    zero.restore(zero.reference_pa + zero_pa, waiting=False)
    with open_stream("synthetic:?rate=100&frames=2", sensor) as stream:
        frames = LiveFrames("press", stream, zero, paired=paired)
        first = stream.first_frame()
        frames.begin(first.arrival_ns, first)
        solver.open(OpenRequest(Source.of_stream(frames), lambda: sensor, 0, demand))
        yield solver, frames


def test_a_solver_process_gets_zeroed_frames_and_ends_with_its_source(sensor):
    demand, solved = Demand(frozenset({"patch"})), None
    with opened(sensor, demand, zero_pa=40.0, paired=True) as (solver, frames):
        beside = solver.current.solver_process
        while beside.pid is None or solved is None:
            solved = solver.newest(demand, lambda: False)
        frame = solved.result.frame
        assert frame.gas_pressure_pa == frames[frame.index].gas_pressure_pa - 40.0
        solver.close()
    assert none_left()


def test_cancelled_wait_does_not_count_as_a_paused_source(sensor):
    demand = Demand(frozenset({"cloud"}))
    with opened(sensor, demand) as (solver, _):
        pass
    while solver.newest(demand, lambda: False) is not None:  # frames that arrived before the end
        pass
    with pytest.raises(Deferred):
        solver.newest(demand, lambda: True)
    assert solver.newest(demand, lambda: False) is None
    solver.close()


@pytest.mark.long  # in short: tests/processes
def test_killed_solver_process_is_reported_and_others_end_with_the_window(open_bench):
    bench, port = open_bench(), free_port()
    with robot(port):
        # a single camera has none
        bench.connect(single(f"zenoh:tcp/127.0.0.1:{port}", sensor_file(bench.folder)))
        assert none_left()
        connect_two(bench, port)
        bench.wait_for_frames()
        before = bench.shown_frame
        os.kill(active_children()[0].pid, signal.SIGKILL)
        bench.wait_for_message("its solver process has ended", "code -9")
        bench.wait_for_frames(2)
        assert in_use() == 1
        known = bench.state.history.values["latency_ms"][before : bench.shown_frame]
        assert np.isfinite(known).all()  # including the frame in progress
        bench.window.live.leave.click()
        bench.wait(none_left)
        connect_two(bench, port)
        bench.window.close()
        bench.wait(none_left)
