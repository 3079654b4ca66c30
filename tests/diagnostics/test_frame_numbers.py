"""The scalars of a frame that are plotted over time."""

from dataclasses import replace

import numpy as np
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


def test_the_area_of_a_small_contact_is_in_the_histogram_of_its_pressure(sensor):
    pipeline = Pipeline.of(load_sensor(sensor))
    frame = small_source(sensor, heights=(0.06,))[0]
    result = pipeline.process(frame, frozenset({"estimate"}))
    mesh = pipeline.mesh
    top, pressure = np.argmax(mesh.nodes[:, 2]), np.zeros(len(mesh.nodes))
    pressure[top] = 1e4  # far above its mean; it falls linearly to the nodes around
    pressed = replace(result, estimate=replace(result.estimate, contact_pressure_pa=pressure))
    curve = pipeline.diagnose(pressed, frozenset({"kappa_curve"})).inspection.kappa_curve
    around = mesh.facet_areas[(mesh.triangles == top).any(axis=1)].sum()
    share = curve.kappa * mesh.areas[top] / mesh.areas.sum()  # of the peak
    above = around * np.clip(1.0 - share, 0.0, None) ** 2
    np.testing.assert_allclose(curve.histogram_m2, above[:-1] - above[1:], atol=1e-12)
    assert (curve.histogram_m2 > 0.0).sum() > 20
