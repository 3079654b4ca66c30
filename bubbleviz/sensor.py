"""The sensor file: validated TOML."""

from __future__ import annotations

import math
import shutil
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tomli_w
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    field_validator,
    model_validator,
)

from bubbleviz.errors import InputError, check_number, check_type, given_path
from bubbleviz.files import (
    MAX_COLOUR_DELAY_S,
    checked,
    is_unit,
    named_file,
    presets_folder,
    read_toml,
    transform,
    whole_file,
)
from bubbleviz.wording import size_text

Metres = Annotated[float, Field(gt=1e-4, lt=1.0, allow_inf_nan=False)]
"""A length of the sensor: values outside 0.1 mm … 1 m are in a wrong unit."""
Pixels = Annotated[float, Field(ge=-1e5, le=1e5)]
"""Up to ten times the largest image."""
MIN_NOISE = 1e-6
"""Smallest relative noise: 0.1 µm at 100 mm, a thousandth of what depth cameras resolve."""

LARGEST_GRADIENT = 0.4  # of the stiffness: with all three at once, it is positive everywhere
Gradient = Annotated[float, Field(ge=-LARGEST_GRADIENT, le=LARGEST_GRADIENT)]

Vector3 = tuple[float, float, float]


def _of_unit_length(quaternion: tuple[float, ...]) -> tuple[float, ...]:
    if not is_unit(quaternion):
        raise ValueError("it is not of unit length; divide it by its length")
    return quaternion


UnitQuaternion = Annotated[tuple[float, float, float, float], AfterValidator(_of_unit_length)]
ColourDelay = Annotated[float, Field(ge=-MAX_COLOUR_DELAY_S, le=MAX_COLOUR_DELAY_S)]
"""Stamp of a colour image minus that of the depth image of the same scene, s; negative if colour
leads depth, as with depth cameras that filter in time."""

WEATHER_SIGMA_PA = 2e3 / 1.96
"""σ of the atmospheric pressure at one place, Pa: 95 % of the weather is within ±2 kPa."""

STANDARD_ATMOSPHERE_PA, ALTITUDE_SIGMA_PA = 101_325.0, 5e3
"""Atmospheric pressure at sea level, and the rms of its reduction by altitude where people live.

With an exponential distribution of altitudes it is 4.8 kPa if half of the population lives above
194 m, 6 kPa if a quarter lives above 500 m (Cohen and Small 1998 counted both)."""


ATMOSPHERES = 30e3, 120e3
"""Plausible atmospheric pressures, Pa: from the highest mountain to a pressurised cabin."""


class Section(BaseModel):
    """Table of a TOML file; unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Membrane(Section):
    """Reference surface S0 of the membrane, in the bubble frame B."""

    shape: Literal["spherical_cap", "ellipsoidal_cap", "mesh"] = "spherical_cap"
    rim_radius_m: Metres | None = None
    rim_semi_axes_m: tuple[Metres, Metres] | None = None
    height_m: Metres | None = None
    mesh_file: str | None = None
    prestretch: float | None = Field(default=None, gt=1.0, le=3.2)
    """λ of the rubber at rest; absent: constant tension, from which 3.2 differs by λ⁻⁶ = 0.001;
    values in per cent are out of range."""
    sheet_share: float | None = Field(default=None, ge=0.0, le=1.0)
    """Share of an initially flat sheet in the stress that shape and pressure leave open, as on oval
    rims; absent: 0, the stress of a film."""
    unequal_tension_x: float | None = Field(default=None, gt=-1.0, lt=1.0)
    """(Tx − Ty) / (Tx + Ty) by unequal stretch along x and y before inflation; absent: 0."""
    unequal_tension_xy: float | None = Field(default=None, gt=-1.0, lt=1.0)
    """2 Txy / (Tx + Ty), the same between x and y."""
    stiffness_gradient_x: Gradient | None = None
    """Relative change of the rubber's stiffness from the middle to the rim along x; absent: 0."""
    stiffness_gradient_y: Gradient | None = None
    stiffness_gradient_r: Gradient | None = None
    """Stiffness at the rim over the mean, minus 1, all around; in the middle as much below; absent:
    0."""
    nodes: int = Field(default=800, ge=30, le=100_000)

    @model_validator(mode="after")
    def _shape_has_its_numbers(self) -> Membrane:
        needed = {
            "spherical_cap": ("rim_radius_m", "height_m"),
            "ellipsoidal_cap": ("rim_semi_axes_m", "height_m"),
            "mesh": ("mesh_file",),
        }[self.shape]
        for name in needed:
            if getattr(self, name) is None:
                raise ValueError(f'shape = "{self.shape}" needs {name}; add it')
        return self


class Pneumatics(Section):
    """The gas behind the membrane and the tension in it."""

    gauge_pressure_pa: float = Field(ge=50.0, le=100e3)
    """At least 50 Pa (5 mm of water), at most an atmosphere, where latex bursts."""
    gauge_sigma_pa: float | None = Field(default=None, gt=0.0, le=100e3)
    """Standard deviation of the gauge pressure; absent: from the calibration's interval, if any."""
    atmospheric_pressure_pa: float = Field(
        default=STANDARD_ATMOSPHERE_PA, ge=ATMOSPHERES[0], le=ATMOSPHERES[1]
    )
    chamber_volume_m3: float = Field(ge=1e-7, le=10.0)
    """From 0.1 ml to 10 m³."""
    tension_n_per_m: float | None = Field(default=None, ge=1e-3, le=1e6)
    """Within a factor of a hundred of P R/2 for the allowed gauge pressures and sizes."""
    volume_model: Literal["exact", "paper"] = "exact"

    @property
    def reference_pressure_pa(self) -> float:
        """Absolute pressure P0 in the reference configuration, Pa."""
        return self.atmospheric_pressure_pa + self.gauge_pressure_pa

    @property
    def atmosphere_is_local(self) -> bool:
        """Whether the atmospheric pressure was given for a place, and is not the standard one."""
        return self.atmospheric_pressure_pa != STANDARD_ATMOSPHERE_PA

    @property
    def atmospheric_sigma_pa(self) -> float:
        """Standard deviation of the atmospheric pressure of another day, Pa.

        By the weather, and by the altitude if the pressure is the standard one.
        """
        if self.atmosphere_is_local:
            return WEATHER_SIGMA_PA
        return math.hypot(WEATHER_SIGMA_PA, ALTITUDE_SIGMA_PA)

    @property
    def gauge_deviation_pa(self) -> float:
        """Standard deviation of the gauge pressure where `identify` weighs it against others.

        If it is not given, the pressure may be the absolute one minus an assumed atmosphere.
        """
        return self.gauge_sigma_pa or self.atmospheric_sigma_pa


class Lens(Section):
    """Intrinsics of a camera, pixels."""

    width: int = Field(ge=1, le=10_000)
    height: int = Field(ge=1, le=10_000)
    fx: float = Field(ge=1.0, le=1e5)
    fy: float = Field(ge=1.0, le=1e5)
    cx: Pixels
    cy: Pixels
    distortion_model: Literal["none", "plumb_bob", "inverse_brown_conrady"] = "none"
    distortion: tuple[Annotated[float, Field(ge=-1e4, le=1e4)], ...] = Field(
        default=(), max_length=14
    )

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the images, pixels."""
        return self.width, self.height


class Camera(Lens):
    """Depth camera, with its pose T_B_C in the bubble frame."""

    position_m: Vector3
    quaternion_xyzw: UnitQuaternion = (0.0, 0.0, 0.0, 1.0)
    noise_relative: float = Field(default=0.01, ge=MIN_NOISE, lt=1.0)
    colour_delay_s: ColourDelay = 0.0

    @field_validator("position_m")
    @classmethod
    def _is_plausible(cls, position_m: Vector3) -> Vector3:
        if any(abs(x) > 2.0 for x in position_m):
            raise ValueError("it is more than 2 m from the bubble; give metres, not millimetres")
        return position_m

    @property
    def T_B_C(self) -> np.ndarray:
        """Pose of the camera in the bubble frame, 4×4."""
        return transform(self.position_m, self.quaternion_xyzw)


class Calibration(Section):
    """Calibration of this sensor from contact-free frames."""

    pixels_file: str
    """NPZ with `mask` (H×W bool, pixels to use), `bias_m` and `noise_m` (H×W, of range)."""
    recording: str | None = None  # name of the recording of these frames
    recording_sha256: str | None = None
    """Of its file, or of its concatenated files in the order of their names."""
    report: str | None = None  # path of the report, as given by the user
    date: str | None = None  # ISO 8601, UTC
    tension_interval_n_per_m: tuple[float, float] | None = None  # 95 % interval of γ0
    gauge_interval_pa: tuple[float, float] | None = None
    """95 % interval of the gauge pressure."""
    gauge_from: str | None = None  # source of the gauge pressure
    prestretch_interval: tuple[float, float] | None = None
    """95 % interval of λ, if measured."""
    prestretch_from: str | None = None  # source of λ
    # 95 % intervals
    sheet_share_interval: tuple[float, float] | None = None
    unequal_tension_x_interval: tuple[float, float] | None = None
    unequal_tension_xy_interval: tuple[float, float] | None = None
    stiffness_gradient_x_interval: tuple[float, float] | None = None
    stiffness_gradient_y_interval: tuple[float, float] | None = None
    stiffness_gradient_r_interval: tuple[float, float] | None = None
    fx_interval: tuple[float, float] | None = None
    """95 % interval of the focal length, pixels, by the size of the rim, where the image shows
    it."""
    fy_interval: tuple[float, float] | None = None
    edited: tuple[str, ...] | None = None
    """Keys of values changed by hand since, such as `pneumatics.gauge_pressure_pa`."""


class Sensor(Section):
    """One Soft-bubble sensor as described by its file.

    Relative file names refer to `folder`; `file` is the file's name there, empty for a sensor
    without file. Neither is written to the file.
    """

    schema_version: Literal[1] = 1
    name: str = Field(min_length=1)
    membrane: Membrane
    pneumatics: Pneumatics
    camera: Camera
    calibration: Calibration | None = None
    folder: Path = Field(default=Path(), exclude=True)
    file: str = Field(default="", exclude=True)

    def resolve(self, file: str) -> Path:
        """Path of a file named in the sensor file."""
        return self.folder / file

    @property
    def files(self) -> list[Path]:
        """Paths of the sensor file, and of the mesh and the pixels named in it."""
        pixels = self.calibration.pixels_file if self.calibration else None
        return [self.resolve(name) for name in (self.file, self.membrane.mesh_file, pixels) if name]


def load_sensor(name: str | Path | Sensor) -> Sensor:
    """Sensor from a TOML file or, if there is no such file, the preset of that name.

    A `Sensor` is returned unchanged.

    Raises
    ------
    InputError
        The file is missing, is not TOML, or violates the schema.
    """
    if isinstance(name, Sensor):
        return name
    path = named_file(name, presets_folder("sensors"), "sensor file")
    data = read_toml(path)
    if "membrane" not in data:
        raise InputError(f"{path}: not a sensor file (no [membrane]); choose one")
    for key in ("folder", "file"):
        if key in data:
            raise InputError(f"{path}: {key}: unknown key; remove it")
    return checked(Sensor, {**data, "folder": path.parent, "file": path.name}, path, "sensor")


MEASURED = {
    "pneumatics.tension_n_per_m": ("tension_interval_n_per_m",),
    "pneumatics.gauge_pressure_pa": ("gauge_interval_pa", "gauge_from"),
    "membrane.prestretch": ("prestretch_interval", "prestretch_from"),
    "membrane.sheet_share": ("sheet_share_interval",),
    "membrane.unequal_tension_x": ("unequal_tension_x_interval",),
    "membrane.unequal_tension_xy": ("unequal_tension_xy_interval",),
    "membrane.stiffness_gradient_x": ("stiffness_gradient_x_interval",),
    "membrane.stiffness_gradient_y": ("stiffness_gradient_y_interval",),
    "membrane.stiffness_gradient_r": ("stiffness_gradient_r_interval",),
    "camera.fx": ("fx_interval",),
    "camera.fy": ("fy_interval",),
}
"""Keys of `Calibration` that describe a value, by the key of the value."""


def contradiction(sensor: Sensor) -> str:
    """Sentence on a value outside the interval of the file's own calibration; else empty."""
    for key, (name, *_) in MEASURED.items():
        section, value_name = key.split(".")
        value = getattr(getattr(sensor, section), value_name)
        interval = None if sensor.calibration is None else getattr(sensor.calibration, name)
        if value is None or interval is None:
            continue
        if not interval[0] <= value <= interval[1]:
            remedy = "correct the value or"
            if section == "camera":
                remedy = "correct the camera info, or the rim in the initial file, and"
            return (
                f"{value_name} = {value:g} in the sensor file is outside the interval of its "
                f"calibration, {interval[0]:g} to {interval[1]:g}; {remedy} identify the sensor "
                "again"
            )
    return ""


def edited(
    sensor: Sensor,
    # by key, such as `pneumatics.gauge_pressure_pa`; None removes a key
    values: Mapping[str, Any],
) -> Sensor:
    """Sensor with changed values; the calibration lists them as edited, without intervals.

    Raises InputError: a value violates the schema.
    """
    data = sensor.model_dump(exclude_none=True)
    for key, value in values.items():
        *section, name = key.split(".")
        table = data[section[0]] if section else data
        if value == table.get(name):
            continue
        table[name] = value
        if key == "pneumatics.gauge_pressure_pa":
            table.pop("gauge_sigma_pa", None)  # belongs to the old value
        calibration = data.get("calibration")
        if section and calibration is not None:
            calibration["edited"] = sorted({key, *calibration.get("edited", ())})
            for outdated in MEASURED.get(key, ()):
                calibration.pop(outdated, None)
    path = Path(sensor.file or sensor.name)
    return checked(Sensor, {**data, "folder": sensor.folder, "file": sensor.file}, path, "sensor")


def changed(sensor: Sensor, **sections: dict[str, Any]) -> Sensor:
    """Sensor with other values in its sections, unchecked: `changed(s, membrane={"nodes": 9})`."""
    values = {name: getattr(sensor, name).model_copy(update=new) for name, new in sections.items()}
    return sensor.model_copy(update=values)


def with_colour_delay(sensor: Sensor, colour_delay_s: float | None) -> Sensor:
    """Sensor with another colour delay, s, and without file name; unchanged for None.

    Raises InputError: it is not within ±0.5 s.
    """
    if colour_delay_s in (None, sensor.camera.colour_delay_s):
        return sensor
    check_number("--colour-delay", colour_delay_s, -MAX_COLOUR_DELAY_S, MAX_COLOUR_DELAY_S)
    other = changed(sensor, camera={"colour_delay_s": colour_delay_s})
    return other.model_copy(update={"file": ""})


def save_sensor(sensor: Sensor, path: str | Path, *, overwrite: bool = False) -> None:
    """Write a sensor file, and copies of its mesh and pixels with the same name.

    Parameters
    ----------
    sensor : Sensor
    path : path
        `X.toml`.
    overwrite : bool
        Replace existing files.

    Raises
    ------
    InputError
        The name does not end in .toml, or a file exists or cannot be written; then nothing is
        written.
    """
    check_type("sensor", sensor, Sensor)
    path = given_path("path", path)
    membrane, calibration = sensor.membrane, sensor.calibration
    with ExitStack() as files:
        # Files appear in reverse order: the sensor file last, after the files that it names.
        toml = files.enter_context(whole_file(path, ".toml", overwrite=overwrite))

        def copied(name: str) -> str:
            original, copy = sensor.resolve(name), path.with_suffix(Path(name).suffix)
            if not original.is_file():
                raise InputError(
                    f"{original}: named in the file of sensor {sensor.name}, but missing, so it "
                    "cannot be copied; restore it, or identify the sensor again"
                )
            shutil.copyfile(original, files.enter_context(whole_file(copy, overwrite=overwrite)))
            return copy.name

        if membrane.mesh_file is not None:
            sensor = changed(sensor, membrane={"mesh_file": copied(membrane.mesh_file)})
        if calibration is not None:
            sensor = changed(sensor, calibration={"pixels_file": copied(calibration.pixels_file)})
        toml.write_text(sensor_to_toml(sensor), encoding="utf-8")


def sensor_to_toml(sensor: Sensor) -> str:
    """TOML text of the sensor file."""
    data: dict[str, Any] = sensor.model_dump(mode="json", exclude_none=True)
    return tomli_w.dumps(data)


def size_refusal(
    found: str, size: tuple[int, int], sensor_name: str | Path, own: tuple[int, int]
) -> InputError:
    """The error to raise about something found to be for another image size than the camera's."""
    return InputError(
        f"{found} {size_text(size)} pixels but the camera of sensor {sensor_name} has "
        f"{size_text(own)}; choose the sensor file of this camera"
    )
