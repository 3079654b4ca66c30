"""What a pose study shows: table, targets, CSV, JSON, and error against run time."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bubbleviz.files.tables import table, write_csv, write_json
from bubbleviz.study.pose.pose_study import BOTH, WHOLE_CLOUD, PoseStudy, PoseTrial
from bubbleviz.study.pose.rubber_poses import RubberStudy
from bubbleviz.study.pose.screw_motion import RECOVERY_FRAMES, Screw
from bubbleviz.study.report_files import Target, at_least, at_most, save_figure, target_table

TARGET_NOISE = 0.01  # σ of range over range: the pico flexx's
FILES = ("pose.csv", "rubber.csv", "pose.json", "pose.png")
SUCCESS_OBJECTS = ("frustum", "two_legged_toy")


@dataclass(frozen=True)
class PosePoint:
    """One method on one object at one noise level; medians over the trials."""

    object_name: str
    noise_relative: float
    method: str
    trials: int
    error_m: float
    error_rad: float
    whole_m: float
    whole_rad: float
    success: float
    total_ms: float
    determined: float


@dataclass(frozen=True)
class PoseReport:
    """Trials, those on honest rubber, and screw motions."""

    study: PoseStudy
    rubber: RubberStudy
    screws: list[Screw]


def points(study: PoseStudy) -> list[PosePoint]:
    """Medians by object, noise and method."""
    groups: dict[tuple[str, float, str], list[PoseTrial]] = {}
    for trial in study.trials:
        key = (trial.object_name, trial.noise_relative, trial.method)
        groups.setdefault(key, []).append(trial)
    return [_point(*key, trials) for key, trials in groups.items()]


def _point(name: str, noise: float, method: str, trials: list[PoseTrial]) -> PosePoint:
    def median(field: str) -> float:
        # No pose is an infinite error, and no time.
        values = [getattr(trial, field) for trial in trials]
        return float(np.median(np.nan_to_num(values, nan=np.inf)))

    return PosePoint(
        object_name=name,
        noise_relative=noise,
        method=method,
        trials=len(trials),
        error_m=median("error_m"),
        error_rad=median("error_rad"),
        whole_m=median("whole_m"),
        whole_rad=median("whole_rad"),
        success=float(np.mean([trial.success for trial in trials])),
        total_ms=median("total_ms"),
        determined=float(np.mean([trial.determined for trial in trials])),
    )


def targets(report: PoseReport) -> list[Target]:
    """Targets, and whether each is met."""
    found = {
        (p.object_name, p.method): p
        for p in points(report.study)
        if p.noise_relative == TARGET_NOISE
    }
    result: list[Target] = []
    for name in report.study.grid.objects:
        own, rival = found.get((name, BOTH)), found.get((name, WHOLE_CLOUD))
        if own is None or rival is None:
            continue
        degrees = float(np.degrees(own.error_rad))
        result += [
            at_most(f"{name}, 1 %: median error in mm", 1e3 * own.error_m, 1.0),
            at_most(f"{name}, 1 %: median error in °", degrees, 2.0),
        ]
        if name in SUCCESS_OBJECTS:
            result.append(at_least(f"{name}, 1 %: success", own.success, 0.9))
        better = (
            own.error_m < rival.error_m
            and own.error_rad < rival.error_rad
            and own.success > rival.success
        )
        result.append(Target(f"{name}, 1 %: better than whole cloud", float(better), "= 1", better))
    return [*result, *_rubber_targets(report.rubber), *_screw_targets(report.screws)]


def _rubber_targets(study: RubberStudy) -> list[Target]:
    """All that an image determines, flat faces with visible edges too; no pose is infinite."""
    off = np.nan_to_num(np.array([trial.seen_m for trial in study.trials]), nan=np.inf)
    turned = np.nan_to_num(np.array([trial.seen_rad for trial in study.trials]), nan=np.inf)
    runs = f"rubber, {len(off)} starts"
    return [
        at_most(f"{runs}: median error in mm", 1e3 * np.median(off), 0.4),
        at_most(f"{runs}: worst error in mm", 1e3 * off.max(), 1.0),
        at_most(f"{runs}: worst error in °", np.degrees(turned.max()), 3.0),
    ]


def _screw_targets(screws: list[Screw]) -> list[Target]:
    """What is asked of runs with other noise, and of those with blank frames."""
    plain = [screw for screw in screws if not screw.blanked]
    worst = np.degrees([screw.rotation_error_rad_max for screw in plain])
    runs = f"screw, {len(plain)} runs"
    result = [
        at_most(f"{runs}: frames not ok", sum(s.frames - s.status.get("ok", 0) for s in plain), 0),
        at_most(f"{runs}: largest rotation error in °, typical run", np.median(worst), 3.0),
        at_most(f"{runs}: largest rotation error in °, worst run", worst.max(), 3.0),
        at_most(f"{runs}: median ms", np.median([s.median_total_ms for s in plain]), 20.0),
        at_most(f"{runs}: p95 ms", np.median([s.p95_total_ms for s in plain]), 40.0),
    ]
    for screw in screws:
        if screw.blanked:
            after, lost = screw.recovered_after or np.inf, screw.status.get("lost", 0)
            result += [
                at_least("screw, 10 frames blank: frames lost", lost, 1.0),
                at_most("screw, 10 frames blank: frames to recover", after, RECOVERY_FRAMES),
            ]
    return result


def as_dict(report: PoseReport) -> dict[str, Any]:
    """Everything, for JSON."""
    return {
        "grid": asdict(report.study.grid),
        "targets": [asdict(target) for target in targets(report)],
        "points": [asdict(point) for point in points(report.study)],
        "screws": [asdict(screw) for screw in report.screws],
        "omitted": [*report.study.omitted, *report.rubber.omitted],
        "rubber": [asdict(trial) for trial in report.rubber.trials],
        "trials": [asdict(trial) for trial in report.study.trials],
    }


def to_text(report: PoseReport) -> str:
    """Tables for the terminal."""
    header = (
        "object", "noise", "method", "mm", "°", "all mm", "all °", "success", "ms", "determined",
    )  # fmt: skip
    lines = [
        (
            p.object_name, f"{100 * p.noise_relative:g} %", p.method, f"{1e3 * p.error_m:.2f}",
            f"{np.degrees(p.error_rad):.2f}", f"{1e3 * p.whole_m:.2f}",
            f"{np.degrees(p.whole_rad):.1f}", f"{p.success:.2f}", f"{p.total_ms:.1f}",
            f"{p.determined:.1f}",
        )
        for p in points(report.study)
    ]  # fmt: skip
    parts = [
        "Medians over the directions that the true contact determines, modulo symmetry; over all",
        table(header, lines),
        "",
        "On rubber, pressed by the exact model; starts 3 mm and 8° off; determined, then all seen",
        _rubber_table(report.rubber),
        "",
        target_table(targets(report)),
        *(_screw_line(screw) for screw in report.screws),
        *(f"left out: {line}" for line in [*report.study.omitted, *report.rubber.omitted]),
    ]
    return "\n".join(parts)


def _rubber_table(study: RubberStudy) -> str:
    header = (
        "object", "starts", "ok", "mm", "°", "seen mm", "worst", "seen °", "worst", "first ms",
        "next ms",
    )  # fmt: skip
    lines = []
    for name in dict.fromkeys(trial.object_name for trial in study.trials):
        own = [trial for trial in study.trials if trial.object_name == name]
        seen = np.array([[t.seen_m, t.seen_rad, t.error_m, t.error_rad] for t in own])
        seen *= [1e3, np.degrees(1.0), 1e3, np.degrees(1.0)]
        middle, worst = np.median(seen, axis=0), seen.max(axis=0)
        first, following = np.median([[t.first_ms, t.next_ms] for t in own], axis=0)
        ok = sum(t.status == "ok" for t in own)
        lines.append(
            (
                name, str(len(own)), str(ok), f"{middle[2]:.2f}", f"{middle[3]:.1f}",
                f"{middle[0]:.2f}", f"{worst[0]:.2f}", f"{middle[1]:.1f}", f"{worst[1]:.1f}",
                f"{first:.0f}", f"{following:.0f}",
            )
        )  # fmt: skip
    return table(header, lines)


def _screw_line(screw: Screw) -> str:
    status = ", ".join(f"{count} {name}" for name, count in screw.status.items())
    degrees = np.degrees(
        [
            screw.rotation_error_rad_median,
            screw.rotation_error_rad_max,
            screw.rotation_error_rad_late,
            screw.rotation_error_rad_end,
        ]
    )
    kind = f"screw{', 10 frames blank' if screw.blanked else ''}, seed {screw.seed}"
    return (
        f"{kind}: {status}; rotation off by {degrees[0]:.1f}° median, {degrees[1]:.1f}° at most, "
        f"{degrees[2]:.1f}° after the first second, {degrees[3]:.1f}° at the end; "
        f"{screw.median_total_ms:.1f} ms median"
    )


def write(report: PoseReport, folder: Path) -> list[Path]:
    """Write pose.csv, rubber.csv, pose.json and pose.png; the paths."""
    paths = [folder / name for name in FILES]
    write_csv(paths[0], report.study.trials)
    write_csv(paths[1], report.rubber.trials)
    write_json(paths[2], as_dict(report))
    _plot(report, paths[3])
    return paths


def _plot(report: PoseReport, path: Path) -> None:
    figure = Figure(figsize=(12, 5), layout="constrained")
    found = [p for p in points(report.study) if p.noise_relative == TARGET_NOISE]
    left, right = figure.subplots(1, 2)
    for axes, field, factor, unit, limit in (
        (left, "error_m", 1e3, "mm", 1.0),
        (right, "error_rad", np.degrees(1.0), "°", 2.0),
    ):
        for method in dict.fromkeys(p.method for p in found):
            own = [p for p in found if p.method == method]
            errors = [max(factor * getattr(p, field), 1e-3) for p in own]
            axes.scatter([p.total_ms for p in own], errors, s=30, alpha=0.8, label=method)
        axes.axhline(limit, color="tab:green", lw=0.8, label="target")
        axes.set(xlabel="depth image in → pose out, ms (median)", xscale="log", yscale="log")
        axes.set(ylabel=f"median error over determined directions, {unit}")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    figure.suptitle("Pose, 1 % noise, a point for each object")
    save_figure(figure, path)
