"""Two recordings, or one with two sensor files, on one time axis."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from bubbleviz.api.estimating import Recorded, SensorName, estimate, path_of
from bubbleviz.api.results import Run, load_run
from bubbleviz.api.saved_summary import SavedSummary, axis_columns, check_out
from bubbleviz.errors import InputError, check_choice
from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import AUTO, find_gaps
from bubbleviz.wording import count_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Alignment = Literal["time", "contact"]
"""By the time since the start of each recording, or since its first frame with contact."""
_SAME_S = 1e-4  # largest time between simultaneous frames
_STATISTICS: dict[str, Callable[[np.ndarray], Any]] = {
    "median": np.median,
    "p95": lambda values: np.percentile(values, 95.0),
    "max": np.max,
}


@dataclass(frozen=True)
class Comparison(SavedSummary):
    """Two runs at the F frames of the first; the other one is interpolated between its frames.

    Attributes
    ----------
    recording, other : str
    align : {"time", "contact"}
    shift_s : float
        Time t of the first corresponds to t + `shift_s` of the other, s.
    time_s : (F,) array
        Since the first recording began, s.
    force_n, other_force_n : (F, 3) array
        N in the bubble frame of each; NaN without a trusted estimate.
    area_m2, other_area_m2 : (F,) array
        Patch area, m².
    """

    stem = "comparison"

    recording: str
    other: str
    align: Alignment
    shift_s: float
    time_s: np.ndarray
    force_n: np.ndarray
    other_force_n: np.ndarray
    area_m2: np.ndarray
    other_area_m2: np.ndarray

    @property
    def force_difference_n(self) -> np.ndarray:
        """Length of the difference of the force vectors, (F,), N."""
        return np.linalg.norm(self.other_force_n - self.force_n, axis=1)

    @property
    def area_difference_m2(self) -> np.ndarray:
        """Area of the other patch minus area of the first, (F,), m²."""
        return self.other_area_m2 - self.area_m2

    def facts(self) -> dict[str, Any]:
        """Counts, and statistics of |ΔF| and |Δarea| in frames with contact in either, SI."""
        differences = {
            "force_difference_n": self.force_difference_n,
            "area_difference_m2": np.abs(self.area_difference_m2),
        }
        known = np.isfinite(self.force_difference_n)
        touching = known & ((self.area_m2 > 0.0) | (self.other_area_m2 > 0.0))
        return {
            "recording": self.recording,
            "other": self.other,
            "out": self.out,
            "align": self.align,
            "shift_s": self.shift_s,
            "frames": int(known.sum()),
            "contact_frames": int(touching.sum()),
        } | {
            f"{statistic}_{name}": float(of(values[touching])) if touching.any() else None
            for name, values in differences.items()
            for statistic, of in _STATISTICS.items()
        }

    def lines(self) -> list[str]:
        """Lines of the text for the terminal, with units."""
        facts, by = self.facts(), "time"
        if self.align == "contact":
            way = "earlier" if self.shift_s >= 0.0 else "later"
            by = f"first contact: {Path(self.other).name} shifted {abs(self.shift_s):.3f} s {way}"
        contact = count_of(facts["contact_frames"], "frame")
        lines = [f"compared  {count_of(facts['frames'], 'frame')}, aligned by {by}"]
        differences = "differences in these:" if facts["contact_frames"] else "none to compare"
        lines += [f"contact   {contact} with contact in either; {differences}"]
        for label, name, factor, unit in (
            ("|ΔF|", "force_difference_n", 1.0, "N"),
            ("|Δarea|", "area_difference_m2", 1e6, "mm²"),
        ):
            median, p95, most = (facts[f"{each}_{name}"] for each in _STATISTICS)
            if median is not None:
                numbers = [f"{factor * number:.3g} {unit}" for number in (median, p95, most)]
                lines.append("{:9} {} median, {} 95th percentile, {} max".format(label, *numbers))
        return lines

    def columns(self) -> dict[str, np.ndarray]:
        """Time, force and area of both, and their differences."""
        return {
            "time_s": self.time_s,
            **axis_columns(force=self.force_n, other_force=self.other_force_n),
            "force_difference_n": self.force_difference_n,
            "area_m2": self.area_m2,
            "other_area_m2": self.other_area_m2,
            "area_difference_m2": self.area_difference_m2,
        }

    def plot(self) -> Figure:
        """Force and patch area of both over time, and their differences."""
        from matplotlib.figure import Figure  # 0.4 s

        figure = Figure(figsize=(8.0, 5.0), layout="constrained")
        sizes = [np.linalg.norm(force, axis=1) for force in (self.force_n, self.other_force_n)]
        areas = [1e6 * self.area_m2, 1e6 * self.other_area_m2, 1e6 * self.area_difference_m2]
        curves = {"force, N": [*sizes, self.force_difference_n], "patch area, mm²": areas}
        names = (Path(self.recording).name, Path(self.other).name, "difference")
        panels = figure.subplots(2, sharex=True)
        for axes, (label, values) in zip(panels, curves.items(), strict=True):
            for name, style, each in zip(names, ("-", "--", ":"), values, strict=True):
                axes.plot(self.time_s, each, style, label=name)
            axes.set(ylabel=label)
            axes.grid(alpha=0.3)
        panels[0].legend(fontsize=8)
        panels[1].set(xlabel="time, s")
        return figure


def compare(
    first: Run | Recorded,
    other: Run | Recorded,
    sensor: SensorName = AUTO,
    other_sensor: SensorName | None = None,
    *,
    align: Alignment = "time",
    out: str | Path | None = None,
    overwrite: bool = False,
    progress: Progress = quiet,
) -> Comparison:
    """Compare force and patch area of two recordings, frame by frame.

    Give a recording twice to compare two sensor files, or two estimates of it.

    Parameters
    ----------
    first, other : Run, sequence of Frame or path
        What `estimate` found with any options, a RESULT.npz, or a recording, which is estimated.
    sensor
        As in `estimate`.
    other_sensor : str, path or Sensor, optional
        Sensor file or preset of the second one; by default that of the first.
    align : {"time", "contact"}
        time: since both began; contact: since their first frame with contact.
    out : path, optional
        PLOT.png (.svg, .pdf), TABLE.csv, NUMBERS.json, or a new folder for all.
    overwrite : bool
        Replace existing files.
    progress : Progress

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        A recording cannot be estimated, they never have a trusted force at the same time, one has
        no contact to align by, or `out` exists.

    Examples
    --------
    >>> found = bv.compare("before.mcap", "after.mcap", "mine.toml", align="contact")
    >>> found.facts()["median_force_difference_n"]
    """
    check_choice("--align", align, get_args(Alignment))
    check_out(out, path_of(first), path_of(other), overwrite=overwrite)
    sensors = sensor, sensor if other_sensor is None else other_sensor
    a, b = (_run(*each, progress) for each in zip((first, other), sensors, strict=True))
    names = a.context["recording"], b.context["recording"]
    shift_s = _first_contact_s(b) - _first_contact_s(a) if align == "contact" else 0.0
    at_s, areas = a.times_s + shift_s, [run.columns()["patch_area_m2"] for run in (a, b)]
    both = _interpolated(at_s, b.times_s, np.column_stack([b.force_n, areas[1]]))
    forces, own_areas = (a.force_n, both[:, :3]), (areas[0], both[:, 3])
    found = Comparison(*names, align, shift_s, a.times_s, *forces, *own_areas)
    if not np.isfinite(found.force_difference_n).any():
        raise InputError(
            f"{names[0]}, {names[1]}: at no time do both have a trusted force; use --align "
            f"{'time' if align == 'contact' else 'contact'}, or look up the status of their frames "
            "in a table by bubbleviz estimate --csv"
        )
    return found.saved(out, overwrite=overwrite)


def _run(given: Run | Recorded, sensor: SensorName, progress: Progress) -> Run:
    if isinstance(given, Run):
        return given
    if isinstance(given, str | Path) and Path(given).suffix == ".npz":
        return load_run(given)
    return estimate(given, sensor, progress=progress)


def _first_contact_s(run: Run) -> float:
    touching = run.columns()["patch_area_m2"] > 0.0
    if not touching.any():
        raise InputError(f"{run.context['recording']}: no contact was found; use --align time")
    return float(run.times_s[touching.argmax()])


def _interpolated(at_s: np.ndarray, times_s: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (F, k) at other times; NaN beyond their ends and where frames are missing."""
    after = np.clip(np.searchsorted(times_s, at_s), 1, max(len(times_s) - 1, 1))
    before_s, after_s = times_s[after - 1], times_s[np.minimum(after, len(times_s) - 1)]
    nearest_s = np.where(at_s - before_s < after_s - at_s, before_s, after_s)
    met = np.abs(nearest_s - at_s) < _SAME_S
    missing = np.isin(after - 1, [gap.after_frame for gap in find_gaps(times_s)]) & ~met
    at_s = np.where(met, nearest_s, at_s)
    columns = [np.interp(at_s, times_s, each, np.nan, np.nan) for each in values.T]
    return np.where(missing[:, None], np.nan, np.stack(columns, axis=1))
