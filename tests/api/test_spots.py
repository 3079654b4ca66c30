"""A place whose depth is wrong in every frame, as by dust on the camera's window."""

from dataclasses import replace

import numpy as np
import pytest

import bubbleviz as bv
from tests.small_press import changed

SENSOR = changed(bv.load_sensor("pico_flexx_75mm"), membrane={"nodes": 400})
ABOVE = "0.004 0.002 0.09 0 0 0 1"  # pose of an object that touches nothing


@pytest.fixture(scope="module")
def frames():
    found = bv.simulate(SENSOR, "sphere", ABOVE, frames=40, seed=1, noise_relative=0.01)
    return [replace(each, time_s=0.1 * k) for k, each in enumerate(found)]


def with_spot(frames, error_m):
    """Images with a spot of 69 pixels from the tenth on."""
    row, column = np.indices(frames[0].depth_m.shape)
    spot = (row - 60) ** 2 + (column - 150) ** 2 < 25
    return [
        replace(each, depth_m=each.depth_m + error_m * spot) if k >= 10 else each
        for k, each in enumerate(frames)
    ]


@pytest.mark.parametrize("error_m", [-3e-3, 2e-3])
def test_spot_of_dust_is_told_with_its_place(frames, error_m):
    warning = bv.estimate(with_spot(frames, error_m), SENSOR).warning
    assert ("-" if error_m < 0.0 else "+") in warning.split("about")[1].split("mm")[0]
    place = warning.split("around column ")[1].split(",")
    assert abs(int(place[0]) - 150) <= 6 and abs(int(place[1].removeprefix(" row ")) - 60) <= 6


def test_images_without_a_spot_give_no_warning(frames):
    assert bv.estimate(frames, SENSOR).warning is None


def test_images_of_a_looping_source_give_no_warning(frames):
    looping = [replace(frames[k % 3], index=k, time_s=0.11 * k) for k in range(18)]
    assert bv.estimate(looping, SENSOR).warning is None
