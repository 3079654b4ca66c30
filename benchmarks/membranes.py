"""Error of force and patch on bulged sheets and moulded domes, known and identified.

The study of accuracy on membranes with independent equations for the truth, and with sensors
identified from inflation levels without any material value given.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

import bubbleviz as bv
from bubbleviz.calibration import collect, with_rubber
from bubbleviz.camera import DepthCamera
from bubbleviz.sensor import Sensor, changed
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation import DepthNoise, InflatedRubber, RubberPresses, with_noise
from bubbleviz.study import accuracy
from tests.oracles.round_sheet import resting, round_sheet, rubber_on

GAUGE_PA = 4_000.0
RIM_M, OVAL_M = (0.045, 0.045), (0.0557, 0.0396)
"""Rims of the small membranes; the oval is that of the Punyo."""
LEVELS = (0.85, 1.15)
"""Inflation levels for identification, relative to the gauge pressure at rest."""
_NODES, _FRAMES = 1_000, 30


GRID = accuracy.Grid(
    specimens=(
        "round sheet λ 1.15",
        "oval sheet λ 1.15",
        "round sheet, identified λ 1.15",
        "oval sheet, identified λ 1.15",
        "oval sheet, identified λ 1.4",
        "moulded dome, identified λ 1.2",
    )
)
"""Sheets were flat and stretched by λ before inflation; the tension of moulded domes at rest
follows from stretching and inflating them."""


def quick_grid() -> accuracy.Grid:
    """One press of one identified membrane."""
    few = replace(accuracy.quick_grid(), specimens=GRID.specimens[2:3])
    return replace(few, setups=few.setups[:3])


def specimen(name: str, _sensor: Sensor, grid: accuracy.Grid) -> accuracy.Specimen:
    """A specimen of the grid."""
    kind, _, stretch = name.partition(" λ ")
    shape, _, how = kind.partition(", ")
    rubber = _RUBBER[shape](float(stretch))
    camera = DepthCamera.of(rubber.sensor().camera)
    presses = RubberPresses(camera, rubber.rest, rubber.pneumatics, partial(rubber_on, rubber))
    if how == "identified":
        told = cache(partial(_identified, rubber, grid.seed))
        return accuracy.Specimen(name, presses, told, "identified")
    return accuracy.Specimen(name, presses, partial(with_noise, _known(rubber)))


def _stiffness(stretch: float) -> float:
    """μh, N/m, for which a sheet bulges by about 40 % of its rim's radius: γ0 of some 125 N/m."""
    return 85.0 / (1.0 - stretch**-6) + 25.0


_RUBBER: dict[str, Callable[[float], InflatedRubber]] = {
    "round sheet": lambda λ: round_sheet(RIM_M[0], _stiffness(λ), λ, GAUGE_PA),
    "oval sheet": lambda λ: InflatedRubber.oval_sheet(OVAL_M, _stiffness(λ), λ, GAUGE_PA),
    "moulded dome": lambda λ: InflatedRubber.moulded_dome(RIM_M, 0.020, _stiffness(λ), λ, GAUGE_PA),
}


def _known(rubber: InflatedRubber) -> SensorModel:
    """The sensor with its true numbers, on another mesh of its true surface."""
    drawn = rubber.sensor()
    sensor = changed(drawn, membrane={"prestretch": rubber.prestretch})
    sensor = sensor.model_copy(update={"pneumatics": rubber.pneumatics})
    return SensorModel(sensor, DepthCamera.of(sensor.camera), resting(rubber, _NODES))


def _identified(rubber: InflatedRubber, seed: int, noise: DepthNoise) -> SensorModel:
    """The sensor identified from its inflation levels, with known geometry only."""
    levels = (1.0, *LEVELS)
    rest, *others = (
        rubber.recording(level, seed + k, noise, _FRAMES) for k, level in enumerate(levels)
    )
    drawn = rubber.sensor()
    found = bv.identify(
        rest, drawn, contact_free=range(_FRAMES), nodes=_NODES, held_press=False
    ).found
    return with_rubber(found, [collect(level, drawn, range(_FRAMES)) for level in others]).model
