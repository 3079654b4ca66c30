"""How far the estimated force of a press moves with gauge pressure and pre-stretch."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bubbleviz.calibration.rest.rest_frames import Samples
from bubbleviz.frames.frame import Frame
from bubbleviz.inverse.estimator import EstimatorOptions
from bubbleviz.inverse.solvers.inverse_solver import RUBBER
from bubbleviz.pipeline import Pipeline
from bubbleviz.sensor_model import SensorModel

_GAUGE_STEP = 0.05
"""Step of the gauge pressure over itself: larger than where single nodes touch or do not."""
_STRETCH_STEP = 0.2
"""Step of ln (λ − 1), so that no λ is below 1."""


@dataclass(frozen=True)
class ForceSensitivity:
    """Size of the force on a press, and what moves it.

    Attributes
    ----------
    force_n : float
        |F|, N.
    per_gauge_n_per_pa : float
        d|F|/dG, N/Pa; γ0 follows G, from which Young–Laplace has it.
    per_prestretch_n : float
        d|F|/dλ, N.
    """

    force_n: float
    per_gauge_n_per_pa: float
    per_prestretch_n: float


def mean_frame(held: Samples) -> Frame:
    """The mean of frames in which a press is held."""
    depth = (held.statistics.range_m / held.camera.range_per_depth).astype(np.float32)
    gas = None if held.gas_pressure_pa is None else float(np.mean(held.gas_pressure_pa))
    return Frame(0, 0.0, depth, gas_pressure_pa=gas)


def force_sensitivity(model: SensorModel, frame: Frame) -> ForceSensitivity | None:
    """Central differences of the estimate on one frame.

    None where the sensor has no pre-stretch, or the frame is refused.
    """
    gauge, stretch = model.sensor.pneumatics.gauge_pressure_pa, model.sensor.membrane.prestretch
    if stretch is None:
        return None
    gauges = [gauge * (1.0 + sign * _GAUGE_STEP) for sign in (-1.0, 1.0)]
    stretches = [1.0 + (stretch - 1.0) * float(np.exp(s * _STRETCH_STEP)) for s in (-1.0, 1.0)]
    cases = [(gauge, stretch), *((g, stretch) for g in gauges), *((gauge, s) for s in stretches)]
    force = np.array([_force(_with(model, *case), frame) for case in cases])
    if not np.isfinite(force).all():
        return None
    return ForceSensitivity(
        force_n=float(force[0]),
        per_gauge_n_per_pa=float((force[2] - force[1]) / np.ptp(gauges)),
        per_prestretch_n=float((force[4] - force[3]) / np.ptp(stretches)),
    )


def _with(model: SensorModel, gauge_pa: float, prestretch: float) -> SensorModel:
    """The sensor under another gauge pressure, its absolute pressure the same."""
    sensor, pneumatics = model.sensor, model.sensor.pneumatics
    update = {
        "gauge_pressure_pa": gauge_pa,
        "atmospheric_pressure_pa": pneumatics.reference_pressure_pa - gauge_pa,
        "tension_n_per_m": model.tension_n_per_m * gauge_pa / pneumatics.gauge_pressure_pa,
    }
    changed = {
        "pneumatics": pneumatics.model_copy(update=update),
        "membrane": sensor.membrane.model_copy(update={"prestretch": prestretch}),
        "calibration": None,  # whose intervals are not asked for
    }
    return replace(model, sensor=sensor.model_copy(update=changed))


def _force(model: SensorModel, frame: Frame) -> float:
    """|F|, N; NaN where the frame is refused."""
    pipeline = Pipeline(model, EstimatorOptions(solver=RUBBER))
    estimate = pipeline.process(frame, frozenset({"estimate"})).estimate
    if estimate is None or estimate.status != "ok" or estimate.force_n is None:
        return float("nan")
    return float(np.linalg.norm(estimate.force_n))
