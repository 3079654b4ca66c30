"""Two sensor files side by side: numbers, and the range each expects in every pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from bubbleviz.calibration.identification import Identification
from bubbleviz.calibration.tension import Quantity
from bubbleviz.camera import PixelModel
from bubbleviz.errors import InputError
from bubbleviz.membrane import MembraneMesh
from bubbleviz.sensor import Sensor
from bubbleviz.sensor_model import SensorModel

Kind = Literal["tension", "pressure", "length", "fine length", "volume", "area", "count", "number"]


@dataclass(frozen=True)
class Row:
    """One number of two sensors, SI."""

    name: str
    kind: Kind  # what it is, and so its unit: N/m, Pa, m, m³, m², pixels, none
    old: float | None
    new: float | None
    # half_width, old_half_width: half of the new one's 95 % interval, and of the old one's
    half_width: float | None = None
    old_half_width: float | None = None


@dataclass(frozen=True)
class Comparison:
    """The sensor in use against the identified one."""

    rows: tuple[Row, ...]
    # (H, W), range the new sensor expects of the untouched membrane minus the old one's, surface
    # and bias together, m; NaN where either says nothing
    difference_m: np.ndarray

    @property
    def largest_m(self) -> float:
        """Difference that only one pixel in a hundred exceeds, m."""
        known = np.abs(self.difference_m[np.isfinite(self.difference_m)])
        return max(float(np.percentile(known, 99.0)), 1e-6) if known.size else 1e-6


def compare(old: Sensor, new: Identification) -> Comparison:
    """Compare the sensor in use with the one identified from its frames.

    Raises InputError: the old sensor's files are unreadable, or of another camera.
    """
    intrinsics, mask = new.model.camera.intrinsics, new.pixels.mask
    if (old.camera.width, old.camera.height) != (intrinsics.width, intrinsics.height):
        raise InputError(f"{old.name}: of another camera; nothing to compare by pixel")
    model = SensorModel.of(old, intrinsics)
    pixels = model.pixels
    before = _expected(model.view.rest_range, pixels)
    after = _expected(new.modelled_range_m, new.pixels)
    measured = np.where(mask, new.statistics.range_m, np.nan)
    noise = None if pixels is None else float(np.median(pixels.noise_m[pixels.mask]))
    used = None if pixels is None else float(pixels.mask.sum())
    rows = (
        *_numbers(model, new),
        *(
            Row(name, "fine length", _rms(measured - was), _rms(measured - now))
            for name, was, now in zip(("rms misfit", "rms with bias"), before, after, strict=True)
        ),
        Row("noise of a pixel", "fine length", noise, float(np.median(new.pixels.noise_m[mask]))),
        Row("pixels used", "count", used, float(mask.sum())),
    )
    return Comparison(rows, after[1] - before[1])


def _expected(surface_m: np.ndarray, pixels: PixelModel | None) -> tuple[np.ndarray, np.ndarray]:
    """Range (H, W) of the surface alone, and with the bias in the pixels used, m."""
    if pixels is None:
        return surface_m, surface_m
    return surface_m, np.where(pixels.mask, surface_m + pixels.bias_m, np.nan)


def _numbers(old: SensorModel, new: Identification) -> list[Row]:
    """Rows that need no images."""
    was, now, known = old.sensor, new.sensor, old.sensor.calibration
    before: tuple[tuple[float, float] | None, ...] = (
        (None,) * 3
        if known is None
        else (known.tension_interval_n_per_m, known.prestretch_interval, known.gauge_interval_pa)
    )
    tension, stretch = new.tension.tension, None if new.rubber is None else new.rubber.prestretch
    told = tension.half_width, _half(stretch), _half(new.gauge)
    values: tuple[tuple[str, Kind, float | None, float | None], ...] = (
        ("γ0", "tension", old.tension_n_per_m, tension.value),
        ("λ", "number", was.membrane.prestretch, now.membrane.prestretch),
        ("gauge pressure", "pressure", was.pneumatics.gauge_pressure_pa,
         now.pneumatics.gauge_pressure_pa),
    )  # fmt: skip
    intervals = [None if each is None else 0.5 * (each[1] - each[0]) for each in before]
    rows = [Row(*row, *half) for row, *half in zip(values, told, intervals, strict=True)]
    height = new.tension.dimensions["height_m"].half_width
    sizes = zip(_sizes(old.mesh).items(), _sizes(new.mesh).values(), strict=True)
    for (name, size), other in sizes:
        rows.append(Row(name, "length", size, other, height if name == "height" else None))
    rows.append(Row("membrane area", "area", *(float(m.areas.sum()) for m in (old.mesh, new.mesh))))
    rows.append(Row("cap volume", "volume", old.mesh.cap_volume(), new.mesh.cap_volume()))
    return rows


def _half(found: Quantity | None) -> float | None:
    return None if found is None else found.half_width


def _sizes(mesh: MembraneMesh) -> dict[str, float]:
    """Height of the dome and half of the rim's extent along x and y, m."""
    half = 0.5 * np.ptp(mesh.nodes[mesh.rim, :2], axis=0)
    return {
        "height": float(mesh.nodes[:, 2].max()),
        "rim radius along x": float(half[0]),
        "rim radius along y": float(half[1]),
    }


def _rms(values: np.ndarray) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else None
