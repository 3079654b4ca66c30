"""Strength λ of the H1 term: at the default the misfit equals the noise.

Most pixels see no contact, so that the misfit moves by a few parts in a thousand over decades of λ:
the discrepancy principle needs the noise known that well, as only a simulation knows it.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from bubbleviz.inverse import LINEAR, PRESSURE_SCALE, EstimatorOptions
from bubbleviz.membrane import cotangent_laplacian
from bubbleviz.pipeline import Pipeline
from bubbleviz.sensor import load_sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation import (
    GRID_OBJECTS,
    DepthNoise,
    LinearPresses,
    Press,
    TruthBank,
    with_nodes,
)
from bubbleviz.study.accuracy import PRODUCTS, at_nodes, errors_of


@dataclass
class Strength:
    """Means over some presses: misfit over the noise's, √∫|∇p_c|² dA, and errors."""

    misfit: float
    roughness_pa: float
    iou: float
    force_error: float


def strength(sensor, sightings, bank, factor):
    # λ is the inverse square of the pressure that the prior expects.
    scale = PRESSURE_SCALE / np.sqrt(factor)
    options = EstimatorOptions(LINEAR, pressure_scale=scale, image_error=0.0)
    pipeline = Pipeline.of(sensor, options=options)
    L, rows = cotangent_laplacian(pipeline.mesh), []
    for sighting in sightings:
        frame = bank.frame(sighting.range_m, DepthNoise(relative=sensor.camera.noise_relative), 0)
        pipeline.process(replace(frame, depth_m=np.full_like(frame.depth_m, np.nan)), PRODUCTS)
        result = pipeline.process(frame, PRODUCTS)
        assert result.estimate.status == "ok"
        errors, p = errors_of(pipeline, result, sighting), result.estimate.contact_pressure_pa
        misfit = result.estimate.residual_rms_m / noise_rms(pipeline, sighting, frame)
        rows.append((misfit, np.sqrt(p @ (L @ p)), errors.iou, errors.force_error_relative))
    return Strength(*np.mean(rows, axis=0))


def noise_rms(pipeline, sighting, frame):
    """Weighted rms of the noise of a frame: residual to the true shape."""
    observer = pipeline.estimator.observer
    truth = at_nodes(pipeline.mesh, sighting.mesh, sighting.truth.displacement_m)
    view = observer.around(pipeline.mesh.deformed(truth))
    observation = observer.observe(frame.depth_m, view.model_m)
    error = (observation.residual_m - view.model_m)[view.block]
    return observer.misfit(observation, view.block, error, 1.0).rms_m


@pytest.mark.parametrize(
    ("objects", "nodes", "truth_nodes"),
    [(("sphere",), 700, 2_500), pytest.param(GRID_OBJECTS, None, 12_500, marks=pytest.mark.long)],
)
def test_the_shipped_strength_is_neither_too_weak_nor_too_strong(objects, nodes, truth_nodes):
    sensor = load_sensor("pico_flexx_75mm")
    sensor = sensor if nodes is None else with_nodes(sensor, nodes)
    bank = TruthBank(LinearPresses.of(SensorModel.of(sensor), truth_nodes), 3)
    sightings = [bank.simulate(Press(name, 0.012, False)) for name in objects]
    weak, shipped, strong = (strength(sensor, sightings, bank, f) for f in (1e-2, 1.0, 1e2))
    assert weak.roughness_pa > shipped.roughness_pa > strong.roughness_pa
    assert [weak.misfit, shipped.misfit] == pytest.approx([1.0, 1.0], abs=0.01)
    assert strong.misfit > 1.02
    assert shipped.iou > max(weak.iou, strong.iou)
    assert shipped.force_error < strong.force_error
