"""Warnings about frames that contradict the calibration."""

from dataclasses import replace

import numpy as np

import bubbleviz as bv
from bubbleviz.api.estimator import FrameSolver
from bubbleviz.api.frame_warnings import FrameWarnings
from bubbleviz.pipeline import Pipeline
from bubbleviz.zeros import zeros_of
from tests.small_press import record, small_source, write_small_sensor


def test_causes_do_not_depend_on_the_order_in_which_frames_are_solved(tmp_path):
    """The window solves frames as they are looked at; after the contact the image is as before."""
    file = write_small_sensor(tmp_path / "small.toml")
    heights = [0.060] * 18 + np.linspace(0.049, 0.036, 10).tolist() + [0.060] * 6
    rest_pa = bv.load_sensor(file).pneumatics.reference_pressure_pa
    frames = (
        replace(each, gas_pressure_pa=0.1 * each.gas_pressure_pa + 0.9 * rest_pa)
        for each in small_source(file, heights)
    )
    path, pipeline = record(tmp_path / "press.mcap", frames), Pipeline.of(bv.load_sensor(file))
    with bv.open(path) as opened:
        zeros = zeros_of(opened.source, pipeline)
        solver = FrameSolver(pipeline, zeros=zeros)
        solved = [(frame, solver.solve(frame)) for frame in opened]
    found = []
    for order in (solved, solved[::-1]):
        counted = FrameWarnings(pipeline, zeros)
        for frame, result in order:
            counted.take(frame, result)
        found.append(counted.texts("recording"))
    assert found[0] == found[1]
    assert "gas pressure is wrong or late" in found[0]["depth"]
    assert "camera drifted" not in found[0]["depth"]
