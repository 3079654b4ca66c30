"""A sensor identified from its contact-free frames."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from bubbleviz.calibration.rest_frames import FrameSamples, Ranges
from bubbleviz.calibration.surface import Surfaces
from bubbleviz.calibration.tension import Quantity, TensionEstimate
from bubbleviz.camera import DepthCamera, PixelModel
from bubbleviz.errors import InputError
from bubbleviz.membrane import MembraneMesh
from bubbleviz.recordings import ContactFree, DepthStatistics, FrameSource, error_of_mean
from bubbleviz.sensor import (
    ALTITUDE_SIGMA_PA,
    ATMOSPHERES,
    MIN_NOISE,
    WEATHER_SIGMA_PA,
    Camera,
    Membrane,
    Pneumatics,
    Sensor,
)
from bubbleviz.sensor_model import SensorModel
from bubbleviz.wording import count_of

if TYPE_CHECKING:
    from bubbleviz.calibration.material import RubberEstimate
    from bubbleviz.calibration.validation import Validation

_RESOLUTION_PA = 0.1  # of pressures in a sensor file


_NOT_YET: Any = None  # value of a result whose step was not done


@dataclass(frozen=True)
class Identification:
    """A sensor identified from its contact-free frames, or what the steps so far have found.

    Results of later steps are None; those of `Step.TENSION` make it `complete`.
    """

    given: Sensor = _NOT_YET  # the sensor file before identification
    ranges: Ranges = ()  # contact-free frames in use
    contact_free: ContactFree | None = None  # result of the search, even if it is not used
    samples: FrameSamples = _NOT_YET
    # chosen by validity and noise; from the surface on by bias, too
    pixels: PixelModel = _NOT_YET
    surfaces: Surfaces = _NOT_YET
    tension: TensionEstimate = _NOT_YET
    # absolute gas pressure of the open chamber, Pa, from which the tension has its gauge pressure
    vented: Quantity | None = None
    # None without inflation levels, press and open chamber
    rubber: RubberEstimate | None = None
    validation: Validation | None = None  # by a known press

    @property
    def complete(self) -> bool:
        """Whether all steps were done."""
        return self.tension is not None

    @property
    def mesh(self) -> MembraneMesh:
        return self.surfaces.mesh

    @property
    def tension_n_per_m(self) -> float:
        return self.tension.tension.value

    @property
    def prestretch(self) -> Quantity | None:
        """λ; None where it is not determined."""
        return None if self.rubber is None else self.rubber.prestretch

    @cached_property
    def sensor(self) -> Sensor:
        """The sensor identified.

        Its shape is "spherical_cap" where the sphere was chosen, else "mesh"; `write_sensor` writes
        the mesh file.
        """
        statistics, surfaces = self.samples.statistics, self.surfaces
        pneumatics = self.given.pneumatics.model_copy(update=self._pressures())
        prestretch = self.given.membrane.prestretch
        if self.prestretch is not None:
            prestretch = round(self.prestretch.value, 4)
        update = {
            "membrane": _membrane_section(surfaces, prestretch),
            "pneumatics": Pneumatics.model_validate(pneumatics.model_dump()),
            "camera": _camera_section(self.given.camera, surfaces.camera, statistics, self.pixels),
            "calibration": None,
        }
        return self.given.model_copy(update=update)

    @cached_property
    def model(self) -> SensorModel:
        """The identified sensor as it would be loaded from its files."""
        return SensorModel(self.sensor, DepthCamera.of(self.sensor.camera), self.mesh, self.pixels)

    @property
    def modelled_range_m(self) -> np.ndarray:
        """Range of the reference surface, (H, W), m; NaN where the ray misses it."""
        return self.samples.statistics.range_m - self.surfaces.residual_m

    def _pressures(self) -> dict[str, float | None]:
        """Pressures and γ0 for the sensor file."""
        gauge = self.tension.gauge
        sigma = max(round(gauge.sigma, 1), _RESOLUTION_PA) if gauge.known else None
        values = {
            "gauge_pressure_pa": round(gauge.value, 1),
            "gauge_sigma_pa": sigma,
            "tension_n_per_m": round(self.tension_n_per_m, 3),
        }
        if self.samples.gas_pressure_pa is not None:
            absolute = float(np.mean(self.samples.gas_pressure_pa))
            values["atmospheric_pressure_pa"] = round(absolute - gauge.value, 1)
        return values


def open_chamber(source: FrameSource) -> Quantity:
    """Absolute gas pressure of the open chamber, Pa: mean over all frames of a recording.

    Raises InputError: fewer than five frames with a gas pressure.
    """
    fewest = 5  # for a mean with a standard error; chosen
    values = [source[k].gas_pressure_pa for k in range(len(source))]
    known = np.array([value for value in values if value is not None])
    if len(known) < fewest:
        raise InputError(
            f"{source.name}: only {count_of(len(known), 'frame')} with a gas pressure; record "
            f"{fewest} or more with the chamber open, or give no open chamber (--vented)"
        )
    name = f"the open-chamber recording {source.name}"
    return Quantity.normal(float(np.mean(known)), error_of_mean(known), name)


def rest_gauge(samples: FrameSamples, sensor: Sensor, vented: Quantity | None = None) -> Quantity:
    """Gauge pressure of the contact-free frames, Pa.

    With the pressure of the open chamber, the difference of both recorded gas pressures. Else the
    sensor file's where it has a standard deviation, or no gas pressure was recorded. Else the
    recorded pressure less the sensor file's atmospheric pressure, with the deviation of weather,
    and of altitude if that is the standard atmosphere.
    Where the recorded pressure differs from that of the sensor file, either the weather or the
    inflation has changed, so the difference, up to the weather's, adds to the file's deviation.
    """
    pneumatics, in_file = sensor.pneumatics, "the sensor file"
    gauge, sigma = pneumatics.gauge_pressure_pa, pneumatics.gauge_sigma_pa
    gas = samples.gas_pressure_pa
    if gas is None:
        if vented is not None:
            raise InputError(
                f"{samples.source_name}: not every contact-free frame has a gas pressure, so "
                f"{vented.source} does not determine the gauge pressure; record it in all of "
                "them, or give no open chamber (--vented)"
            )
        return Quantity.normal(gauge, sigma, in_file)
    recorded = float(np.mean(gas))
    air = pneumatics.atmospheric_pressure_pa if vented is None else vented.value
    if sigma is not None and vented is None:
        if not ATMOSPHERES[0] <= recorded - gauge <= ATMOSPHERES[1]:
            raise InputError(
                f"{samples.source_name}: gas pressure {recorded:.0f} Pa minus the sensor file's "
                f"gauge pressure {gauge:.0f} Pa is not a plausible atmospheric pressure; record "
                "the absolute pressure in Pa, or correct gauge_pressure_pa in the sensor file"
            )
        change = min(abs(recorded - pneumatics.reference_pressure_pa), WEATHER_SIGMA_PA)
        return Quantity.normal(gauge, float(np.hypot(sigma, change)), in_file)
    gauge = recorded - air
    if gauge <= 0.0:
        whose, remedy = f"atmospheric_pressure_pa of {in_file}", "correct that"
        if vented is not None:
            whose, remedy = vented.source, "give the recording of the open chamber"
        raise InputError(
            f"{samples.source_name}: gas pressure {recorded:.0f} Pa is not above the atmospheric"
            f" {air:.0f} Pa from {whose}; inflate the bubble, record the absolute pressure in Pa, "
            f"or {remedy}"
        )
    if vented is None:
        outside, sigma = f"the atmospheric pressure in {in_file}", WEATHER_SIGMA_PA
        if not pneumatics.atmosphere_is_local:
            outside = f"the standard atmosphere, as {in_file} has no local one"
            sigma = float(np.hypot(sigma, ALTITUDE_SIGMA_PA))
        return Quantity.normal(gauge, sigma, f"the recorded gas pressure minus {outside}")
    sigma = max(float(np.hypot(vented.sigma, error_of_mean(gas))), _RESOLUTION_PA)
    return Quantity.normal(gauge, sigma, vented.source)


def _membrane_section(surfaces: Surfaces, prestretch: float | None) -> Membrane:
    section = Membrane(shape="mesh", mesh_file="membrane.ply", nodes=len(surfaces.mesh.nodes))
    if surfaces.chosen == "sphere":
        cap = surfaces.sphere.cap_above_rim
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
            "noise_relative": max(float(f"{relative:.3g}"), MIN_NOISE),
        }
    )
