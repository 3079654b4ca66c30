"""What the reports of the studies share: targets, a folder that is free, figures."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from bubbleviz.files.output_files import refuse_existing, whole_file
from bubbleviz.files.tables import table

_DOTS_PER_INCH = 130  # legible at the width of a page


@dataclass(frozen=True)
class Target:
    """A value with its limit, such as `≤ 0.02`, and whether that is met."""

    name: str
    value: float
    limit: str
    met: bool


def at_most(name: str, value: float, limit: float) -> Target:
    """Target with an upper limit."""
    return Target(name, float(value), f"≤ {limit:g}", bool(value <= limit))


def at_least(name: str, value: float, limit: float) -> Target:
    """Target with a lower limit."""
    return Target(name, float(value), f"≥ {limit:g}", bool(value >= limit))


def target_table(targets: Iterable[Target]) -> str:
    """Table for the terminal."""
    lines = [(t.name, f"{t.value:.3g}", t.limit, "met" if t.met else "NOT met") for t in targets]
    return table(("target", "value", "limit", ""), lines)


def check_free(folder: Path, names: Iterable[str]) -> None:
    """Refuse a folder that has one of the files already, before the long work."""
    for name in names:
        refuse_existing(folder / name)


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure whole or not at all."""
    with whole_file(path) as temporary:
        figure.savefig(temporary, dpi=_DOTS_PER_INCH)
