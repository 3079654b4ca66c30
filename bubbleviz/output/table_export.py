"""Tables with one row per frame; column names include units.

`pyarrow` is an optional extra, imported only for Parquet files.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bubbleviz.errors import InputError
from bubbleviz.files import rows_of, write_rows
from bubbleviz.output.exporter import Exporter
from bubbleviz.output.results import csv_row, magnitude_half_width_n, summary_row
from bubbleviz.pipeline import Product
from bubbleviz.plugins import library
from bubbleviz.recordings import measured_force
from bubbleviz.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure


Table = dict[str, list[Any]]  # values of all frames by column

Write = Callable[[Table, Path], None]


class FrameTable:
    """One row per frame: the columns of RESULT.csv, |F| with its interval, and pose columns.

    In SI units, run times in ms.
    """

    def __init__(
        self,
        sensor: str,  # its name
        # (3,) force of the wrench sensor without contact; None: from these frames
        wrench_bias_n: np.ndarray | None = None,
    ) -> None:
        self._sensor, self._wrench_bias_n = sensor, wrench_bias_n
        self._rows: list[dict[str, Any]] = []
        self._more: list[dict[str, Any]] = []
        self._measured = 0  # number of rows when the measured force was computed

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, result: Result, pose: Mapping[str, Any] | None = None) -> None:
        row = summary_row(result)
        more = {
            "force_magnitude_n": float(np.linalg.norm(row["force_n"])),
            "force_magnitude_half_width_n": magnitude_half_width_n(result.solution[0]),
        }
        self._rows.append(row)
        self._more.append(more | dict(pose or {}))

    @property
    def half_widths_n(self) -> list[float]:
        """Half of the 95 % interval of each force, N."""
        return [more["force_magnitude_half_width_n"] for more in self._more]

    def rows(self) -> list[dict[str, Any]]:
        """Values of each frame by key of RESULT.npz. Raises InputError: no frames."""
        if not self._rows:
            raise InputError("no frames were given; choose at least one")
        if self._measured != len(self._rows):  # the bias may depend on all frames
            wrench, bias = np.array([row["wrench_n"] for row in self._rows]), self._wrench_bias_n
            contact_free = np.array([row["status"] == "no_contact" for row in self._rows])
            for row, force in zip(
                self._rows, measured_force(wrench, contact_free, bias), strict=True
            ):
                row["measured_force_n"] = float(force)
            self._measured = len(self._rows)
        return self._rows

    def columns(self) -> Table:
        """Values of all frames by column."""
        frames = zip(self.rows(), self._more, strict=True)
        rows = [csv_row(row, self._sensor) | more for row, more in frames]
        return {name: [row[name] for row in rows] for name in rows[0]}


class TableExporter(Exporter):
    products: frozenset[Product] = frozenset({"estimate", "patch"})

    def __init__(
        self,
        path: Path,
        write: Write,  # `write_csv`, `write_parquet` or `write_plots`
        sensor: str,  # its name
        # pose columns by frame index, from `read_poses`
        poses: Mapping[int, dict[str, Any]],
        wrench_bias_n: np.ndarray | None,  # as of `FrameTable`
    ) -> None:
        self._path, self._write = path, write
        self._table = FrameTable(sensor, wrench_bias_n)
        columns = next(iter(poses.values()), {})
        unknown = {k: "" if isinstance(v, str) else np.nan for k, v in columns.items()}
        self._poses, self._no_pose = poses, unknown

    def add(self, result: Result) -> None:
        self._table.add(result, self._poses.get(result.frame.index, self._no_pose))

    def finish(self) -> None:
        self._write(self._table.columns(), self._path)


def write_csv(table: Table, path: Path) -> None:
    """Write CSV in UTF-8 with a header line; `nan` if unknown, empty κ for the automatic rule."""
    write_rows(path, rows_of(table))


def write_parquet(table: Table, path: Path) -> None:
    require_parquet(path)
    import pyarrow
    import pyarrow.parquet

    kappa = pyarrow.array(table["kappa"], pyarrow.float64())  # typed even if all are None
    pyarrow.parquet.write_table(pyarrow.table({**table, "kappa": kappa}), path)


def require_parquet(path: Path) -> None:
    """Raise InputError if the optional library is missing; call it before long computations."""
    library("pyarrow", "parquet", str(path), "export a table as .csv")


# Plots over time, for print and reports.


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
"""Axis label, factor from SI, and columns with legend texts of each plot."""


SIZE_IN = (8.0, 11.0)  # width and height of the figure, inches
DPI = 130  # resolution of a PNG, dots per inch: legible at the width of a page


def write_plots(table: Table, path: Path) -> None:
    """Plots as PNG, SVG or PDF by suffix; see `draw_plots`."""
    from matplotlib.figure import Figure  # takes 0.4 s

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
        if len(columns) > 1 and axes.lines:
            axes.legend(fontsize=8, loc="upper right")
    every[0].set_title("grey: contact found", fontsize=9, loc="right")
    every[-1].set_xlabel("time, s")


def contact_intervals(table: Table) -> list[tuple[float, float]]:
    """First and last time, s, of each run of frames with a contact patch."""
    frames = zip(table["time_s"], table["patch_area_m2"], strict=True)
    runs = groupby(frames, key=lambda frame: frame[1] > 0.0)
    times = [[time for time, _ in run] for touching, run in runs if touching]
    return [(run[0], run[-1]) for run in times]
