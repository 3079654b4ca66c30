"""Validation of the estimated force with a wrench sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bubbleviz.api.estimating import SensorName, estimate, path_of
from bubbleviz.api.frames import open
from bubbleviz.api.saved_summary import SavedSummary, axis_columns, check_out
from bubbleviz.errors import InputError
from bubbleviz.output import Interval, WrenchComparison, compare_with_wrench
from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import AUTO, Frame
from bubbleviz.wording import count_of, plus_minus

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class ValidationSummary(SavedSummary):
    """Comparison of the estimated with a measured force; the sensor is not changed.

    Attributes
    ----------
    recording, sensor : str
    found : WrenchComparison
        estimate(t) = gain · R (measured(t − delay) − bias), with 95 % intervals.
    warning : str or None
        Of the estimate.
    """

    stem = "validation"

    recording: str
    sensor: str
    found: WrenchComparison
    warning: str | None = None

    def facts(self) -> dict[str, Any]:
        """Numbers, SI units, each with half of its 95 % interval; None if not determined."""
        found, parameters = self.found, {}
        for name in ("bias_n", "gain", "rotation_rad", "delay_s", "hysteresis_n"):
            number = getattr(found, name)
            parameters[name] = _plain(number.value)
            parameters[f"{name}_half_width"] = _plain(number.half_width)
        return {
            "recording": self.recording,
            "sensor": self.sensor,
            "out": self.out,
            "warning": self.warning,
            "frames": len(found.time_s),
            "presses": found.presses,
            **parameters,
            "rotation_about_force_known": found.spin_known,
            "rmse_n": found.rmse_n,
            "size_rmse_n": found.size_rmse_n,
            "largest_estimate_n": _largest(found.estimate_n),
            "largest_measured_n": _largest(found.measured_n),
        }

    def lines(self) -> list[str]:
        """Lines of the text for the terminal, with units."""
        found = self.found
        bias = ", ".join(
            _with_interval(Interval(*pair))
            for pair in zip(found.bias_n.value, found.bias_n.half_width, strict=True)
        )
        rotation = found.rotation_rad
        sizes = np.linalg.norm([rotation.value, rotation.half_width], axis=1)
        angle = Interval(*np.degrees(sizes))
        spin = ", undetermined about the force direction (press in other directions too)"
        return [
            f"compared    {count_of(len(found.time_s), 'frame')}, presses: {found.presses}",
            f"force       {_largest(found.estimate_n):.2f} N largest estimate,"
            f" {_largest(found.measured_n):.2f} N largest measurement",
            f"gain        {_with_interval(found.gain)}, estimate divided by measurement",
            f"bias        {bias} N of the wrench sensor, in its axes",
            f"rotation    {_with_interval(angle)}°{'' if found.spin_known else spin}",
            f"delay       {_with_interval(found.delay_s, 1e3)} ms from measurement to estimate",
            f"hysteresis  {_with_interval(found.hysteresis_n, unit=' N')}",
            f"rmse        {found.rmse_n:.2f} N after this fit; {found.size_rmse_n:.2f} N between "
            "the force magnitudes, gain not applied",
            "Intervals: 95 %. The sensor file is not changed.",
        ]

    def columns(self) -> dict[str, np.ndarray]:
        """Force: estimated, measured (less bias and delay), and fitted, N."""
        found = self.found
        return {"time_s": found.time_s} | axis_columns(
            estimate=found.estimate_n, measured=found.measured_n, fitted=found.fitted_n
        )

    def plot(self) -> Figure:
        """Estimated over measured force, and both over time."""
        from matplotlib.figure import Figure  # takes 0.4 s

        found, figure = self.found, Figure(figsize=(10.0, 4.5), layout="constrained")
        sizes = [np.linalg.norm(f, axis=1) for f in (found.measured_n, found.estimate_n)]
        scatter, time = figure.subplots(1, 2)
        end, gain = 1.05 * max(size.max() for size in sizes), float(found.gain.value)
        scatter.plot([0.0, end], [0.0, end], color="0.6", lw=1.0, label="equal")
        scatter.plot([0.0, end], [0.0, gain * end], lw=1.0, label=f"gain {gain:.2f}")
        scatter.scatter(*sizes, s=8.0, c=found.time_s, cmap="viridis")
        scatter.set(xlabel="measured force, N", ylabel="estimated force, N", aspect="equal")
        for k, axis in enumerate("xyz"):
            line = time.plot(found.time_s, found.estimate_n[:, k], label=axis)[0]
            time.plot(found.time_s, found.fitted_n[:, k], "--", color=line.get_color(), lw=1.0)
        time.set(xlabel="time, s", ylabel="force in B, N", title="dashed: measured, fitted")
        for axes in (scatter, time):
            axes.grid(alpha=0.3)
            axes.legend(fontsize=8)
        return figure


def validate(
    frames: Sequence[Frame] | str | Path,
    sensor: SensorName = AUTO,
    *,
    wrench: str | None = None,
    solver: str | None = None,
    friction: float | None = None,
    zero_gas: bool = True,
    out: str | Path | None = None,
    overwrite: bool = False,
    progress: Progress = quiet,
) -> ValidationSummary:
    """Compare the estimated force with a wrench sensor's.

    Reports bias, gain, rotation, delay and hysteresis with 95 % intervals; corrects nothing.

    Parameters
    ----------
    frames : sequence of Frame or path
        With wrenches, partly without contact; or a recording.
    sensor, solver, friction, zero_gas, progress
        As in `estimate`.
    wrench : str, optional
        Topic of the wrenches in a recording given by its path; by default that most similar in name
        to the depth topic.
    out : path, optional
        PLOT.png (.svg, .pdf), TABLE.csv, NUMBERS.json, or a new folder for all.
    overwrite : bool
        Replace existing files.

    Returns
    -------
    ValidationSummary
        For information: it does not change later estimates.

    Raises
    ------
    InputError
        Sensor and frames do not match, or there are no wrenches or no contacts.

    Examples
    --------
    >>> found = bv.validate("press.mcap", "mine.toml", wrench="/ft_sensor/wrench").found
    >>> found.gain.value, found.gain.half_width
    """
    check_out(out, path_of(frames), overwrite=overwrite)
    options: dict[str, Any] = {"solver": solver, "friction": friction, "zero_gas": zero_gas}
    if isinstance(frames, str | Path):
        with open(frames, wrench_topic=wrench) as opened:
            run = estimate(opened, sensor, progress=progress, **options)
    elif wrench is not None:
        raise InputError(
            f"wrench {wrench}: the recording is open already; give wrench_topic to bv.open instead"
        )
    else:
        run = estimate(frames, sensor, progress=progress, **options)
    measured = np.array([row["wrench_n"] for row in run.rows()])
    name = run.context["recording"]
    if not np.isfinite(measured).any():
        raise InputError(
            f"{name}: no frame has a wrench; record the wrench sensor together with the depth "
            "camera, or name its topic with --wrench"
        )
    try:
        found = compare_with_wrench(run.times_s, run.force_n, measured)
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
    summary = ValidationSummary(name, run.context["sensor"], found, warning=run.warning)
    return summary.saved(out, overwrite=overwrite)


def _largest(force_n: np.ndarray) -> float:
    return float(np.linalg.norm(force_n, axis=1).max())


def _with_interval(number: Interval, factor: float = 1.0, unit: str = "") -> str:
    value, half = factor * float(number.value), factor * float(number.half_width)
    if not np.isfinite(value):
        return "not determined; record also the release of a press"
    return f"{plus_minus(value, half, 3)}{unit}"


def _plain(value: np.ndarray) -> Any:
    """Numbers for JSON; None if unknown."""
    return np.asarray(value).tolist() if np.isfinite(value).all() else None
