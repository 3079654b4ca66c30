"""Warnings about frames that contradict the calibration."""

from dataclasses import replace

import numpy as np
import pytest

import bubbleviz as bv
from bubbleviz.api.estimator import FrameSolver
from bubbleviz.api.frame_warnings import RECENT_FRAMES, FrameWarnings
from bubbleviz.pipeline import Pipeline
from bubbleviz.zeros import Zeros, zeros_of
from tests.small_press import record, small_source, write_small_sensor

HEIGHTS = [0.060] * 18 + np.linspace(0.049, 0.036, 10).tolist() + [0.060] * 6


@pytest.fixture(scope="module")
def wrong_gas(tmp_path_factory):
    """A recording whose gas pressure changes by a tenth of what it should.

    Its pipeline and zeros, and each frame with its result.
    """
    file = write_small_sensor(tmp_path_factory.mktemp("wrong") / "small.toml")
    rest_pa = bv.load_sensor(file).pneumatics.reference_pressure_pa
    frames = (
        replace(each, gas_pressure_pa=0.1 * each.gas_pressure_pa + 0.9 * rest_pa)
        for each in small_source(file, HEIGHTS)
    )
    path = record(file.with_name("press.mcap"), frames)
    pipeline = Pipeline.of(bv.load_sensor(file))
    with bv.open(path) as opened:
        zeros = zeros_of(opened.source, pipeline)
        solver = FrameSolver(pipeline, zeros=zeros)
        yield pipeline, zeros, [(frame, solver.solve(frame)) for frame in opened]


def test_causes_do_not_depend_on_the_order_in_which_frames_are_solved(wrong_gas):
    """The window solves frames as they are looked at; after the contact the image is as before."""
    pipeline, zeros, solved = wrong_gas
    found = []
    for order in (solved, solved[::-1]):
        counted = FrameWarnings(pipeline, zeros)
        for frame, result in order:
            counted.take(frame.index, frame, result)
        found.append(counted.texts())
    assert found[0] == found[1]
    assert "gas pressure is wrong or late" in found[0]["depth"]
    assert "camera drifted" not in found[0]["depth"]


def test_a_stream_forgets_what_was_repaired(wrong_gas):
    pipeline, zeros, solved = wrong_gas
    stream = FrameWarnings(pipeline, Zeros.of_stream(zeros.gas, pipeline))
    whole = FrameWarnings(pipeline, zeros)
    good = solved[0]
    for number, (frame, result) in enumerate(solved + RECENT_FRAMES * [good]):
        stream.take(number, frame, result)
        whole.take(number, frame, result)
        if number == len(solved):
            assert "depth" in stream.texts()
    assert "depth" not in stream.texts()
    assert "depth" in whole.texts()


@pytest.mark.parametrize(("every", "told"), [(20, False), (3, True)])
def test_frames_without_gas_pressure_among_others_are_told(wrong_gas, every, told):
    pipeline, zeros, solved = wrong_gas
    counted = FrameWarnings(pipeline, zeros)
    for number, (frame, result) in enumerate(solved):
        missing = {"gas_pressure_pa": None} if number % every == 0 else {}
        counted.take(number, replace(frame, **missing), result)
    assert ("have no gas pressure" in counted.texts().get("gas", "")) is told
