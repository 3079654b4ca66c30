"""The scalars of a frame that are plotted over time."""

from dataclasses import replace

import pytest
from small_press import small_source

from bubbleviz.diagnostics import numbers_of
from bubbleviz.pipeline import Pipeline
from bubbleviz.sensor import load_sensor


@pytest.mark.parametrize("drift_pa", [0.0, 5.0])
def test_gas_law_gives_no_change_without_contact(sensor, drift_pa):
    """Boyle's law: without contact no gas is displaced, so a measured drift has no effect."""
    frame, pipeline = small_source(sensor, heights=(0.06,))[0], Pipeline.of(load_sensor(sensor))
    frame = replace(frame, gas_pressure_pa=pipeline.model.gas.P0 + drift_pa)
    result = pipeline.process(frame, frozenset({"estimate", "patch"}))
    numbers = numbers_of(result, pipeline.model.gas)
    assert numbers.status == "no_contact"
    assert numbers.gas_measured_pa == pytest.approx(drift_pa)
    assert numbers.gas_law_pa == 0.0


def test_gas_law_gives_the_pressure_of_a_press(sensor):
    source, pipeline = small_source(sensor, heights=(0.06, 0.042)), Pipeline.of(load_sensor(sensor))
    for index in range(2):
        result = pipeline.process(source[index], frozenset({"estimate", "patch"}))
    numbers = numbers_of(result, pipeline.model.gas)
    assert numbers.status == "ok"
    # a mesh of 200 nodes seen by 56×43 pixels misses some of the volume
    assert 0.4 < numbers.gas_law_pa / numbers.gas_measured_pa < 1.3
