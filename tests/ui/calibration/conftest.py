"""The γ0 panel on a dome known exactly."""

import pytest
from calibration_bench import Bench
from resting import RestingSource


@pytest.fixture(scope="session")
def resting(sensor):
    return RestingSource(sensor)


@pytest.fixture
def bench(drive, resting):
    made = Bench(drive(lambda _: resting))
    yield made
    made.let_go()
