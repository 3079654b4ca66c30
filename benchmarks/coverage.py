"""Coverage of the intervals of γ0, λ and gauge pressure, over many noise seeds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np

import bubbleviz as bv
from bubbleviz.calibration import Quantity, collect, rest_gauge, with_rubber
from bubbleviz.recordings import HeldFrames
from bubbleviz.sensor import edited
from bubbleviz.simulation import ATMOSPHERE_PA, InflatedRubber
from bubbleviz.study.harness import (
    Averages,
    Case,
    Column,
    Record,
    Report,
    Study,
    Table,
    Target,
    at_least,
    at_most,
    summaries,
)
from tests.oracles.round_sheet import round_sheet

GAUGE_PA = 2_500.0
_OVAL_M, _ROUND_M = (0.0557, 0.0396), (0.045, 0.045)  # semi-axes of the rim, the Punyo's first
_WEATHER_PA = 300.0
"""σ of the atmospheric pressure about the correct local mean in the sensor file."""
_VENTED_FRAMES, _VENTED_NOISE_PA = 60, 5.0

RUBBERS: dict[str, Callable[[], InflatedRubber]] = {
    "round sheet": lambda: round_sheet(_ROUND_M[0], 110.0, 1.15, GAUGE_PA),
    "oval sheet": lambda: InflatedRubber.oval_sheet(_OVAL_M, 140.0, 1.05, GAUGE_PA),
    "round dome": lambda: InflatedRubber.moulded_dome(_ROUND_M, 0.020, 150.0, 1.1, GAUGE_PA),
    "oval dome": lambda: InflatedRubber.moulded_dome(_OVAL_M, 0.020, 150.0, 1.1, GAUGE_PA),
    "uneven round dome": lambda: InflatedRubber.moulded_dome(
        _ROUND_M, 0.0235, 155.0, 1.0001, GAUGE_PA
    ),
    "uneven oval dome": lambda: InflatedRubber.moulded_dome(
        _OVAL_M, 0.0235, 155.0, 1.0001, GAUGE_PA
    ),
}
"""Initially flat sheets and moulded domes, of uniform stretch or not; λ of 1.08 to 1.24 at γ0."""

QUANTITIES = ("tension_n_per_m", "prestretch", "gauge_pressure_pa")  # γ0, λ and G


@dataclass(frozen=True)
class CoverageGrid:
    """Cases of a coverage study."""

    rubbers: tuple[str, ...] = tuple(RUBBERS)
    seeds: int = 50  # of the noise, for every rubber
    levels: tuple[float, ...] = (0.85, 1.15)  # besides rest, relative to its gauge pressure
    # relative, of the last level's pressure in half of the seeds, and 2 σ of the open chamber's
    pressure_error: float = 0.02
    frames: int = 60  # of every level: two seconds
    width: int = 224  # of the image, pixels: a pico flexx's
    nodes: int = 1000  # of the mesh that is identified: those of `identify`


@dataclass(frozen=True)
class CoverageRow:
    """One number of one identification with its 95 % interval.

    NaN if it is not determined, or only by the sensor file's atmospheric pressure. Data are the
    `levels` only, or the open chamber too (`vented`).
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
        """Whether the value is determined."""
        return bool(np.isfinite(self.value))

    @property
    def covered(self) -> float:
        """1 if the interval includes the true value, 0 if not; NaN if not determined."""
        return float(self.low <= self.truth <= self.high) if self.determined else np.nan

    @property
    def error(self) -> float:
        """Error of γ0 and gauge pressure relative to the true value; of λ absolute."""
        return (self.value - self.truth) / self._unit

    @property
    def half_width(self) -> float:
        """Half of the interval, as of `error`."""
        return 0.5 * (self.high - self.low) / self._unit

    @property
    def ratio(self) -> float:
        """Size of the error over half of the interval."""
        return abs(self.error) / self.half_width

    @property
    def _unit(self) -> float:
        return 1.0 if self.quantity == "prestretch" else self.truth


def coverage_study(grid: CoverageGrid, parts: Path | None = None) -> Study:
    """Every rubber identified with every seed; an interrupted study is resumed."""
    cases = [
        Case(f"{name} {seed}", partial(_identified, grid, name, seed))
        for name in grid.rubbers
        for seed in range(grid.seeds)
    ]
    settings = asdict(replace(grid, rubbers=(), seeds=0))  # rubbers and seeds may be added later
    return Study("coverage", CoverageRow, cases, report_of, settings, parts)


@cache
def _rubber(name: str) -> InflatedRubber:
    return RUBBERS[name]()


def _identified(grid: CoverageGrid, name: str, seed: int) -> list[CoverageRow]:
    """Identify from one set of recordings: by levels only, and with the chamber opened."""
    rubber, rows = _rubber(name), []
    rng = np.random.default_rng([seed, list(RUBBERS).index(name)])  # independent of other rubbers
    weather = ATMOSPHERE_PA + _WEATHER_PA * rng.standard_normal()
    sigma = _VENTED_NOISE_PA / np.sqrt(_VENTED_FRAMES)
    shown_pa = ATMOSPHERE_PA + sigma * rng.standard_normal()
    sensor = edited(
        rubber.sensor(grid.width), {"pneumatics.atmospheric_pressure_pa": round(weather, 1)}
    )
    off = grid.pressure_error * rng.choice([-1.0, 1.0]) * grid.levels[-1] * GAUGE_PA
    shown_pa += 0.5 * grid.pressure_error * GAUGE_PA * rng.standard_normal()
    vented = Quantity.normal(shown_pa, sigma)
    rest, *others = _recorded(grid, rubber, seed, off if seed % 2 else 0.0)
    levels = [collect(source, sensor, range(grid.frames)) for source in others]
    truths = rubber.tension_n_per_m, rubber.prestretch, rubber.gauge_pressure_pa
    alone = bv.identify(
        rest, sensor, contact_free=range(grid.frames), nodes=grid.nodes, held_press=False
    ).found
    opened = replace(alone, gauge=rest_gauge(alone.samples, sensor, vented), vented=vented)
    for known, given in (("levels", alone), ("vented", opened)):
        found = with_rubber(given, levels)
        numbers: list[Quantity | None] = [None] * len(QUANTITIES)
        if found.vented or found.gauge_candidates:
            numbers = [found.tension, found.prestretch, found.gauge]
        for quantity, truth, number in zip(QUANTITIES, truths, numbers, strict=True):
            interval = (number.value, number.low, number.high) if number else ()
            rows.append(CoverageRow(name, seed, known, quantity, truth, *interval))
    return rows


def _recorded(
    grid: CoverageGrid,
    rubber: InflatedRubber,
    seed: int,
    error_pa: float,  # of the gas pressure of the last level
) -> list[HeldFrames]:
    """Recordings of rest and of every level, each with its own noise."""
    shares = (1.0, *grid.levels)
    return [
        rubber.recording(
            share,
            len(shares) * seed + k,
            frames=grid.frames,
            width=grid.width,
            gas_error_pa=error_pa if k == len(grid.levels) else 0.0,
        )
        for k, share in enumerate(shares)
    ]


COVERED = 0.93
"""Share of the seeds whose interval should include the true value."""
WORST_RATIO = 1.5
"""Of error over half of the interval, in the worst seed."""
_SYMBOLS = dict(zip(QUANTITIES, ("γ0", "λ", "G"), strict=True))


def _largest(errors: np.ndarray) -> float:
    return float(np.abs(errors).max())


_OF: Averages = {
    "determined": ("determined", np.sum),
    "covered": ("covered", np.mean),
    "rms_error": ("error", lambda errors: np.sqrt(np.mean(errors**2))),
    "worst_error": ("error", _largest),
    "bias": ("error", np.mean),
    "half_width": ("half_width", np.median),
    "worst_ratio": ("ratio", np.max),
}


def coverages(rows: Sequence[CoverageRow]) -> list[Record]:
    """Coverage of every number of every rubber, over the seeds where it is determined."""
    return summaries(rows, ("rubber", "known", "quantity"), _OF)


def targets(rows: Sequence[CoverageRow]) -> list[Target]:
    """Whether each target is met."""
    found = []
    for one in coverages(rows):
        name = f"{one['rubber']}, {one['known']}: {_SYMBOLS[one['quantity']]}"
        found.append(at_least(f"{name}, share covered", one["covered"], COVERED))
        found.append(at_most(f"{name}, error over half-width", one["worst_ratio"], WORST_RATIO))
    return found


def report_of(rows: Sequence[CoverageRow]) -> Report:
    """Coverage and errors; those of λ in units of 0.01."""
    words = (Column(n, n) for n in ("rubber", "known", "quantity"))
    shares = (
        Column("seeds", "count"),
        Column("determined", "determined", ".0f"),
        Column("covered %", "covered", ".0f", 100),
    )
    names = ("rms_error", "worst_error", "bias", "half_width")
    errors = (Column(f"{n.replace('_', ' ')} %", n, ".2f", 100) for n in names)
    ratio = Column("worst error / half width", "worst_ratio", ".2f")
    table = Table("coverage", coverages(rows), (*words, *shares, *errors, ratio))
    return Report([table], targets(rows))
