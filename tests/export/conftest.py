"""One small press and its estimate, which the exports must reproduce."""

import numpy as np
import pytest
from small_press import write_press, write_small_sensor

import bubbleviz as bv


@pytest.fixture(scope="session")
def sensor(tmp_path_factory):
    return write_small_sensor(tmp_path_factory.mktemp("sensor") / "small.toml")


@pytest.fixture(scope="session")
def press(tmp_path_factory, sensor):
    return write_press(tmp_path_factory.mktemp("press") / "press.mcap", sensor)


@pytest.fixture(scope="session")
def estimated(press, sensor):
    """RESULT.npz of the press."""
    out = press.with_name("result.npz")
    bv.estimate(bv.open(press), sensor, out=out)
    with np.load(out) as file:
        return {key: file[key] for key in file.files}
