"""What a speed study shows: tables, growth, targets, CSV, JSON and the plot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bubbleviz.files.tables import table, write_csv, write_json
from bubbleviz.inverse.solvers.inverse_solver import RUBBER
from bubbleviz.study.report_files import Target, at_least, at_most, save_figure, target_table
from bubbleviz.study.speed.speed_study import SpeedRow

FILES = ("speed.csv", "speed.json", "speed.png")
STAGES = ("observe", "linearise", "assemble", "solve", "patch", "other")
SAME_IOU = 0.01  # difference below which two patches are equally good; chosen
CONTACT_MS = {"contact": 60.0, "recording": 40.0}
"""Median time in contact that playback at the camera's rate allows, simulated and real, ms."""
SMALLEST_FITTED = {"nodes": 800, "pixels": 20_000}


@dataclass(frozen=True)
class Growth:
    """Exponent e of time ∝ size^e, fitted to the larger sizes of a sweep."""

    sweep: str
    setup: str
    exponent: float
    memory_exponent: float
    sizes: int


@dataclass(frozen=True)
class Speed:
    """Everything a speed study found."""

    rows: list[SpeedRow]
    read_ms: float


def growths(rows: Sequence[SpeedRow]) -> list[Growth]:
    """Fitted growth of every sweep and solver."""
    found = []
    for sweep, smallest in SMALLEST_FITTED.items():
        for solver in dict.fromkeys(_asked(row) for row in rows if row.sweep == sweep):
            own = [
                row
                for row in rows
                if row.sweep == sweep
                and _asked(row) == solver
                and not row.error
                and getattr(row, sweep) >= 0.9 * smallest
            ]
            if len(own) >= 2:
                sizes = [getattr(row, sweep) for row in own]
                found.append(
                    Growth(
                        sweep,
                        solver,
                        _slope(sizes, [row.total_ms for row in own]),
                        _slope(sizes, [max(row.memory_peak_bytes, 1) for row in own]),
                        len(own),
                    )
                )
    return found


def _asked(row: SpeedRow) -> str:
    """Solver that was asked for; the default may take another on large meshes."""
    return row.setup.split("_")[0]


def _slope(sizes: Sequence[float], values: Sequence[float]) -> float:
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])


def targets(speed: Speed) -> list[Target]:
    """Targets, and whether each is met in this run."""
    rows = speed.rows
    streams = {row.setup: row for row in rows if row.sweep == "stream" and not row.error}
    found = []
    if "default" in streams:
        own = streams["default"]
        found += [
            at_most("stream, median ms", own.total_ms, 8.0),
            at_most("stream, p95 ms", own.total_p95_ms, 16.0),
        ]
    for sweep, limit in CONTACT_MS.items():
        exact = [r for r in rows if (r.sweep, r.solver) == (sweep, RUBBER) and not r.error]
        found += [at_most(f"{sweep}, exact membrane, median ms", r.total_ms, limit) for r in exact]
    found += _against_baseline([r for r in rows if r.sweep == "baseline" and not r.error])
    for growth in growths(rows):
        if growth.sweep == "nodes":
            name = f"{growth.setup}, exponent in nodes"
            found.append(at_most(name, growth.exponent, 1.6))
    pixels = {row.pixels: row for row in rows if row.sweep == "pixels" and not row.error}
    small = [row for count, row in pixels.items() if 30_000 < count < 50_000]
    large = [row for count, row in pixels.items() if count > 900_000]
    if small and large:
        ratio = large[0].total_ms / small[0].total_ms
        found.append(at_most("1M pixels over 38k", ratio, 10.0))
    return found


def _against_baseline(rows: Sequence[SpeedRow]) -> list[Target]:
    """Default against `osqp-cold` at the loosest tolerance that reaches its IoU, same frames."""
    own = [row for row in rows if row.setup == "default"]
    others = [row for row in rows if row.setup != "default"]
    if not own or not others:
        return []
    equal = [row for row in others if row.iou_mean >= own[0].iou_mean - SAME_IOU]
    if equal:
        other = min(equal, key=lambda row: row.total_ms)
    else:
        other = max(others, key=lambda row: row.iou_mean)
    ratio = other.total_ms / own[0].total_ms
    reached = "" if equal else ", the best it reaches"
    ious = f"IoU {own[0].iou_mean:.3f} against {other.iou_mean:.3f}{reached}"
    return [at_least(f"times faster than {other.setup} ({ious})", ratio, 10.0)]


def as_dict(speed: Speed) -> dict[str, Any]:
    """Everything, for JSON."""
    return {
        "read_ms": speed.read_ms,
        "targets": [asdict(target) for target in targets(speed)],
        "growth": [asdict(growth) for growth in growths(speed.rows)],
        "rows": [asdict(row) for row in speed.rows],
    }


def to_text(speed: Speed) -> str:
    """Tables for the terminal."""
    header = (
        "run", "nodes", "pixels", "build ms", "cold ms", "median ms", "p95 ms", *STAGES,
        "memory MB", "IoU", "force err %",
    )  # fmt: skip
    lines = [_line(row) for row in speed.rows]
    fits = [
        (f"{g.sweep}, {g.setup}", f"{g.exponent:.2f}", f"{g.memory_exponent:.2f}", str(g.sizes))
        for g in growths(speed.rows)
    ]
    return "\n".join(
        [
            f"reading a frame: {speed.read_ms:.2f} ms",
            table(header, lines),
            *(f"{r.sweep} {r.setup}: {r.error}" for r in speed.rows if r.error),
            "",
            table(("growth", "exponent", "of memory", "sizes"), fits),
            "",
            target_table(targets(speed)),
        ]
    )


def _line(row: SpeedRow) -> tuple[str, ...]:
    head = (f"{row.sweep} {row.setup}", str(row.nodes), str(row.pixels))
    if row.error:
        return (*head, "error", *[""] * (len(STAGES) + 6))
    times = [row.build_ms, row.cold_ms, row.total_ms, row.total_p95_ms]
    times += [getattr(row, f"{stage}_ms") for stage in STAGES]
    memory, force = row.memory_peak_bytes / 2**20, 100 * row.force_error_relative_median
    quality = (f"{memory:.0f}", f"{row.iou_mean:.3f}", f"{force:.2f}")
    return (*head, *(f"{t:.1f}" for t in times), *quality)


def write(speed: Speed, folder: Path) -> list[Path]:
    """Write speed.csv, speed.json and speed.png; the paths."""
    paths = [folder / name for name in FILES]
    write_csv(paths[0], speed.rows)
    write_json(paths[1], as_dict(speed))
    _plot(speed, paths[2])
    return paths


def _plot(speed: Speed, path: Path) -> None:
    figure = Figure(figsize=(15, 4.8), layout="constrained")
    bars, nodes, pixels = figure.subplots(1, 3)
    streams = [row for row in speed.rows if row.sweep == "stream" and not row.error]
    bottom = np.zeros(len(streams))
    for stage in STAGES:
        heights = np.array([getattr(row, f"{stage}_ms") for row in streams])
        bars.bar([row.setup for row in streams], heights, bottom=bottom, label=stage)
        bottom += heights
    bars.set(ylabel="ms, median of warm frames", title="Moving press, by stage")
    bars.tick_params(axis="x", rotation=30)
    bars.legend(fontsize=8)
    for axes, sweep in ((nodes, "nodes"), (pixels, "pixels")):
        rows = [row for row in speed.rows if row.sweep == sweep and not row.error]
        for solver in dict.fromkeys(map(_asked, rows)):
            own = [row for row in rows if _asked(row) == solver]
            sizes = [getattr(row, sweep) for row in own]
            axes.loglog(sizes, [row.total_ms for row in own], "o-", label=f"{solver}, warm")
            axes.loglog(sizes, [row.cold_ms for row in own], "x:", label=f"{solver}, cold")
        axes.set(xlabel=sweep, ylabel="ms", title=f"Growth with {sweep}")
        axes.grid(alpha=0.3, which="both")
        axes.legend(fontsize=8)
    save_figure(figure, path)
