"""Known rubber identified from inflation levels with seed after seed of noise."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bubbleviz.calibration.identification import identify, with_rubber
from bubbleviz.calibration.rest.rest_frames import collect
from bubbleviz.calibration.rubber.vented import Vented
from bubbleviz.calibration.tension.tension_estimate import Quantity
from bubbleviz.errors import InputError
from bubbleviz.files.tables import write_json
from bubbleviz.simulation.inflated_sensor import InflatedSensor
from bubbleviz.study.inflated_rubber import ATMOSPHERE_PA, InflatedRubber

GAUGE_PA = 2_500.0
_OVAL_M, _ROUND_M = (0.0557, 0.0396), (0.045, 0.045)  # semi-axes of the rim, the Punyo's first
_WEATHER_PA = 300.0
"""σ of the atmospheric pressure about the one a sensor file has right for the place."""
_VENTED_FRAMES, _VENTED_NOISE_PA = 60, 5.0

RUBBERS: dict[str, Callable[[], InflatedRubber]] = {
    "round sheet": lambda: InflatedRubber.round_sheet(_ROUND_M[0], 110.0, 1.15, GAUGE_PA),
    "oval sheet": lambda: InflatedRubber.oval_sheet(_OVAL_M, 140.0, 1.05, GAUGE_PA),
    "round dome": lambda: InflatedRubber.moulded_dome(_ROUND_M, 0.020, 150.0, 1.1, GAUGE_PA),
    "oval dome": lambda: InflatedRubber.moulded_dome(_OVAL_M, 0.020, 150.0, 1.1, GAUGE_PA),
}
"""Sheets that were flat, and domes moulded as such; λ of 1.11 to 1.24 at γ0."""

QUANTITIES = ("tension_n_per_m", "prestretch", "gauge_pressure_pa")
"""γ0, λ and G."""


@dataclass(frozen=True)
class CoverageGrid:
    """What an identification study runs over.

    Attributes
    ----------
    rubbers : tuple of str
        Of `RUBBERS`.
    seeds : int
        Of the noise, for every rubber.
    levels : tuple of float
        Inflation levels beside the rest, over the gauge pressure at rest.
    frames : int
        Of every level: two seconds, unless told otherwise.
    width : int
        Of the image, pixels: a pico flexx's, unless told otherwise.
    nodes : int
        Of the mesh that is identified: those of `identify`, unless told otherwise.
    """

    rubbers: tuple[str, ...] = tuple(RUBBERS)
    seeds: int = 50
    levels: tuple[float, ...] = (0.85, 1.15)
    frames: int = 60
    width: int = 224
    nodes: int = 1000


@dataclass(frozen=True)
class CoverageRow:
    """One number of one identification.

    Attributes
    ----------
    rubber : str
    seed : int
    known : {"levels", "vented"}
        What was recorded: levels alone, or the open chamber too.
    quantity : {"tension_n_per_m", "prestretch", "gauge_pressure_pa"}
    truth : float
    value, low, high : float
        With its 95 % interval; NaN where it is not determined, or only as well as the sensor file's
        atmospheric pressure.
    """

    rubber: str
    seed: int
    known: str
    quantity: str
    truth: float
    value: float = np.nan
    low: float = np.nan
    high: float = np.nan

    @property
    def determined(self) -> bool:
        """Whether there is a number."""
        return bool(np.isfinite(self.value))

    @property
    def covered(self) -> bool:
        """Whether the interval holds the truth."""
        return self.low <= self.truth <= self.high

    @property
    def error(self) -> float:
        """Of γ0 and gauge pressure relative to the truth; of λ itself."""
        off = self.value - self.truth
        return off if self.quantity == "prestretch" else off / self.truth


def quick_coverage() -> CoverageGrid:
    """One rubber, few seeds, short recordings of small images: less than a minute."""
    return CoverageGrid(("round sheet",), seeds=3, frames=20, width=120, nodes=500)


def run_coverage(
    grid: CoverageGrid, parts: Path | None = None, tick: Callable[[str], None] = lambda _: None
) -> list[CoverageRow]:
    """Identify every rubber with every seed.

    Parameters
    ----------
    grid : CoverageGrid
    parts : Path, optional
        Folder that keeps the rows of every identification, so that a stopped study goes on there.
    tick : callable
        Called with the name of the rubber after every identification.

    Raises
    ------
    InputError
        The parts are of another grid.
    """
    rows: list[CoverageRow] = []
    for name in grid.rubbers:
        rubber = RUBBERS[name]()
        for seed in range(grid.seeds):
            rows += _kept(parts, grid, rubber, name, seed)
            tick(name)
    return rows


def _kept(
    parts: Path | None, grid: CoverageGrid, rubber: InflatedRubber, name: str, seed: int
) -> list[CoverageRow]:
    """Rows from an earlier run with the same settings, or made now and kept."""
    if parts is None:
        return list(_identified(grid, rubber, name, seed))
    settings = asdict(replace(grid, rubbers=(name,), seeds=1))
    own = json.loads(json.dumps(settings))
    path = parts / f"{name.replace(' ', '_')}_{seed}.json"
    if path.exists():
        kept = json.loads(path.read_text(encoding="utf-8"))
        if kept["grid"] != own:
            raise InputError(f"{path}: is of another grid; choose another folder or delete it")
        return [_row_of(record) for record in kept["rows"]]
    rows = list(_identified(grid, rubber, name, seed))
    write_json(path, {"grid": own, "rows": [asdict(row) for row in rows]})
    return rows


def _row_of(record: dict[str, Any]) -> CoverageRow:
    numbers: dict[str, Any] = {k: np.nan if v is None else v for k, v in record.items()}
    return CoverageRow(**numbers)


def _identified(
    grid: CoverageGrid, rubber: InflatedRubber, name: str, seed: int
) -> Iterator[CoverageRow]:
    """Identify from one set of recordings: by levels alone, and with the chamber opened."""
    rng = np.random.default_rng([seed, 0])
    weather = ATMOSPHERE_PA + _WEATHER_PA * rng.standard_normal()
    sigma = _VENTED_NOISE_PA / np.sqrt(_VENTED_FRAMES)
    vented = Vented("vented", ATMOSPHERE_PA + sigma * rng.standard_normal(), sigma)
    sensor = replace(vented, pressure_pa=weather).set_in(rubber.sensor(grid.width))
    rest, *others = _recorded(grid, rubber, seed)
    levels = [collect(source, sensor, range(grid.frames)) for source in others]
    truths = rubber.tension_n_per_m, rubber.prestretch, rubber.gauge_pressure_pa
    for known, opened in (("levels", None), ("vented", vented)):
        given = opened.set_in(sensor) if opened else sensor
        found = identify(rest, given, range(grid.frames), nodes=grid.nodes)
        found = with_rubber(found, levels, opened)
        numbers: list[Quantity | None] = [None] * len(QUANTITIES)
        if found.rubber is not None and found.rubber.gauge is not None:
            numbers = [found.tension.tension, found.rubber.prestretch, found.rubber.gauge]
        for quantity, truth, number in zip(QUANTITIES, truths, numbers, strict=True):
            interval = (number.value, number.low, number.high) if number else ()
            yield CoverageRow(name, seed, known, quantity, truth, *interval)


def _recorded(grid: CoverageGrid, rubber: InflatedRubber, seed: int) -> list[InflatedSensor]:
    """The rest and every level, each with noise of its own."""
    shares = (1.0, *grid.levels)
    return [
        rubber.recording(share, len(shares) * seed + k, frames=grid.frames, width=grid.width)
        for k, share in enumerate(shares)
    ]
