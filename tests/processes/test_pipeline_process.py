"""A pipeline in another process: same results, and no loss when the process dies."""

import os
import signal
from contextlib import closing, contextmanager
from dataclasses import replace

import numpy as np
import psutil
import pytest
from small_press import small_source

from bubbleviz.camera import ImageErrors
from bubbleviz.errors import InputError
from bubbleviz.pipeline import FrameOptions, Pipeline
from bubbleviz.processes import DEPTH_PRODUCTS, PipelineProcess
from bubbleviz.recordings import Frame
from bubbleviz.sensor import load_sensor
from bubbleviz.zeros import Zeros

OPTIONS = FrameOptions(cloud_points=500)


@pytest.fixture(scope="module")
def frames(sensor):
    source = small_source(sensor)
    return [source[k] for k in range(len(source))]


@pytest.fixture(scope="module")
def pipeline(sensor):
    return Pipeline.of(load_sensor(sensor))


def started(process, frame):
    """Have a frame solved again and again until it is in the other process."""
    while process.pid is None:
        process.process(frame, DEPTH_PRODUCTS, OPTIONS)
        assert process.lost == ""
    return process.pid


@contextmanager
def running(pipeline, frames, timeout_s=60.0):  # no solve takes longer, whatever else runs
    """A process that has solved the first frame."""
    with closing(PipelineProcess(pipeline, timeout_s=timeout_s)) as process:
        started(process, frames[0])
        yield process


@pytest.fixture
def process(request, pipeline, frames):
    with running(pipeline, frames, *getattr(request, "param", ())) as process:
        yield process


@pytest.fixture(scope="module")
def shared(pipeline, frames):
    """One process for tests that it survives."""
    with running(pipeline, frames) as process:
        yield process


def test_the_process_does_not_take_time_from_the_window(shared):
    window, solver = (os.getpriority(os.PRIO_PROCESS, pid) for pid in (0, shared.pid))
    assert solver > window


def test_results_and_errors_are_those_of_a_local_pipeline(shared, pipeline, sensor, frames):
    process = shared
    here = Pipeline.of(load_sensor(sensor))
    here.process(frames[0], DEPTH_PRODUCTS, OPTIONS)
    zeroed = replace(
        frames[1],
        gas_pressure_pa=pipeline.model.gas.P0 + 300.0,
        gas_sigma_pa=2_000.0,
        image_errors=ImageErrors(np.full(6, 1e-4), 1e-10 * np.eye(6)),
    )
    for frame in (zeroed, *frames[1:]):
        a, b = (
            process.process(frame, DEPTH_PRODUCTS, OPTIONS),
            here.process(frame, DEPTH_PRODUCTS, OPTIONS),
        )
        assert process.lost == "" and a.frame.depth_m is frame.depth_m
        assert a.frame.gas_sigma_pa == b.frame.gas_sigma_pa == 0.0
        assert a.frame.gas_pressure_pa == pytest.approx(b.frame.gas_pressure_pa)
        assert set(a.times_ms) == set(b.times_ms)
        assert a.estimate.status == b.estimate.status
        for one, two in (
            (a.estimate.displacement_m, b.estimate.displacement_m),
            (a.estimate.contact_pressure_pa, b.estimate.contact_pressure_pa),
            (a.patch.level, b.patch.level),
            (a.cloud_m, b.cloud_m),
            (a.cloud_residual_m, b.cloud_residual_m),
        ):
            scale = np.nanmax(np.abs(two))
            np.testing.assert_allclose(one, two, rtol=1e-9, atol=1e-9 * scale)
        np.testing.assert_array_equal(a.patch.pixel_mask, b.patch.pixel_mask)
    assert {each.estimate.status for each in (a, b)} == {"no_contact"}
    # solved there, counted here
    before = pipeline.counts["estimate"]
    pipeline.restart()
    cold = pipeline.estimate_once(frames[2])
    process.process(frames[2], DEPTH_PRODUCTS, OPTIONS)
    assert pipeline.counts["estimate"] == before + 1
    again = pipeline.estimate_once(frames[2])  # from rest still: nothing was solved here
    np.testing.assert_array_equal(again.contact_pressure_pa, cold.contact_pressure_pa)
    # it continues after an error
    wrong = Frame(7, 0.0, np.ones((3, 4), np.float32))
    with pytest.raises(InputError, match="frame 7: image is 4×3 pixels"):
        process.process(wrong, DEPTH_PRODUCTS)
    assert process.process(frames[1], DEPTH_PRODUCTS).estimate is not None
    assert process.pid is not None and process.lost == ""


def test_an_object_at_rest_is_averaged_in_the_process_as_here(shared, sensor):
    source, process = small_source(sensor, [0.042] * 8), shared
    here = Pipeline.of(load_sensor(sensor))
    zeros = Zeros.of_stream(None, here)
    for k in range(len(source)):
        frame = replace(source[k], index=k + 10)
        there = process.process(frame, DEPTH_PRODUCTS, OPTIONS)
        averaged = zeros.applied(frame)
        assert there.frame.images == averaged.images and there.frame.depth_m is frame.depth_m
    assert averaged.images > 3 and process.lost == ""
    here.restart()
    expected = here.process(averaged, DEPTH_PRODUCTS, OPTIONS).estimate.force_n
    np.testing.assert_allclose(there.estimate.force_n, expected, rtol=0.01)
    alone = here.process(frame, DEPTH_PRODUCTS, OPTIONS).estimate.force_n
    assert np.linalg.norm(there.estimate.force_n - expected) < np.linalg.norm(alone - expected)


@pytest.mark.parametrize("process", [(1.0,)], indirect=True, ids=["1 s"])
@pytest.mark.parametrize(
    ("how", "words"),
    [
        (signal.SIGKILL, "the process ended with code -9 (killed by signal 9)"),
        (signal.SIGSTOP, "no answer for 1 s"),
    ],
)
def test_crashed_or_hanging_process_loses_no_frame(process, frames, how, words):
    pid = process.pid
    assert pid is not None
    os.kill(pid, how)
    # what needs colour is computed here: nobody has noticed
    assert process.process(frames[1], frozenset({"estimate", "pose"})).estimate is not None
    assert process.lost == ""
    for frame in frames[2:]:
        result = process.process(frame, DEPTH_PRODUCTS, OPTIONS)
        assert result.estimate is not None and result.frame.depth_m is frame.depth_m
        assert process.lost == words
    assert process.pid is None and not psutil.pid_exists(pid)


def test_close_ends_the_process_even_during_startup(pipeline, frames):
    first = PipelineProcess(pipeline)
    pid = started(first, frames[0])
    first.close()
    assert not psutil.pid_exists(pid) and first.lost == ""
    assert first.process(frames[1], DEPTH_PRODUCTS).estimate is not None  # here
    assert first.pid is None
    with closing(PipelineProcess(pipeline)) as second:
        second.process(frames[0], DEPTH_PRODUCTS)
        second.end()
        assert second.process(frames[1], DEPTH_PRODUCTS).estimate is not None
        assert second.pid is None and second.lost == ""
