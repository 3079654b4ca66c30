"""Intervals of forces by constant tension, where the membrane is rubber of another solver."""

import numpy as np
import pytest

import bubbleviz as bv
from bubbleviz.calibration import write_sensor
from bubbleviz.pipeline import Pipeline
from bubbleviz.sensor import load_sensor
from tests.rubber_renders import GAUGE_PA, at_rest, dome_sensor, rubber_truth
from tests.small_press import changed

from .conftest import DOME_CAMERA, dome_images

GAUGE_SIGMA = 0.04  # relative, of the gauge pressure in the sensor file


@pytest.fixture(scope="module")
def dome():
    return rubber_truth("dome_ball")


@pytest.mark.parametrize(
    "deviations", [-1.0, *(pytest.param(each, marks=pytest.mark.long) for each in (0.0, 1.0))]
)
def test_interval_holds_the_force_without_prestretch(dome, deviations, tmp_path):
    """With a gauge pressure in the sensor file that is off by some of its standard deviations."""
    gauge_pa = (1.0 + deviations * GAUGE_SIGMA) * GAUGE_PA
    air_pa = dome_sensor().pneumatics.reference_pressure_pa - gauge_pa
    pneumatics = {
        "gauge_pressure_pa": gauge_pa,
        "gauge_sigma_pa": GAUGE_SIGMA * GAUGE_PA,
        "atmospheric_pressure_pa": air_pa,
    }
    sensor = changed(dome_sensor(DOME_CAMERA), pneumatics=pneumatics)
    rest = dome_images(dome, at_rest(dome["rest_m"], 10), GAUGE_PA)
    found = bv.identify(rest, sensor, contact_free=range(10), nodes=500).found
    write_sensor(found, tmp_path / "dome.toml")
    _assert_inside(dome, Pipeline.of(load_sensor(tmp_path / "dome.toml")))


def test_interval_holds_the_force_by_a_file_that_was_never_calibrated(dome):
    _assert_inside(dome, Pipeline.of(dome_sensor(DOME_CAMERA)))


def _assert_inside(dome, pipeline):
    chosen = {name: dome[name][::3] for name in ("nodes_m", "gauge_pressure_pa", "force_n")}
    images = dome_images(dome, chosen["nodes_m"], chosen["gauge_pressure_pa"], 1e-4, 2)
    for image, force in zip(images, chosen["force_n"], strict=True):
        found = pipeline.estimate_once(image)
        error, size = found.force_n - force, np.linalg.norm(force)
        assert np.all(np.abs(error) < 1.96 * found.force_sigma_n)
        assert (found.force_sigma_n < 0.16 * size).all()
