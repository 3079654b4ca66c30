"""What an accuracy study shows: table, targets, CSV, JSON, and the plot with its Pareto front."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bubbleviz.files.tables import table, write_csv, write_json
from bubbleviz.study.accuracy.accuracy_study import Accuracy, Row, is_deep
from bubbleviz.study.report_files import Target, at_least, at_most, save_figure, target_table

TARGET_NOISE = 0.01  # σ of range over range: the pico flexx's
FILES = ("accuracy.csv", "accuracy.json", "accuracy.png", "accuracy_baseline.csv")


@dataclass(frozen=True)
class Point:
    """One setup on the plane of error and run time: the grid's objects, 10–20 mm, 1 % noise.

    `on_front` says that no other setup is both faster and better, in IoU or in force.
    """

    setup: str
    nodes: int
    pixels: str
    warm_ms: float
    cold_ms: float
    iou_mean: float
    iou_best_threshold_mean: float
    force_error_relative_median: float
    cop_error_m_median: float
    displacement_rms_m_median: float
    gas_error_pa_median: float
    not_ok: int
    on_front: bool = False


def selected(
    accuracy: Accuracy, setup: str, noise: float, *, held_out: bool, deep: bool = True
) -> list[Row]:
    """Rows of one setup and noise level, of the grid's objects or of the held-out ones."""
    return [
        row
        for row in accuracy.rows
        if row.setup == setup
        and row.noise_relative == noise
        and row.held_out == held_out
        and (is_deep(row) or not deep)
    ]


def points(accuracy: Accuracy) -> list[Point]:
    """Every setup on the plane of error and run time, those on the Pareto front marked."""
    found = []
    for setup in accuracy.grid.setups:
        rows = selected(accuracy, setup.label, TARGET_NOISE, held_out=False)
        if rows:
            found.append(_point(setup.label, rows))
    return [_with_front(point, found) for point in found]


def _point(label: str, rows: list[Row]) -> Point:
    def over(name: str, average: Callable[[Any], Any] = np.nanmedian) -> float:
        return float(average([getattr(row, name) for row in rows]))

    return Point(
        setup=label,
        nodes=rows[0].nodes,
        pixels=f"every {rows[0].pixel_stride}" if rows[0].pixel_stride > 1 else "all",
        warm_ms=over("warm_ms"),
        cold_ms=over("cold_ms"),
        iou_mean=over("iou", np.mean),
        iou_best_threshold_mean=over("iou_best_threshold", np.mean),
        force_error_relative_median=over("force_error_relative"),
        cop_error_m_median=over("cop_error_m"),
        displacement_rms_m_median=over("displacement_rms_m"),
        gas_error_pa_median=over("gas_error_pa"),
        not_ok=sum(row.status != "ok" for row in rows),
    )


def _with_front(point: Point, others: list[Point]) -> Point:
    def beaten(error: Callable[[Point], float]) -> bool:
        return any(
            other.warm_ms <= point.warm_ms and error(other) < error(point)
            for other in others
            if other is not point
        )

    front = not beaten(lambda p: -p.iou_mean) or not beaten(lambda p: p.force_error_relative_median)
    return Point(**{**asdict(point), "on_front": front})


def targets(accuracy: Accuracy) -> list[Target]:
    """Targets of the shipped default, and whether each is met."""
    label = accuracy.grid.setups[0].label
    found = []
    for held_out, of in ((False, "grid"), (True, "held-out")):
        rows = selected(accuracy, label, TARGET_NOISE, held_out=held_out)
        if rows:
            force = float(np.median([row.force_error_relative for row in rows]))
            mean_iou = float(np.mean([row.iou for row in rows]))
            found += [
                at_most(f"{of}, 1 %: median force error", force, 0.02),
                at_least(f"{of}, 1 %: mean patch IoU", mean_iou, 0.75),
            ]
        clean = selected(accuracy, label, 0.0, held_out=held_out)
        if clean:
            force = float(np.median([row.force_error_relative for row in clean]))
            rms = float(np.median([row.displacement_rms_m for row in clean]))
            found += [
                at_most(f"{of}, no noise: median force error", force, 0.01),
                at_most(f"{of}, no noise: median rms of u in m", rms, 6e-5),
            ]
    return [*found, *_against_baseline(accuracy, label)]


def _against_baseline(accuracy: Accuracy, label: str) -> Iterable[Target]:
    for base in accuracy.baselines:
        own = [
            row.iou
            for held_out in (False, True)
            for row in selected(accuracy, label, base.noise_relative, held_out=held_out)
            if row.object_name == base.object_name
        ]
        if own and base.noise_relative == TARGET_NOISE:
            value = float(np.mean(own))
            blur = f", blurred {base.blur_px:g} px" if base.blur_px else ""
            name = f"{base.object_name}, 1 %: IoU against the oracle's threshold{blur}"
            yield Target(name, value, f"> {base.iou:.3f}", value > base.iou)


def as_dict(accuracy: Accuracy) -> dict[str, Any]:
    """Everything, for JSON."""
    return {
        "grid": asdict(accuracy.grid),
        "targets": [asdict(target) for target in targets(accuracy)],
        "points": [asdict(point) for point in points(accuracy)],
        "baselines": [asdict(base) for base in accuracy.baselines],
        "omitted": accuracy.omitted,
        "rows": [asdict(row) for row in accuracy.rows],
    }


def to_text(accuracy: Accuracy) -> str:
    """Tables for the terminal."""
    header = (
        "setup", "nodes", "pixels", "ms", "cold ms", "IoU", "at best level", "force err %",
        "CoP mm", "rms u mm", "p_v err Pa", "not ok", "front",
    )  # fmt: skip
    lines = [
        (
            p.setup, str(p.nodes), p.pixels, f"{p.warm_ms:.1f}", f"{p.cold_ms:.0f}",
            f"{p.iou_mean:.3f}", f"{p.iou_best_threshold_mean:.3f}",
            f"{100 * p.force_error_relative_median:.2f}", f"{1e3 * p.cop_error_m_median:.2f}",
            f"{1e3 * p.displacement_rms_m_median:.3f}", f"{p.gas_error_pa_median:.1f}",
            str(p.not_ok), "*" if p.on_front else "",
        )
        for p in points(accuracy)
    ]  # fmt: skip
    parts = [
        "Grid objects, 10–20 mm, 1 % noise; * on the Pareto front",
        table(header, lines),
        "",
        "Shipped default",
        target_table(targets(accuracy)),
        "",
        "Shipped default by object, 10–20 mm, 1 % noise; ℓ: width of the estimate's response",
        table(("object", "", "IoU", "at best level", "patch width / ℓ"), _by_object(accuracy)),
        *([""] if accuracy.omitted else []),
        *(f"left out: {line}" for line in accuracy.omitted),
    ]
    return "\n".join(parts)


def _by_object(accuracy: Accuracy) -> list[tuple[str, ...]]:
    """Results by object, with the width of the patch that explains most of the differences."""
    found: list[tuple[str, ...]] = []
    label = accuracy.grid.setups[0].label
    for held_out in (False, True):
        rows = selected(accuracy, label, TARGET_NOISE, held_out=held_out)
        for name in dict.fromkeys(row.object_name for row in rows):
            own = [row for row in rows if row.object_name == name]
            found.append(
                (
                    name,
                    "held out" if held_out else "grid",
                    f"{np.mean([row.iou for row in own]):.3f}",
                    f"{np.mean([row.iou_best_threshold for row in own]):.3f}",
                    f"{np.mean([row.patch_width_m / row.resolution_m for row in own]):.1f}",
                )
            )
    return found


def write(accuracy: Accuracy, folder: Path) -> list[Path]:
    """Write accuracy.csv, .json, .png and the baselines; the paths."""
    paths = [folder / name for name in FILES]
    write_csv(paths[0], accuracy.rows)
    write_json(paths[1], as_dict(accuracy))
    _plot(accuracy, paths[2])
    write_csv(paths[3], accuracy.baselines)
    return paths


def _plot(accuracy: Accuracy, path: Path) -> None:
    figure = Figure(figsize=(17, 5), layout="constrained")
    left, right, width = figure.subplots(1, 3)
    _width_panel(width, accuracy)
    found = points(accuracy)
    _panel(left, found, [p.iou_mean for p in found], -1.0)
    base = [b.iou for b in accuracy.baselines if not b.blur_px and b.noise_relative == TARGET_NOISE]
    if base:
        left.axhline(np.mean(base), color="0.5", ls="--", label="depth threshold by an oracle")
    left.axhline(0.75, color="tab:green", lw=0.8, label="target")
    left.set(ylabel="mean patch IoU", title="Patch, 10–20 mm, 1 % noise")
    _panel(right, found, [100.0 * p.force_error_relative_median for p in found], 1.0)
    right.axhline(2.0, color="tab:green", lw=0.8, label="target")
    right.set(ylabel="median force error, %", yscale="log", title="Force, 10–20 mm, 1 % noise")
    for axes in (left, right):
        axes.set(xlabel="run time of a warm frame, ms (median)", xscale="log")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    save_figure(figure, path)


def _width_panel(axes: Any, accuracy: Accuracy) -> None:
    """IoU of the shipped default against how wide the true patch is."""
    label = accuracy.grid.setups[0].label
    noises = [noise for noise in accuracy.grid.noises_relative if noise > 0.0]
    for k, noise in enumerate(noises):
        for held_out, marker in ((False, "o"), (True, "^")):
            rows = selected(accuracy, label, noise, held_out=held_out, deep=False)
            axes.scatter(
                [row.patch_width_m / row.resolution_m for row in rows],
                [row.iou for row in rows],
                color=f"C{k}",
                marker=marker,
                label=f"{100 * noise:g} % noise, {'held out' if held_out else 'grid'}",
            )
    axes.axhline(0.75, color="tab:green", lw=0.8)
    axes.set(xlabel="mean width of the true patch, ℓ", ylabel="patch IoU", title="Why: width")
    axes.set(xscale="log")
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)


def _panel(axes: Any, found: list[Point], values: list[float], sign: float) -> None:
    """Points by solver, with the front of those that nothing beats; smaller `sign`·value wins."""
    time = np.array([p.warm_ms for p in found])
    for solver in dict.fromkeys(p.setup.split("_")[0] for p in found):
        own = [k for k, p in enumerate(found) if p.setup.split("_")[0] == solver]
        axes.scatter(time[own], np.array(values)[own], s=24, label=solver, alpha=0.8)
    if not found:
        return
    axes.scatter(time[:1], values[:1], s=140, facecolors="none", edgecolors="k", label="shipped")
    order = np.argsort(time)
    best = np.minimum.accumulate(sign * np.array(values)[order])
    axes.step(time[order], sign * best, where="post", color="k", lw=1.0, label="Pareto front")
