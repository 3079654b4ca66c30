"""The γ0 panel on a dome known exactly."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from calibration_bench import Bench
from resting import RestingSource
from window_driver import Drive

from bubbleviz.sensor import Sensor


@pytest.fixture(scope="session")
def resting(sensor: Sensor) -> RestingSource:
    return RestingSource(sensor)


@pytest.fixture
def bench(drive: Drive, resting: RestingSource) -> Iterator[Bench]:
    made = Bench(drive(lambda _: resting))
    yield made
    made.let_go()
