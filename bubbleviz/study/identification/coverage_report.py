"""What an identification study shows: coverage and errors, targets, CSV, JSON and the plot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bubbleviz.files.tables import table, write_csv, write_json
from bubbleviz.study.identification.coverage_study import QUANTITIES, CoverageRow
from bubbleviz.study.report_files import Target, at_least, save_figure, target_table

FILES = ("coverage.csv", "coverage.json", "coverage.png")
COVERED = 0.9
"""Share of the seeds whose interval should hold the truth, and whose number be within reach."""
REACH = {"prestretch": 0.04, "gauge_pressure_pa": 0.05}
"""Error of λ, and relative error of the gauge pressure, that levels of ±15 % should allow."""
_SYMBOLS = dict(zip(QUANTITIES, ("γ0", "λ", "G"), strict=True))


@dataclass(frozen=True)
class Coverage:
    """One number of one rubber over the seeds.

    Attributes
    ----------
    rubber, known, quantity : str
        As of `CoverageRow`.
    seeds, determined : int
        How many, and how many of them have a number, which all that follows is about.
    covered : float
        Share of the intervals that hold the truth.
    within : float
        Share with an error within `REACH`; NaN where there is no such limit.
    rms_error, worst_error, bias, half_width : float
        Of γ0 and the gauge pressure relative to the truth, of λ itself; the last is the median.
    """

    rubber: str
    known: str
    quantity: str
    seeds: int
    determined: int
    covered: float
    within: float
    rms_error: float
    worst_error: float
    bias: float
    half_width: float


def coverages(rows: Sequence[CoverageRow]) -> list[Coverage]:
    """Coverage of every number of every rubber."""
    groups: dict[tuple[str, str, str], list[CoverageRow]] = {}
    for row in rows:
        groups.setdefault((row.rubber, row.known, row.quantity), []).append(row)
    return [_coverage(*key, group) for key, group in groups.items()]


def _coverage(rubber: str, known: str, quantity: str, rows: list[CoverageRow]) -> Coverage:
    told = [row for row in rows if row.determined]
    if not told:
        return Coverage(rubber, known, quantity, len(rows), 0, *[np.nan] * 6)
    errors = np.array([row.error for row in told])
    unit = 1.0 if quantity == "prestretch" else told[0].truth
    within = np.nan
    if quantity in REACH:
        within = float(np.mean(np.abs(errors) <= REACH[quantity]))
    return Coverage(
        rubber,
        known,
        quantity,
        seeds=len(rows),
        determined=len(told),
        covered=float(np.mean([row.covered for row in told])),
        within=within,
        rms_error=float(np.sqrt(np.mean(errors**2))),
        worst_error=float(np.abs(errors).max()),
        bias=float(errors.mean()),
        half_width=float(np.median([0.5 * (row.high - row.low) for row in told])) / unit,
    )


def targets(rows: Sequence[CoverageRow]) -> list[Target]:
    """Targets, and whether each is met."""
    found = []
    for one in coverages(rows):
        name = f"{one.rubber}, {one.known}: {_SYMBOLS[one.quantity]}"
        found.append(at_least(f"{name}, share covered", one.covered, COVERED))
        if one.quantity in REACH:
            limit = REACH[one.quantity]
            reach = f"{limit:g}" if one.quantity == "prestretch" else f"{100 * limit:g} %"
            found.append(at_least(f"{name}, share within {reach}", one.within, COVERED))
    return found


def as_dict(rows: Sequence[CoverageRow]) -> dict[str, Any]:
    """Everything, for JSON."""
    return {
        "targets": [asdict(target) for target in targets(rows)],
        "coverage": [asdict(one) for one in coverages(rows)],
        "rows": [asdict(row) for row in rows],
    }


def to_text(rows: Sequence[CoverageRow]) -> str:
    """Tables for the terminal."""
    header = (
        "rubber", "known", "number", "determined", "covered", "rms error", "worst", "bias",
        "half-width",
    )  # fmt: skip
    return "\n".join(
        [table(header, [_line(one) for one in coverages(rows)]), "", target_table(targets(rows))]
    )


def _line(one: Coverage) -> tuple[str, ...]:
    sizes = one.rms_error, one.worst_error, one.bias, one.half_width
    if one.quantity == "prestretch":
        shown = [f"{size:.4f}" for size in sizes]
    else:
        shown = [f"{100 * size:.2f} %" for size in sizes]
    share = f"{one.determined}/{one.seeds}"
    symbol = _SYMBOLS[one.quantity]
    return one.rubber, one.known, symbol, share, f"{100 * one.covered:.0f} %", *shown


def write(rows: Sequence[CoverageRow], folder: Path) -> list[Path]:
    """Write coverage.csv, coverage.json and coverage.png; the paths."""
    paths = [folder / name for name in FILES]
    write_csv(paths[0], rows)
    write_json(paths[1], as_dict(rows))
    _plot(rows, paths[2])
    return paths


def _plot(rows: Sequence[CoverageRow], path: Path) -> None:
    """Error of every seed with its interval; those that miss the truth in another colour."""
    figure = Figure(figsize=(14, 8), layout="constrained")
    kinds = list(dict.fromkeys(row.known for row in rows))
    grid = figure.subplots(len(kinds), len(QUANTITIES), squeeze=False)
    rubbers = list(dict.fromkeys(row.rubber for row in rows))
    for axes, known, quantity in (
        (grid[i][j], known, quantity)
        for i, known in enumerate(kinds)
        for j, quantity in enumerate(QUANTITIES)
    ):
        own = [r for r in rows if (r.known, r.quantity) == (known, quantity) and r.determined]
        seeds = 1 + max((row.seed for row in rows), default=0)
        scale = [1.0 if quantity == "prestretch" else 0.01 * row.truth for row in own]
        for row, unit in zip(own, scale, strict=True):
            x = rubbers.index(row.rubber) + 0.8 * row.seed / seeds
            ends = [(end - row.truth) / unit for end in (row.low, row.high)]
            axes.plot([x, x], ends, color="tab:blue" if row.covered else "tab:red", linewidth=1)
        axes.axhline(0.0, color="black", linewidth=0.8)
        unit_name = "" if quantity == "prestretch" else ", %"
        axes.set(
            title=f"{_SYMBOLS[quantity]}, {known}", ylabel=f"95 % interval less truth{unit_name}"
        )
        axes.set_xticks(np.arange(len(rubbers)) + 0.4, rubbers)
    save_figure(figure, path)
