"""Frames of two cameras are solved in a process each, as long as there is one."""

import os
import signal
import threading
from contextlib import contextmanager
from multiprocessing import active_children

import numpy as np
import pytest
from live_bench import SYNTHETIC, sensor_file, two

from benchmarks.window.live_soak import free_port
from bubbleviz.calibration import PressureZero
from bubbleviz.live import open_stream
from bubbleviz.pipeline import Pipeline
from bubbleviz_ui.engine.requests import NewestRequest, OpenRequest, Solved, Waited
from bubbleviz_ui.engine.solver_server import Server
from bubbleviz_ui.live.connection import single
from bubbleviz_ui.live.live_frames import LiveFrames, LiveOpener
from bubbleviz_ui.model.demand import Demand
from tests.live.streams import robot


@contextmanager
def cameras(open_bench):
    """A window on a robot in a process of its own, whose frames two sensors have solved."""
    bench, port = open_bench(), free_port()
    with robot(port):
        pair, source = two(bench.folder), f"zenoh:tcp/127.0.0.1:{port}"
        places = tuple(each.model_copy(update={"source": source}) for each in pair.sensors)
        bench.connect(pair.model_copy(update={"sensors": places}))
        bench.wait(lambda: in_use() == 2)
        bench.follow()
        yield bench


def in_use():
    """Number of processes in which frames are solved."""
    return sum(thread.name == "solver watch" for thread in threading.enumerate())


def none_left():
    return not active_children() and not in_use()


def test_a_wait_that_was_called_off_is_no_pause_of_the_source(sensor):
    newest = NewestRequest(1, Demand(frozenset({"cloud"})))
    server, stream = Server(), open_stream("synthetic:?rate=100&frames=2", sensor)
    frames = LiveFrames("press", stream, PressureZero(sensor.pneumatics.reference_pressure_pa))
    with stream:
        while not frames.came(60.0):
            pass
        frames.begin(frames.first_ns)
    server.serve(OpenRequest(1, "press", LiveOpener(frames), lambda: sensor, 0, newest.demand))
    while isinstance(server.serve(newest), Solved):  # what had arrived before it ended
        pass
    server.wait_no_longer()
    for paused in (False, True):
        assert server.serve(newest) == Waited(newest, paused=paused)
    server.close()


def test_its_answer_is_that_of_a_pipeline_here(sensor):
    """Each frame with its gas pressure zeroed first."""
    demand = Demand(frozenset({"patch"}))
    zero = PressureZero(sensor.pneumatics.reference_pressure_pa)
    zero.restore(zero.reference_pa + 40.0, waiting=False)
    server, stream = Server(), open_stream("synthetic:?rate=100&frames=30", sensor)
    frames = LiveFrames("press", stream, zero, paired=True)
    with stream:
        while not frames.came(60.0):
            pass
        frames.begin(frames.first_ns)
        server.serve(OpenRequest(1, "press", LiveOpener(frames), lambda: sensor, 0, demand))
        session = server.session
        assert session is not None and session.beside is not None
        beside, own = session.beside, Pipeline.of(sensor, session.source[0].intrinsics)
        compared = 0
        while compared < 3:
            solved = server.serve(NewestRequest(1, demand))
            if beside.pid is None or not isinstance(solved, Solved):
                continue
            frame, found = solved.result.frame, solved.result.estimate
            assert frame.gas_pressure_pa == frames[frame.index].gas_pressure_pa - 40.0
            # the process has solved the same frames in the same order, so that it started alike
            expected = own.process(frame, demand.products).estimate
            assert found.status == expected.status and found.trusted
            scale = 1e-9 * np.abs(expected.displacement_m).max()
            np.testing.assert_allclose(found.displacement_m, expected.displacement_m, atol=scale)
            compared += 1
        server.close()
    assert none_left()


def test_killed_it_is_missed_in_one_sentence_and_the_frames_go_on(open_bench):
    with cameras(open_bench) as bench:
        before = bench.shown
        for child in active_children():
            os.kill(child.pid, signal.SIGKILL)
        bench.told("process that solved its frames has ended", "code -9")
        bench.follow(5)
        assert none_left()
        known = bench.state.history.values["latency_ms"][before : bench.shown]
        assert np.isfinite(known).all()  # also of the frame that it was given


@pytest.mark.parametrize("end", ["disconnected", "frozen and disconnected", "another", "closed"])
def test_it_ends_with_the_source_and_the_window(open_bench, end):
    with cameras(open_bench) as bench:
        if end == "closed":
            bench.window.close()
        elif end == "another":
            bench.connect(single(SYNTHETIC, sensor_file(bench.folder)))
        else:
            bench.state.freeze(end.startswith("frozen"))
            bench.window.live.leave.click()
        bench.wait(none_left)


def test_a_camera_alone_and_a_simulation_have_none(open_bench):
    bench, port = open_bench(), free_port()
    with robot(port):
        bench.connect(single(f"zenoh:tcp/127.0.0.1:{port}", sensor_file(bench.folder)))
        bench.follow(5)
        assert none_left()
    bench.connect(two(bench.folder))
    bench.follow(5)
    assert none_left()
