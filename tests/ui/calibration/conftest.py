"""The calibration panel on an exactly known dome."""

import pytest
from calibration_bench import Bench
from resting import RestingSource

from tests.small_press import changed


@pytest.fixture(scope="session")
def sensor(sensor):
    """With known gauge pressure; else the weather would dominate the interval of γ0."""
    return changed(sensor, pneumatics={"gauge_sigma_pa": 10.0})


@pytest.fixture(scope="session")
def resting(sensor):
    return RestingSource(sensor)


@pytest.fixture
def bench(drive, resting):
    made = Bench(drive(lambda _: resting))
    yield made
    made.release()
