"""Comparison of two sensor files: parameters, and the range that each predicts in every pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from bubbleviz.calibration.identification import RUBBER_NAMES, Identification
from bubbleviz.sensor import Calibration, Sensor
from bubbleviz.sensor_model import SensorModel

QuantityKind = Literal[
    "tension", "pressure", "length", "fine length", "volume", "area", "count", "number"
]


@dataclass(frozen=True)
class ComparisonRow:
    """One parameter of two sensors, SI."""

    name: str
    kind: QuantityKind  # determines the unit: N/m, Pa, m, m, m³, m², pixels, none
    old: float | None
    new: float | None
    # half_width, old_half_width: half of the 95 % intervals of the new and of the old one
    half_width: float | None = None
    old_half_width: float | None = None


@dataclass(frozen=True)
class SensorComparison:
    """The sensor in use against the identified one."""

    rows: tuple[ComparisonRow, ...]
    # (H, W), range of the untouched membrane with bias as predicted by the new sensor minus that by
    # the old one, m; NaN where either has none
    difference_m: np.ndarray

    @classmethod
    def of(cls, old: Sensor, new: Identification) -> SensorComparison:
        """Compare the sensor in use with the one identified from its frames.

        Raises InputError: the old sensor's files are unreadable, or of another camera.
        """
        intrinsics = new.model.camera.intrinsics
        measured = np.where(new.pixels.mask, new.samples.statistics.range_m, np.nan)
        models = SensorModel.of(old, intrinsics), new.model
        before, after = (_numbers(model, measured) for model in models)
        known = old.calibration or Calibration(pixels_file="")  # without intervals
        height = new.surfaces.dimensions["height_m"]
        found = {"γ0": new.tension, "gauge pressure": new.gauge, "height": height}
        found |= {RUBBER_NAMES[name]: each for name, each in new.rubber.items()}
        intervals = {
            "γ0": known.tension_interval_n_per_m,
            "gauge pressure": known.gauge_interval_pa,
            **{text: getattr(known, f"{name}_interval") for name, text in RUBBER_NAMES.items()},
        }
        half = {name: each.half_width for name, each in found.items()}
        old_half = {name: 0.5 * float(np.ptp(ends)) for name, ends in intervals.items() if ends}
        rows = tuple(
            ComparisonRow(name, kind, value, after[name, kind], half.get(name), old_half.get(name))
            for (name, kind), value in before.items()
            if value is not None or after[name, kind] is not None
        )
        return cls(rows, np.subtract(*(_expected(model)[1] for model in reversed(models))))

    @property
    def largest_m(self) -> float:
        """99th percentile of the absolute difference, m."""
        known = np.abs(self.difference_m[np.isfinite(self.difference_m)])
        return max(float(np.percentile(known, 99.0)), 1e-6) if known.size else 1e-6


def _expected(model: SensorModel) -> tuple[np.ndarray, np.ndarray]:
    """Range (H, W) of the surface alone, and with the bias in the pixels used, m."""
    surface_m, pixels = model.view.rest_range, model.pixels
    if pixels is None:
        return surface_m, surface_m
    return surface_m, np.where(pixels.mask, surface_m + pixels.bias_m, np.nan)


def _numbers(
    model: SensorModel,
    measured_m: np.ndarray,  # (H, W), range of the untouched membrane, m; NaN: not used
) -> dict[tuple[str, QuantityKind], float | None]:
    """Parameters of a sensor, and its misfit to the measured range."""
    sensor, mesh, pixels = model.sensor, model.mesh, model.pixels
    half_x, half_y = 0.5 * np.ptp(mesh.nodes[mesh.rim, :2], axis=0)
    noise = None if pixels is None else float(np.median(pixels.noise_m[pixels.mask]))
    used = None if pixels is None else float(pixels.mask.sum())
    plain, biased = (_rms(measured_m - expected) for expected in _expected(model))
    return {
        ("γ0", "tension"): model.tension_n_per_m,
        **{(text, "number"): getattr(sensor.membrane, name) for name, text in RUBBER_NAMES.items()},
        ("gauge pressure", "pressure"): sensor.pneumatics.gauge_pressure_pa,
        ("height", "length"): float(mesh.nodes[:, 2].max()),
        ("rim radius along x", "length"): float(half_x),
        ("rim radius along y", "length"): float(half_y),
        ("membrane area", "area"): float(mesh.areas.sum()),
        ("cap volume", "volume"): mesh.cap_volume(),
        ("rms misfit", "fine length"): plain,
        ("rms with bias", "fine length"): biased,
        ("noise of a pixel", "fine length"): noise,
        ("pixels used", "count"): used,
    }


def _rms(values: np.ndarray) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else None
