"""A table of frames as plots over time, for print and reports."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bubbleviz.output.table_export import Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PLOTS: tuple[tuple[str, float, dict[str, str]], ...] = (
    (
        "force, N",
        1.0,
        {"force_magnitude_n": "|force|", "measured_force_n": "wrench", "force_z_n": "z"},
    ),
    ("gas pressure change p_v, Pa", 1.0, {"gas_pressure_change_pa": ""}),
    ("patch area, mm²", 1e6, {"patch_area_m2": ""}),
    (
        "centre of pressure, mm",
        1e3,
        {"center_of_pressure_x_m": "x", "center_of_pressure_y_m": "y"},
    ),
    ("residual rms, mm", 1e3, {"residual_rms_m": ""}),
    ("time, ms", 1.0, {"solve_ms": "solver", "total_ms": "depth in → patch out"}),
)
"""Label, factor from SI, and columns with their names, of each plot."""


SIZE_IN = (8.0, 11.0)
"""Width and height of the figure, inches."""
DPI = 130
"""Resolution of a PNG, dots per inch."""


def write_plots(table: Table, path: Path) -> None:
    """Plots as PNG, SVG or PDF by suffix; see `draw_plots`."""
    from matplotlib.figure import Figure  # 0.4 s, only where plots are written

    figure = Figure(figsize=SIZE_IN, layout="constrained")
    draw_plots(table, figure)
    figure.savefig(path, dpi=DPI)


def draw_plots(table: Table, figure: Figure) -> None:
    """Plots below each other on one time axis; contact is shaded."""
    times = np.array(table["time_s"])
    every: Any = figure.subplots(len(_PLOTS), 1, sharex=True)
    for axes, (label, factor, columns) in zip(every, _PLOTS, strict=True):
        for column, name in columns.items():
            values = factor * np.array(table[column])
            if np.isfinite(values).any():
                axes.plot(times, values, ".-", label=name, lw=1.0, ms=3.0)
        for start, end in contact_intervals(table):
            axes.axvspan(start, end, color="0.9", lw=0.0, zorder=0)
        axes.set_ylabel(label, fontsize=9)
        axes.grid(alpha=0.3)
        if len(columns) > 1:
            axes.legend(fontsize=8, loc="upper right")
    every[0].set_title("grey: contact found", fontsize=9, loc="right")
    every[-1].set_xlabel("time, s")


def contact_intervals(table: Table) -> list[tuple[float, float]]:
    """First and last time, s, of each run of frames with a contact patch."""
    frames = zip(table["time_s"], table["patch_area_m2"], strict=True)
    runs = groupby(frames, key=lambda frame: frame[1] > 0.0)
    times = [[time for time, _ in run] for touching, run in runs if touching]
    return [(run[0], run[-1]) for run in times]
