"""A sensor as its own contact-free frames describe it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from bubbleviz.calibration.rest_frames import Samples
from bubbleviz.calibration.surface import Surfaces
from bubbleviz.calibration.tension import Quantity, TensionEstimate
from bubbleviz.camera import DepthCamera, PixelModel
from bubbleviz.errors import InputError
from bubbleviz.membrane import MembraneMesh
from bubbleviz.recordings import DepthStatistics
from bubbleviz.sensor import (
    ATMOSPHERES,
    LEAST_NOISE,
    WEATHER_SIGMA_PA,
    Camera,
    Membrane,
    Pneumatics,
    Sensor,
)
from bubbleviz.sensor_model import SensorModel

if TYPE_CHECKING:
    from bubbleviz.calibration.material import RubberEstimate


@dataclass(frozen=True)
class Identification:
    """A sensor as its own contact-free frames describe it."""

    # of shape "spherical_cap" where the sphere was chosen, else "mesh", whose files do not exist
    # before `write_sensor`
    sensor: Sensor
    given: Sensor  # the sensor file it started from
    samples: Samples
    surfaces: Surfaces
    pixels: PixelModel
    tension: TensionEstimate
    # where inflation levels, a press or the open chamber told of gauge pressure and rubber
    rubber: RubberEstimate | None = None

    @property
    def mesh(self) -> MembraneMesh:
        return self.surfaces.mesh

    @property
    def statistics(self) -> DepthStatistics:
        """Of every pixel."""
        return self.samples.statistics

    @property
    def tension_n_per_m(self) -> float:
        return self.tension.tension.value

    @property
    def gauge(self) -> Quantity | None:
        """Gauge pressure, Pa, whose interval γ0's holds; None where nothing tells how well."""
        if self.rubber is not None and self.rubber.gauge is not None:
            return self.rubber.gauge
        pneumatics = self.sensor.pneumatics
        sigma = pneumatics.gauge_sigma_pa
        return None if sigma is None else Quantity.normal(pneumatics.gauge_pressure_pa, sigma)

    @property
    def gauge_rests_on(self) -> str:
        """What the gauge pressure comes from, in words."""
        return "the sensor file" if self.rubber is None else self.rubber.gauge_rests_on

    @cached_property
    def model(self) -> SensorModel:
        """The identified sensor as it would be loaded from its files."""
        return SensorModel(self.sensor, DepthCamera.of(self.sensor.camera), self.mesh, self.pixels)

    @property
    def modelled_range_m(self) -> np.ndarray:
        """Range of the rays cast on the reference surface, (H, W), m; NaN where they miss."""
        return self.statistics.range_m - self.surfaces.residual_m


def rest_gauge(samples: Samples, sensor: Sensor) -> tuple[float, float | None]:
    """Gauge pressure of the contact-free frames and its standard deviation, Pa.

    The sensor file's where that says how well it is known, or no gas pressure was recorded; else
    the recorded one less the sensor file's atmospheric pressure, which leaves the weather's. A
    sensor file that says how well its gauge pressure is known is off by as much as the recorded
    pressure is another one than its, too: either the weather changed since, or the inflation, and
    nothing tells which. None: nothing tells how well it is known.
    """
    pneumatics = sensor.pneumatics
    gauge, sigma = pneumatics.gauge_pressure_pa, pneumatics.gauge_sigma_pa
    if samples.gas_pressure_pa is None:
        return gauge, sigma
    rest = float(np.median(samples.gas_pressure_pa))
    if sigma is not None:
        if not ATMOSPHERES[0] <= rest - gauge <= ATMOSPHERES[1]:
            raise InputError(
                f"{samples.source_name}: gas pressure {rest:.0f} Pa minus the sensor file's gauge "
                f"pressure {gauge:.0f} Pa is not a plausible atmospheric pressure; record the "
                "absolute pressure, or correct the sensor file"
            )
        moved = abs(rest - pneumatics.reference_pressure_pa)
        return gauge, float(np.hypot(sigma, min(moved, WEATHER_SIGMA_PA)))
    gauge = rest - pneumatics.atmospheric_pressure_pa
    if gauge <= 0.0:
        raise InputError(
            f"{samples.source_name}: gas pressure {rest:.0f} Pa is not above the atmospheric"
            f" {pneumatics.atmospheric_pressure_pa:.0f} Pa; correct the atmospheric pressure in "
            "the sensor file, or inflate the bubble"
        )
    return gauge, WEATHER_SIGMA_PA


def assemble(
    sensor: Sensor,
    samples: Samples,
    surfaces: Surfaces,
    pixels: PixelModel,
    tension: TensionEstimate,
) -> Identification:
    """Put what the steps found into a sensor."""
    sigma = rest_gauge(samples, sensor)[1]
    pneumatics = sensor.pneumatics.model_copy(update=pressures(samples, tension, sigma))
    update = {
        "membrane": _membrane_section(surfaces, sensor.membrane.prestretch),
        "pneumatics": Pneumatics.model_validate(pneumatics.model_dump()),
        "camera": _camera_section(sensor.camera, surfaces.camera, samples.statistics, pixels),
        "calibration": None,
    }
    return Identification(
        sensor=sensor.model_copy(update=update),
        given=sensor,
        samples=samples,
        surfaces=surfaces,
        pixels=pixels,
        tension=tension,
    )


def pressures(
    samples: Samples, tension: TensionEstimate, gauge_sigma_pa: float | None
) -> dict[str, float | None]:
    """Pressures and γ0 of the sensor file; the recorded gas pressure is that of its rest."""
    gauge = tension.gauge_pressure_pa
    values = {
        "gauge_pressure_pa": round(gauge, 1),
        "gauge_sigma_pa": None if gauge_sigma_pa is None else round(gauge_sigma_pa, 1),
        "tension_n_per_m": round(tension.tension.value, 3),
    }
    if samples.gas_pressure_pa is not None:
        absolute = float(np.median(samples.gas_pressure_pa))
        values["atmospheric_pressure_pa"] = round(absolute - gauge, 1)
    return values


def _membrane_section(surfaces: Surfaces, prestretch: float | None) -> Membrane:
    section = Membrane(shape="mesh", mesh_file="membrane.ply", nodes=len(surfaces.mesh.nodes))
    if surfaces.chosen == "sphere":
        cap = surfaces.sphere.over_rim
        section = Membrane(
            shape="spherical_cap",
            rim_radius_m=round(cap.rim_semi_axes_m[0], 7),
            height_m=round(cap.height_m, 7),
            nodes=section.nodes,
        )
    return section.model_copy(update={"prestretch": prestretch})


def _camera_section(
    section: Camera, camera: DepthCamera, statistics: DepthStatistics, pixels: PixelModel
) -> Camera:
    relative = np.median(statistics.noise_m[pixels.mask] / statistics.range_m[pixels.mask])
    return section.model_copy(
        update={
            **vars(camera.intrinsics),
            "position_m": tuple(round(float(x), 6) for x in camera.T_B_C[:3, 3]),
            "noise_relative": max(float(f"{relative:.3g}"), LEAST_NOISE),
        }
    )
