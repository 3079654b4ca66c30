"""A stream whose camera fails ends with one clear error, after a time that can be chosen."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import pytest
from small_press import small_source
from streams import robot

import bubbleviz as bv
from benchmarks.window.live_soak import free_port
from bubbleviz.errors import StreamStoppedError
from bubbleviz.live import SessionOptions, ZenohPublisher
from bubbleviz.recordings import RecordingWriter

BEFORE, GAP_S = 4, 2.5
"""Frames before and after the gap, and its length: more than twice the time that is waited."""


@pytest.fixture(scope="module")
def gaps(sensor):
    """A press whose camera falls silent and comes back."""
    frame, path = small_source(sensor)[0], sensor.with_name("gaps.mcap")
    with RecordingWriter(path) as writer:
        for k in range(2 * BEFORE):
            time_s = 0.1 * k + GAP_S * (k // BEFORE)
            writer.write(replace(frame, index=k, time_s=time_s, stamp_ns=0))
    return path


def test_frames_results_and_poses_of_a_stopped_stream_end_with_one_error(gaps, sensor):
    tracked = partial(bv.track, object="cylinder", timeout_s=0.6)
    for made, least_s in ((iter, 1.0), (bv.estimate, 1.0), (tracked, 0.6)):
        with (
            bv.connect(f"replay:{gaps}", sensor) as stream,
            pytest.raises(StreamStoppedError, match=r"no depth image for [01]\.\d s") as error,
        ):
            for _ in made(stream):
                pass
        said = str(error.value)
        assert said.startswith(f"{stream.name}: ") and "timeout_s" in said and "\n" not in said
        assert least_s <= stream.status().silent_s < GAP_S


LONG = {"timeout_s": 2.0 * GAP_S}


def test_longer_timeout_receives_frames_after_a_gap(gaps, sensor):
    """None, of an estimate, of its stream, and of a stream alone: all are waited for at once.

    The replay is so fast that its gap is still longer than is waited without them.
    """

    def last(of_stream, made):
        with bv.connect(f"replay:{gaps}?speed=1.8", sensor, **of_stream) as stream:
            return [each.time_s for each in made(stream)][-1], stream.ended

    cases = [
        ({}, partial(bv.estimate, timeout_s=None)),
        ({}, partial(bv.estimate, **LONG)),
        (LONG, bv.estimate),
        (LONG, iter),
    ]
    with ThreadPoolExecutor(len(cases)) as pool:
        for time_s, ended in pool.map(last, *zip(*cases, strict=True)):
            assert time_s > GAP_S and ended


def test_timeout_counts_from_the_last_frame(gaps, sensor, eventually):
    """A loop that was busy while the camera failed does not wait once more."""
    with bv.connect(f"replay:{gaps}", sensor, timeout_s=1.4) as stream:
        frames = iter(stream)
        while next(frames).index < BEFORE - 1:
            pass
        eventually(lambda: stream.status().silent_s >= 1.4)
        with pytest.raises(StreamStoppedError, match=r"no depth image for (1\.[4-9]|2\.[0-4]) s"):
            next(frames)


def test_killed_robot_ends_the_loop(small_sensor):
    """Until then every result has the time of its image, and after it its age grows.

    No thread of Zenoh's outlives the stream: one that ended while Python exits would abort it.
    """
    port, threads = free_port(), set(threading.enumerate())
    with (
        robot(port) as process,
        bv.connect(f"zenoh:tcp/127.0.0.1:{port}", small_sensor) as stream,
        pytest.raises(StreamStoppedError, match="no depth image for"),
    ):
        before_ns = time.time_ns()
        for count, found in enumerate(bv.estimate(stream, timeout_s=0.5)):
            arrived_ns, asked_ns = found.result.frame.arrival_ns, time.time_ns()
            age_s = found.age_s
            assert before_ns < arrived_ns < asked_ns
            assert age_s > 1e-9 * (asked_ns - arrived_ns) - 1e-6
            if count == 3:
                process.kill()
    assert found.age_s > max(age_s, 0.5)  # the time-out counts from the last image
    assert set(threading.enumerate()) <= threads


@pytest.mark.parametrize("made", [iter, bv.estimate])
def test_robot_without_a_camera_times_out(made, sensor, monkeypatch):
    """The robot is connected but never sends a depth image."""
    port = free_port()
    monkeypatch.setattr("bubbleviz.live.opening.FIRST_MESSAGE_S", 0.5)
    with (
        ZenohPublisher(SessionOptions("robot", listen=f"tcp/127.0.0.1:{port}")),
        bv.connect(f"zenoh:tcp/127.0.0.1:{port}", sensor, timeout_s=0.2) as stream,
        pytest.raises(bv.InputError, match="no depth image arrived: no topics were found"),
    ):
        next(iter(made(stream)))
