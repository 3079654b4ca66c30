"""A sensor identified from its contact-free frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from bubbleviz.calibration.rest_frames import FrameSamples, Ranges
from bubbleviz.calibration.surface import NOT_YET, Quantity, SurfaceName, Surfaces
from bubbleviz.camera import DepthCamera, PixelModel
from bubbleviz.errors import InputError
from bubbleviz.membrane import RUBBER_PARAMETERS, MembraneMesh
from bubbleviz.recordings import ContactFree, DepthStatistics, FrameSource, error_of_mean
from bubbleviz.result import HALF_95
from bubbleviz.sensor import (
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
    from bubbleviz.simulation import Validation

_RESOLUTION_PA = 0.1  # of pressures in a sensor file
PRESSURE_ERROR = 0.01
"""Standard deviation of gas pressure differences between recordings, over their largest gauge
pressure. Data sheets of silicon pressure sensors give a total error band of ±1 to ±2 % of full
scale, due to zero, span and temperature (Honeywell HSC and ABP: ±1 and ±1.5 %), and full scale is
at least that pressure; ±2 % is taken as the 95 % interval. That of an absolute sensor is larger,
but most of its error is the same in both recordings. Frames of one recording share zero and
temperature, so a press in the same recording does not have this error."""
RUBBER_NAMES = {name: name.replace("_", " ") for name in RUBBER_PARAMETERS} | {"prestretch": "λ"}
_FILE = "the sensor file"


@dataclass(frozen=True)
class Identification:
    """A sensor identified from its contact-free frames, or the results of the steps so far.

    Results of later steps are None; with those of `Step.TENSION` it is `complete`.
    """

    given: Sensor = NOT_YET  # the sensor file before identification
    ranges: Ranges = ()  # contact-free frames in use
    contact_free: ContactFree | None = None  # result of the search, even if it is not used
    samples: FrameSamples = NOT_YET
    # chosen by validity and noise; from the surface on by bias, too
    pixels: PixelModel = NOT_YET
    surfaces: Surfaces = NOT_YET
    # absolute gas pressure of the open chamber, Pa, from which `gauge` was found
    vented: Quantity | None = None
    gauge: Quantity = NOT_YET  # gauge pressure, Pa
    # of `RUBBER_PARAMETERS` those that were determined, within their limits
    rubber: Mapping[str, Quantity] = field(default_factory=dict)
    why_not: str = "neither levels nor a held press were used"  # to determine λ
    shapes_kind: Literal["press", "levels"] | None = None  # to which the rubber was fitted
    levels_contradict: bool = False  # no rubber explains their shapes and gas pressures
    # gauge pressure from the shapes alone, and from the sensor file, Pa, where `gauge` is the
    # weighted mean of both
    gauge_candidates: tuple[Quantity, Quantity] | None = None
    rises_pa: tuple[float, ...] = ()  # gas pressure of every shape over that at rest, Pa
    # robust rms of the changes of range from rest, and of the residuals of the rubber model, m
    change_rms_m: float = np.nan
    unexplained_rms_m: float = np.nan
    # of a simulated press, N, as estimated with the identified sensor; None: not computable
    reference_force: Quantity | None = None
    validation: Validation | None = None  # by a known press

    @property
    def complete(self) -> bool:
        """Whether all steps were done."""
        return self.gauge is not None

    @property
    def mesh(self) -> MembraneMesh:
        return self.surfaces.mesh

    @property
    def tension_n_per_m(self) -> float:
        return self.tension.value

    @property
    def tension(self) -> Quantity:
        """γ0, N/m: the uniform tension that balances the gauge pressure over the chosen surface.

        The tension of rubber varies, and is lower near the clamped rim: by a third on another
        solver's dome. As 22 % of that dome is hidden near the rim, γ0 of the extrapolated surface
        is 4 % higher.
        """
        shape, gauge = self.tension_by_shape, self.surfaces.tension_m.value * self.gauge.half_width
        other = float(np.hypot(gauge, HALF_95 * self._tension_by_unequal))
        low, high = (float(np.hypot(end - shape.value, other)) for end in (shape.low, shape.high))
        ends = shape.value - low, shape.value + high
        hidden = 1.0 - self.surfaces.visible_share
        part = f", {100 * hidden:.0f} % of it extrapolated," if hidden > 0.01 else ""
        return Quantity(shape.value, *ends, f"shape{part} and gauge pressure")

    @property
    def tension_by_shape(self) -> Quantity:
        """γ0, N/m, with the error of the shape alone, as at an exact gauge pressure."""
        return self.surfaces.tension_m.times(self.gauge.value)

    @property
    def tension_parts(self) -> dict[str, float]:
        """Standard deviation of γ0 by every source: those of the shape, `gauge_pressure`, N/m."""
        shape = {n: self.gauge.value * part for n, part in self.surfaces.tension_parts_m.items()}
        return shape | {
            "statics": float(np.hypot(shape["statics"], self._tension_by_unequal)),
            "gauge_pressure": self.surfaces.tension_m.value * self.gauge.sigma,
        }

    @property
    def _tension_by_unequal(self) -> float:
        """Standard deviation of the mean tension by unequal tension, N/m.

        0 where λ is not known, which shows whether the membrane can have been a flat sheet.
        """
        changes = [
            field.mean_tension(self.mesh) * self.rubber[name].sigma
            for name, field in self.surfaces.unequal.items()
            if name in self.rubber
        ]
        return self.gauge.value * float(np.linalg.norm(changes))

    @property
    def tension_by_surface(self) -> dict[SurfaceName, float]:
        """γ0 of every surface, N/m."""
        every = self.surfaces.tension_by_surface_m.items()
        return {name: self.gauge.value * tension for name, tension in every}

    @property
    def contradicts_file(self) -> bool:
        """Whether gauge pressures from shapes and file differ by more than their intervals."""
        if self.gauge_candidates is None:
            return False
        shapes, file = self.gauge_candidates
        return abs(shapes.value - file.value) > np.hypot(shapes.half_width, file.half_width)

    @property
    def chamber_contradicts_file(self) -> bool:
        """Whether weather and altitude cannot explain the gas pressure of the open chamber.

        Altitude only lowers the atmospheric pressure.
        """
        if self.vented is None:
            return False
        air, weather_pa = self.given.pneumatics, HALF_95 * WEATHER_SIGMA_PA
        excess_pa = self.vented.value - air.atmospheric_pressure_pa
        return excess_pa > weather_pa or (air.atmosphere_is_local and excess_pa < -weather_pa)

    @property
    def focal_by_rim_px(self) -> dict[str, Quantity]:
        """`fx` and `fy`, pixels, at which the rim has its size before the first identification.

        The rim of an identified file was measured with its focal lengths, so what was found then is
        kept. Empty where the edge of the cloud did not determine them.
        """
        used, calibration = self.samples.camera.intrinsics, self.given.calibration
        if calibration is None:
            return dict(self.surfaces.focal_by_rim_px)
        kept = {"fx": calibration.fx_interval, "fy": calibration.fy_interval}
        same_size = used.size == self.given.camera.size
        return {
            name: Quantity(0.5 * sum(ends), *ends, "size of the rim")
            for name, ends in kept.items()
            if ends is not None and same_size
        }

    @property
    def focal_contradicts_rim(self) -> bool:
        """Whether a focal length is outside its 95 % interval by the size of the rim."""
        used = self.samples.camera.intrinsics
        every = self.focal_by_rim_px.items()
        return any(not of.low <= getattr(used, name) <= of.high for name, of in every)

    @cached_property
    def sensor(self) -> Sensor:
        """The sensor identified.

        Its shape is "spherical_cap" where the sphere was chosen, else "mesh"; `write_sensor` writes
        the mesh file.
        """
        statistics, surfaces = self.samples.statistics, self.surfaces
        pneumatics = self.given.pneumatics.model_copy(update=self._pressures())
        rubber = self.given.membrane.model_dump(include=set(RUBBER_PARAMETERS))
        if self.rubber:
            found = {name: round(each.value, 4) for name, each in self.rubber.items()}
            rubber = dict.fromkeys(rubber) | found
        update = {
            "membrane": _membrane_section(surfaces).model_copy(update=rubber),
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
    def prestretch(self) -> Quantity | None:
        """λ; None: not determined."""
        return self.rubber.get("prestretch")

    @property
    def modelled_range_m(self) -> np.ndarray:
        """Range of the reference surface, (H, W), m; NaN where the ray misses it."""
        return self.samples.statistics.range_m - self.surfaces.residual_m

    def _pressures(self) -> dict[str, float]:
        """Pressures and γ0 for the sensor file."""
        gauge = self.gauge
        values = {
            "gauge_pressure_pa": round(gauge.value, 1),
            "gauge_sigma_pa": max(round(gauge.sigma, 1), _RESOLUTION_PA),
            "tension_n_per_m": round(self.tension_n_per_m, 3),
        }
        if self.samples.gas_pressure_pa is not None:
            absolute = float(np.mean(self.samples.gas_pressure_pa))
            values["atmospheric_pressure_pa"] = round(absolute - gauge.value, 1)
        return values


def open_chamber(source: FrameSource) -> Quantity:
    """Absolute gas pressure of the open chamber, Pa: mean over all frames of a recording.

    Raises InputError: fewer than five frames have a gas pressure, or it is not absolute.
    """
    fewest = 5  # for a mean with a standard error; chosen
    values = np.array([source[k].gas_pressure_pa for k in range(len(source))], float)
    known = values[np.isfinite(values)]
    if len(known) < fewest:
        raise InputError(
            f"{source.name}: only {count_of(len(known), 'frame')} with a gas pressure; record "
            f"{fewest} or more with the chamber open, or leave out the open chamber"
        )
    mean = float(np.mean(known))
    if not ATMOSPHERES[0] <= mean <= ATMOSPHERES[1]:
        raise InputError(
            f"{source.name}: gas pressure {mean:z.0f} Pa with the chamber open is a gauge pressure,"
            " or in another unit; record the absolute pressure in Pa, here and at rest"
        )
    name = f"the open-chamber recording {source.name}"
    return Quantity.normal(mean, error_of_mean(known), name)


def rest_gauge(
    samples: FrameSamples,
    sensor: Sensor,
    vented: Quantity | None = None,  # gas pressure of the open chamber
    # standard deviation of gas pressure differences between recordings, Pa; None: `PRESSURE_ERROR`
    level_sigma_pa: float | None = None,
) -> Quantity:
    """Gauge pressure of the contact-free frames, Pa.

    With the pressure of the open chamber, it is the difference of both recorded gas pressures.
    Otherwise it is the sensor file's if that has a standard deviation, or if no gas pressure was
    recorded. Otherwise it is the recorded pressure minus the file's atmospheric pressure, with the
    standard deviation of weather, and of altitude if that is the standard atmosphere. A gauge
    pressure in the file without a standard deviation has the same, as it may have been found in
    that way.

    If the recorded pressure differs from that of a file with a local atmospheric pressure, weather
    or inflation has changed, so the difference, up to that of weather, is added to the file's
    standard deviation. Altitude lowers the atmospheric pressure, so the recorded pressure minus the
    standard atmosphere is a lower bound of the gauge pressure: a higher one in the file is used.
    """
    name, gas, pneumatics = samples.source_name, samples.gas_pressure_pa, sensor.pneumatics
    in_file, file_sigma = pneumatics.gauge_pressure_pa, pneumatics.gauge_sigma_pa
    if gas is None:
        if vented is not None:
            raise InputError(
                f"{name}: not every contact-free frame has a gas pressure, so {vented.source} does "
                "not determine the gauge pressure; record it in all of them, or leave out the open "
                "chamber"
            )
        source = _FILE if file_sigma else f"{_FILE}, which gives no gauge_sigma_pa"
        return Quantity.normal(in_file, pneumatics.gauge_deviation_pa, source)
    recorded, noise = float(np.mean(gas)), error_of_mean(gas)
    air, source, remedy = vented, "", "give the recording of the open chamber"
    if air is None:
        whose, remedy = f"atmospheric_pressure_pa of {_FILE}", "correct that"
        source = f"the recorded gas pressure minus the atmospheric pressure in {_FILE}"
        weather = pneumatics.atmospheric_sigma_pa
        air = Quantity.normal(pneumatics.atmospheric_pressure_pa, weather, whose)
    gauge, sigma = recorded - air.value, float(np.hypot(air.sigma, noise))
    if vented is not None:  # another recording
        between = PRESSURE_ERROR * gauge if level_sigma_pa is None else level_sigma_pa
        sigma = float(np.hypot(sigma, between))
    if vented is None and file_sigma is not None:
        local = pneumatics.atmosphere_is_local
        change = min(abs(gauge - in_file), WEATHER_SIGMA_PA) if local else 0.0
        gauge, sigma, source = in_file, float(np.hypot(file_sigma, change)), _FILE
    elif vented is not None or pneumatics.atmosphere_is_local:
        if gauge <= 0.0:
            raise InputError(
                f"{name}: gas pressure {recorded:.0f} Pa is not above the atmospheric "
                f"{air.value:.0f} Pa from {air.source}; inflate the bubble, record the absolute "
                f"pressure in Pa, or {remedy}"
            )
    elif gauge >= in_file:
        source = (
            "the recorded gas pressure minus the standard atmosphere, as "
            f"{_FILE} has no local atmospheric pressure"
        )
    else:
        sigma = float(np.hypot(sigma, in_file - gauge))
        gauge, source = in_file, f"{_FILE}, which has no local atmospheric pressure"
    if vented is None and not ATMOSPHERES[0] <= recorded - gauge <= ATMOSPHERES[1]:
        raise InputError(
            f"{name}: gas pressure {recorded:.0f} Pa minus the sensor file's gauge pressure "
            f"{gauge:.0f} Pa is not a plausible atmospheric pressure; record the absolute pressure "
            "in Pa, or correct gauge_pressure_pa in the sensor file"
        )
    return Quantity.normal(gauge, max(sigma, _RESOLUTION_PA), source or air.source)


def _membrane_section(surfaces: Surfaces) -> Membrane:
    section = Membrane(shape="mesh", mesh_file="membrane.ply", nodes=len(surfaces.mesh.nodes))
    if surfaces.chosen == "sphere":
        cap = surfaces.sphere.cap_above_rim
        section = Membrane(
            shape="spherical_cap",
            rim_radius_m=round(cap.rim_semi_axes_m[0], 7),
            height_m=round(cap.height_m, 7),
            nodes=section.nodes,
        )
    return section


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
