"""The γ0 panel on a dome known exactly."""

import pytest
from calibration_bench import Bench
from resting import RestingSource


@pytest.fixture(scope="session")
def sensor(sensor):
    """Of known gauge pressure: the weather would else be all of γ0's interval."""
    told = sensor.pneumatics.model_copy(update={"gauge_sigma_pa": 10.0})
    return sensor.model_copy(update={"pneumatics": told})


@pytest.fixture(scope="session")
def resting(sensor):
    return RestingSource(sensor)


@pytest.fixture
def bench(drive, resting):
    made = Bench(drive(lambda _: resting))
    yield made
    made.let_go()
