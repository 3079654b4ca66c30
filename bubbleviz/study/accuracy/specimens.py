"""Membranes whose truth is known, and what an estimator is told of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from bubbleviz.calibration.identification import identify, with_rubber
from bubbleviz.calibration.rest.rest_frames import collect
from bubbleviz.camera.depth_camera import DepthCamera
from bubbleviz.sensor import Camera, Membrane, Pneumatics, Sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation.depth_noise import DepthNoise
from bubbleviz.simulation.synthetic_source import Model
from bubbleviz.study.inflated_rubber import InflatedRubber
from bubbleviz.study.pose.rubber_truth import RubberPresses, rubber_sensor
from bubbleviz.study.truth_bank import LinearPresses, Presses

GAUGE_PA = 4_000.0
RIM_M, OVAL_M = (0.045, 0.045), (0.0557, 0.0396)
"""Rims of the small membranes; the oval is that of the Punyo."""
LEVELS = (0.85, 1.15)
"""Shares of the gauge pressure at rest at which sensors are recorded to be identified."""
_NODES, _FRAMES = 1_000, 30


@dataclass(frozen=True)
class Specimen:
    """A membrane under test.

    Attributes
    ----------
    name, membrane : str
        Of the membrane alone, where several are told different things of it.
    presses : Presses
        Its truth.
    told : callable
        What the estimator is told of it, where depth images have some noise.
    truth : Told
        The true numbers.
    identified : bool
        What is told was found from inflation levels, with no material value given.
    """

    name: str
    membrane: str
    presses: Presses
    told: Callable[[DepthNoise], SensorModel]
    truth: Told
    identified: bool = False


@dataclass(frozen=True)
class Told:
    """Material and pressure of a membrane; λ is None where it is not known."""

    gauge_pressure_pa: float
    tension_n_per_m: float
    prestretch: float | None

    @classmethod
    def of(cls, model: SensorModel) -> Told:
        """Those of a sensor."""
        sensor = model.sensor
        gauge = sensor.pneumatics.gauge_pressure_pa
        return cls(gauge, model.tension_n_per_m, sensor.membrane.prestretch)


def specimen(name: str, sensor: Sensor, model: Model, nodes: int, seed: int) -> Specimen:
    """One of `SPECIMENS`.

    Parameters
    ----------
    name : str
    sensor : Sensor
        What `sensor` is, of rubber with the usual λ where its file gives none.
    model : {"rubber", "linear"}
        Of the truth of `sensor` and `dome`; the others are always of rubber.
    nodes : int
        Of the mesh that makes the truth of these, before it is refined.
    seed : int
        Of the frames that a membrane is identified from.
    """
    kind, _, stretch = name.partition(" λ ")
    if kind in ("sensor", "dome"):
        own = _dome(float(stretch)) if kind == "dome" else sensor
        known = SensorModel.of(own if model == "linear" else rubber_sensor(own))
        linear = model == "linear"
        presses = LinearPresses(known, nodes) if linear else RubberPresses.of(known, nodes)
        return Specimen(name, name, presses, partial(_with_noise, known), Told.of(known))
    shape, _, how = kind.partition(", ")
    rubber = _RUBBER[shape](float(stretch))
    camera = DepthCamera.of(rubber.sensor().camera)
    presses = RubberPresses(camera, rubber.rest, rubber.rubber, rubber.pneumatics)
    truth = Told(rubber.gauge_pressure_pa, rubber.tension_n_per_m, rubber.prestretch)
    if how == "identified":
        told = partial(_identified, rubber, seed)
        return Specimen(name, f"{shape} λ {stretch}", presses, told, truth, True)
    return Specimen(name, name, presses, partial(_with_noise, _known(rubber)), truth)


def _round_sheet(stretch: float) -> InflatedRubber:
    return InflatedRubber.round_sheet(RIM_M[0], _stiffness(stretch), stretch, GAUGE_PA)


def _oval_sheet(stretch: float) -> InflatedRubber:
    return InflatedRubber.oval_sheet(OVAL_M, _stiffness(stretch), stretch, GAUGE_PA)


def _moulded_dome(stretch: float) -> InflatedRubber:
    return InflatedRubber.moulded_dome(RIM_M, 0.020, _stiffness(stretch), stretch, GAUGE_PA)


_RUBBER = {
    "round sheet": _round_sheet,
    "oval sheet": _oval_sheet,
    "moulded dome": _moulded_dome,
}
SPECIMENS = (
    "sensor",
    "dome λ 1.05",
    "dome λ 1.2",
    "dome λ 1.5",
    "round sheet λ 1.15",
    "oval sheet λ 1.15",
    "round sheet, identified λ 1.15",
    "oval sheet, identified λ 1.15",
    "oval sheet, identified λ 1.4",
    "moulded dome, identified λ 1.2",
)
"""Sheets were flat and stretched by λ before gas bulged them; the tension of domes at rest is the
same everywhere, that of moulded ones what comes of stretching and inflating them."""


def _stiffness(stretch: float) -> float:
    """μh that bulges a sheet by some two fifths of its rim's radius, N/m: γ0 of some 125 N/m."""
    return 85.0 / (1.0 - stretch**-6) + 25.0


def _dome(prestretch: float) -> Sensor:
    """Spherical dome on a rim of 45 mm radius; γ0 by Young–Laplace."""
    own = Camera(
        width=160, height=120, fx=88.0, fy=88.0, cx=79.5, cy=59.5, position_m=(0.0, 0.0, -0.063)
    )
    membrane = Membrane(rim_radius_m=RIM_M[0], height_m=0.029, nodes=_NODES, prestretch=prestretch)
    gas = Pneumatics(gauge_pressure_pa=GAUGE_PA, chamber_volume_m3=3e-4)
    return Sensor(name="dome", membrane=membrane, pneumatics=gas, camera=own)


def _known(rubber: InflatedRubber) -> SensorModel:
    """The sensor with its true numbers, on another mesh of its true surface."""
    drawn = rubber.sensor()
    membrane = drawn.membrane.model_copy(update={"prestretch": rubber.prestretch})
    known = {"membrane": membrane, "pneumatics": rubber.pneumatics}
    sensor = drawn.model_copy(update=known)
    return SensorModel(sensor, DepthCamera.of(sensor.camera), rubber.resting(_NODES))


def _with_noise(model: SensorModel, noise: DepthNoise) -> SensorModel:
    """The sensor with the noise of its camera."""
    distance = float(np.median(np.linalg.norm(model.mesh.nodes - model.camera.center, axis=1)))
    relative = max(float(np.hypot(noise.relative, noise.absolute_m / distance)), 1e-5)
    camera = model.sensor.camera.model_copy(update={"noise_relative": relative})
    sensor = model.sensor.model_copy(update={"camera": camera})
    return SensorModel(sensor, model.camera, model.mesh, model.pixels)


def _identified(rubber: InflatedRubber, seed: int, noise: DepthNoise) -> SensorModel:
    """The sensor as its inflation levels tell, from a drawing without material."""
    levels = (1.0, *LEVELS)
    rest, *others = (
        rubber.recording(level, seed + k, noise, _FRAMES) for k, level in enumerate(levels)
    )
    drawn = rubber.sensor()
    found = identify(rest, drawn, range(_FRAMES), nodes=_NODES)
    return with_rubber(found, [collect(level, drawn, range(_FRAMES)) for level in others]).model
