"""What an accuracy study shows: tables, targets, CSV, JSON, and the plots."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bubbleviz.files.tables import table, write_csv, write_json
from bubbleviz.study.accuracy.accuracy_study import SHALLOWEST_SHARE, Accuracy, Row
from bubbleviz.study.report_files import Target, at_least, at_most, save_figure, target_table

FILES = (
    "accuracy.csv", "accuracy.json", "accuracy.png", "accuracy_materials.csv",
    "accuracy_baseline.csv",
)  # fmt: skip
_KINDS = {False: "known", True: "identified"}
_FORCE = {False: (0.02, 0.05), True: (0.03, 0.06)}
"""Targets of the force error, median and worst, where the material is known and identified."""
_LEAST_IOU = 0.75


@dataclass(frozen=True)
class Curve:
    """Errors of one setup at one depth, over membranes, objects and noises of one kind.

    Attributes
    ----------
    material : str
        `known` or `identified`.
    depth_share : float
        Of the dome's height.
    presses, failed : int
        Presses at a noise level; those of them with frames that have no answer.
    """

    material: str
    setup: str
    depth_share: float
    presses: int
    failed: int
    force_error_relative_median: float
    force_error_relative_worst: float
    force_excess_relative_median: float
    iou_median: float
    area_error_relative_median: float
    edge_in_band_mean: float
    warm_ms: float


@dataclass(frozen=True)
class Point:
    """One setup on the plane of error and run time: presses into the sensor at one noise.

    `on_front` says that no other setup is both faster and better, in IoU or in force.
    """

    setup: str
    noise: str
    nodes: int
    pixels: str
    warm_ms: float
    cold_ms: float
    iou_mean: float
    iou_best_threshold_mean: float
    force_error_relative_median: float
    force_error_relative_worst: float
    area_error_relative_median: float
    cop_error_m_median: float
    displacement_rms_m_median: float
    gas_error_pa_median: float
    failed: int
    on_front: bool = False


def _over(rows: list[Row], name: str, average: Callable[[Any], Any] = np.median) -> float:
    """Average of what the rows with an answer say; NaN where there is none."""
    values = np.array([getattr(row, name) for row in rows], float)
    values = values[np.isfinite(values)]
    return float(average(values)) if len(values) else np.nan


def curves(accuracy: Accuracy) -> list[Curve]:
    """Errors over depth, by setup and by how the material is known."""
    first = accuracy.grid.setups[:3]
    found = []
    for identified, material in _KINDS.items():
        for setup in first:
            own = [r for r in accuracy.rows if (r.identified, r.setup) == (identified, setup.label)]
            for share in sorted({row.depth_share for row in own}):
                rows = [row for row in own if row.depth_share == share]
                found.append(
                    Curve(
                        material=material,
                        setup=setup.label,
                        depth_share=share,
                        presses=len(rows),
                        failed=sum(row.failed > 0 for row in rows),
                        force_error_relative_median=_over(rows, "force_error_relative"),
                        force_error_relative_worst=_over(rows, "force_error_relative", np.max),
                        force_excess_relative_median=_over(rows, "force_excess_relative"),
                        iou_median=_over(rows, "iou"),
                        area_error_relative_median=_over(rows, "area_error_relative"),
                        edge_in_band_mean=_over(rows, "edge_in_band", np.mean),
                        warm_ms=_over(rows, "warm_ms"),
                    )
                )
    return found


def points(accuracy: Accuracy) -> list[Point]:
    """Every setup on the plane of error and run time, those on the Pareto front marked."""
    found: list[Point] = []
    for noise in dict.fromkeys(row.noise for row in accuracy.rows):
        some = []
        for setup in accuracy.grid.setups:
            rows = [
                row
                for row in accuracy.rows
                if (row.specimen, row.noise, row.setup) == ("sensor", noise, setup.label)
                and not row.held_out
                and row.depth_share >= SHALLOWEST_SHARE
            ]
            if rows:
                some.append(_point(setup.label, rows))
        found += [_with_front(point, some) for point in some]
    return found


def _point(label: str, rows: list[Row]) -> Point:
    return Point(
        setup=label,
        noise=rows[0].noise,
        nodes=rows[0].nodes,
        pixels=f"every {rows[0].pixel_stride}" if rows[0].pixel_stride > 1 else "all",
        warm_ms=_over(rows, "warm_ms"),
        cold_ms=_over(rows, "cold_ms"),
        iou_mean=_over(rows, "iou", np.mean),
        iou_best_threshold_mean=_over(rows, "iou_best_threshold", np.mean),
        force_error_relative_median=_over(rows, "force_error_relative"),
        force_error_relative_worst=_over(rows, "force_error_relative", np.max),
        area_error_relative_median=_over(rows, "area_error_relative"),
        cop_error_m_median=_over(rows, "cop_error_m"),
        displacement_rms_m_median=_over(rows, "displacement_rms_m"),
        gas_error_pa_median=_over(rows, "gas_error_pa"),
        failed=sum(row.failed > 0 for row in rows),
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
    """Targets of the first setup, and whether each is met."""
    label = accuracy.grid.setups[0].label
    found: list[Target] = []
    for identified, (median, worst) in _FORCE.items():
        rows = [r for r in accuracy.rows if (r.identified, r.setup) == (identified, label)]
        for noise in dict.fromkeys(row.noise for row in rows):
            own = [row for row in rows if row.noise == noise]
            answered = [row for row in own if np.isfinite(row.force_error_relative)]
            name = f"{_KINDS[identified]}, {noise}"
            if answered:
                error = [row.force_error_relative for row in answered]
                found += [
                    at_most(f"{name}: median force error", float(np.median(error)), median),
                    at_most(f"{name}: worst force error", max(error), worst),
                ]
            found.append(at_most(f"{name}: presses without an answer", len(own) - len(answered), 0))
            deep = [row.iou for row in answered if row.depth_share >= SHALLOWEST_SHARE]
            if deep:
                overlap = float(np.mean(deep))
                found.append(at_least(f"{name}: mean patch IoU", overlap, _LEAST_IOU))
    return [*found, *_against_baseline(accuracy, label)]


def _against_baseline(accuracy: Accuracy, label: str) -> Iterable[Target]:
    for base in accuracy.baselines:
        own = [
            row.iou
            for row in accuracy.rows
            if (row.specimen, row.setup, row.noise) == ("sensor", label, base.noise)
            and row.object_name == base.object_name
            and row.depth_share >= SHALLOWEST_SHARE
        ]
        if own:
            value = float(np.mean(own))
            blur = f", blurred {base.blur_px:g} px" if base.blur_px else ""
            name = f"{base.object_name}, {base.noise}: IoU against the oracle's threshold{blur}"
            yield Target(name, value, f"> {base.iou:.3f}", value > base.iou)


def as_dict(accuracy: Accuracy) -> dict[str, Any]:
    """Everything, for JSON."""
    return {
        "grid": asdict(accuracy.grid),
        "targets": [asdict(target) for target in targets(accuracy)],
        "curves": [asdict(curve) for curve in curves(accuracy)],
        "points": [asdict(point) for point in points(accuracy)],
        "materials": [asdict(material) for material in accuracy.materials],
        "baselines": [asdict(base) for base in accuracy.baselines],
        "omitted": accuracy.omitted,
        "rows": [asdict(row) for row in accuracy.rows],
    }


def to_text(accuracy: Accuracy) -> str:
    """Tables for the terminal."""
    header = (
        "setup", "noise", "nodes", "pixels", "ms", "cold ms", "IoU", "at best level",
        "force err %", "worst %", "area err %", "CoP mm", "rms u mm", "p_v err Pa", "failed",
        "front",
    )  # fmt: skip
    lines = [
        (
            p.setup, p.noise, str(p.nodes), p.pixels, f"{p.warm_ms:.1f}", f"{p.cold_ms:.0f}",
            f"{p.iou_mean:.3f}", f"{p.iou_best_threshold_mean:.3f}",
            f"{100 * p.force_error_relative_median:.2f}",
            f"{100 * p.force_error_relative_worst:.1f}",
            f"{100 * p.area_error_relative_median:+.0f}", f"{1e3 * p.cop_error_m_median:.2f}",
            f"{1e3 * p.displacement_rms_m_median:.3f}", f"{p.gas_error_pa_median:.1f}",
            str(p.failed), "*" if p.on_front else "",
        )
        for p in points(accuracy)
    ]  # fmt: skip
    parts = [
        f"Truth: the {accuracy.grid.model} membrane",
        "",
        "Force error over press depth, all membranes and noises",
        _curve_table(accuracy),
        "",
        "Membranes: told and true",
        _material_table(accuracy),
        "",
        f"The sensor, from {100 * SHALLOWEST_SHARE:g} % of its height; * on the Pareto front",
        table(header, lines),
        "",
        f"Targets of {accuracy.grid.setups[0].label}",
        target_table(targets(accuracy)),
        "",
        "By membrane and object; ℓ: width of the estimate's response",
        _object_table(accuracy),
        *([""] if accuracy.omitted else []),
        *(f"left out: {line}" for line in accuracy.omitted),
    ]
    return "\n".join(parts)


def _curve_table(accuracy: Accuracy) -> str:
    header = (
        "material", "setup", "depth %", "presses", "failed", "median %", "worst %", "excess %",
        "IoU", "area err %", "edge in band %", "ms",
    )  # fmt: skip
    lines = [
        (
            c.material, c.setup, f"{100 * c.depth_share:g}", str(c.presses), str(c.failed),
            f"{100 * c.force_error_relative_median:.2f}",
            f"{100 * c.force_error_relative_worst:.1f}",
            f"{100 * c.force_excess_relative_median:+.1f}", f"{c.iou_median:.2f}",
            f"{100 * c.area_error_relative_median:+.0f}",
            f"{100 * c.edge_in_band_mean:.0f}", f"{c.warm_ms:.0f}",
        )
        for c in curves(accuracy)
    ]  # fmt: skip
    return table(header, lines)


def _material_table(accuracy: Accuracy) -> str:
    def stretch(value: float | None) -> str:
        return "unknown" if value is None else f"{value:.3f}"

    header = ("membrane", "noise", "G Pa", "true", "γ0 N/m", "true", "λ", "true")
    lines = [
        (
            m.specimen, m.noise, f"{m.gauge_pressure_pa:.0f}", f"{m.true_gauge_pressure_pa:.0f}",
            f"{m.tension_n_per_m:.1f}", f"{m.true_tension_n_per_m:.1f}", stretch(m.prestretch),
            stretch(m.true_prestretch),
        )
        for m in accuracy.materials
    ]  # fmt: skip
    return table(header, lines)


def _object_table(accuracy: Accuracy) -> str:
    """Results by object, with the width of the patch that explains most of its IoU."""
    label = accuracy.grid.setups[0].label
    own = [row for row in accuracy.rows if row.setup == label]
    lines = []
    for key in dict.fromkeys((row.specimen, row.object_name, row.noise) for row in own):
        rows = [row for row in own if (row.specimen, row.object_name, row.noise) == key]
        width = float(np.mean([row.patch_width_m / row.resolution_m for row in rows]))
        lines.append(
            (
                *key,
                "held out" if rows[0].held_out else "",
                f"{100 * _over(rows, 'force_error_relative'):.2f}",
                f"{100 * _over(rows, 'force_error_relative', np.max):.1f}",
                f"{_over(rows, 'iou', np.mean):.3f}",
                f"{_over(rows, 'iou_best_threshold', np.mean):.3f}",
                f"{width:.1f}",
                str(sum(row.failed > 0 for row in rows)),
            )
        )
    header = (
        "membrane", "object", "noise", "", "force err %", "worst %", "IoU", "at best level",
        "patch width / ℓ", "failed",
    )  # fmt: skip
    return table(header, lines)


def write(accuracy: Accuracy, folder: Path) -> list[Path]:
    """Write accuracy.csv, .json, .png, materials and baselines; the paths."""
    paths = [folder / name for name in FILES]
    write_csv(paths[0], accuracy.rows)
    write_json(paths[1], as_dict(accuracy))
    _plot(accuracy, paths[2])
    write_csv(paths[3], accuracy.materials)
    write_csv(paths[4], accuracy.baselines)
    return paths


def _plot(accuracy: Accuracy, path: Path) -> None:
    figure = Figure(figsize=(17, 10), layout="constrained")
    panels = figure.subplots(2, 3)
    found = curves(accuracy)
    for axes, material in zip(panels[0], _KINDS.values(), strict=False):
        _depth_panel(axes, [c for c in found if c.material == material], material)
    _width_panel(panels[0, 2], accuracy)
    noises = list(dict.fromkeys(row.noise for row in accuracy.rows))
    some = [p for p in points(accuracy) if p.noise == noises[-1]] if noises else []
    _time_panel(panels[1, 0], some, [p.iou_mean for p in some], -1.0)
    base = [b.iou for b in accuracy.baselines if not b.blur_px and b.noise == noises[-1]]
    if base:
        panels[1, 0].axhline(
            np.mean(base), color="0.5", ls="--", label="depth threshold by an oracle"
        )
    panels[1, 0].axhline(_LEAST_IOU, color="tab:green", lw=0.8, label="target")
    panels[1, 0].set(ylabel="mean patch IoU", title="Patch on the sensor")
    _time_panel(panels[1, 1], some, [100.0 * p.force_error_relative_median for p in some], 1.0)
    panels[1, 1].axhline(100.0 * _FORCE[False][0], color="tab:green", lw=0.8, label="target")
    panels[1, 1].set(ylabel="median force error, %", yscale="log", title="Force on the sensor")
    panels[1, 2].set_axis_off()
    for axes in panels[1, :2]:
        axes.set(xlabel="run time of a warm frame, ms (median)", xscale="log")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    save_figure(figure, path)


def _depth_panel(axes: Any, found: list[Curve], material: str) -> None:
    """Median and worst force error over depth."""
    for k, setup in enumerate(dict.fromkeys(c.setup for c in found)):
        own = [c for c in found if c.setup == setup]
        depth = [100.0 * c.depth_share for c in own]
        median = [100.0 * c.force_error_relative_median for c in own]
        worst = [100.0 * c.force_error_relative_worst for c in own]
        axes.plot(depth, median, "o-", color=f"C{k}", label=setup)
        axes.plot(depth, worst, "^:", color=f"C{k}", label=f"{setup}, worst")
    for limit in _FORCE[material == _KINDS[True]]:
        axes.axhline(100.0 * limit, color="tab:green", lw=0.8)
    axes.set(xlabel="depth, % of the dome's height", ylabel="force error, %", yscale="log")
    axes.set(title=f"Force over depth, material {material}; green: targets")
    axes.grid(alpha=0.3)
    if found:
        axes.legend(fontsize=8)


def _width_panel(axes: Any, accuracy: Accuracy) -> None:
    """IoU of the first setup against how wide the true patch is."""
    label = accuracy.grid.setups[0].label
    own = [row for row in accuracy.rows if row.setup == label]
    for k, noise in enumerate(dict.fromkeys(row.noise for row in own)):
        for held_out, marker in ((False, "o"), (True, "^")):
            rows = [row for row in own if (row.noise, row.held_out) == (noise, held_out)]
            axes.scatter(
                [row.patch_width_m / row.resolution_m for row in rows],
                [row.iou for row in rows],
                color=f"C{k}",
                marker=marker,
                label=f"{noise}{', held out' if held_out else ''}" if rows else None,
            )
    axes.axhline(_LEAST_IOU, color="tab:green", lw=0.8)
    axes.set(xlabel="mean width of the true patch, ℓ", ylabel="patch IoU", title="Patch over width")
    axes.set(xscale="log")
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)


def _time_panel(axes: Any, found: list[Point], values: list[float], sign: float) -> None:
    """Points by solver, with the front of those that nothing beats; smaller `sign`·value wins."""
    time = np.array([p.warm_ms for p in found])
    for solver in dict.fromkeys(p.setup.split("_")[0] for p in found):
        own = [k for k, p in enumerate(found) if p.setup.split("_")[0] == solver]
        axes.scatter(time[own], np.array(values)[own], s=24, label=solver, alpha=0.8)
    if not found:
        return
    axes.scatter(time[:1], values[:1], s=140, facecolors="none", edgecolors="k", label="first")
    order = np.argsort(time)
    best = np.minimum.accumulate(sign * np.array(values)[order])
    axes.step(time[order], sign * best, where="post", color="k", lw=1.0, label="Pareto front")
