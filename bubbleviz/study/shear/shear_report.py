"""What a shear study shows: table, targets, CSV and JSON."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from bubbleviz.files.tables import table, write_csv, write_json
from bubbleviz.study.report_files import Target, at_least, at_most, target_table
from bubbleviz.study.shear.flow_presets import PresetScore
from bubbleviz.study.shear.shear_study import ShearTrial

FILES = ("shear.csv", "flow_presets.csv", "shear.json")
TARGET_NOISE_PX = 0.03
_HEADER = (
    "object", "μ", "drag mm", "twist °", "flow px", "depth alone", "force %", "angle °", "torque %",
    "displ. mm", "depth's centre mm", "centre mm", "slip %", "true %", "traction ms",
)  # fmt: skip
_PRESET_HEADER = ("flow", "flow error px", "force %, worst", "flow ms")


def targets(trials: list[ShearTrial]) -> list[Target]:
    """Worst frames at the target's noise, and whether that will do."""
    some = [trial for trial in trials if trial.flow_sigma_px == TARGET_NOISE_PX]
    solved = [trial for trial in some if trial.status == "ok"]
    alarms = [t.slip > 0.0 for t in some if np.isfinite(t.slip) and np.isnan(t.friction)]
    return [
        at_least("share of frames solved", len(solved) / max(1, len(some)), 1.0),
        at_most("force error, %", 100.0 * _worst(t.force_error for t in solved), 3.0),
        at_most("force angle, °", np.degrees(_worst(t.angle_rad for t in solved)), 3.0),
        at_most("torque error, %", 100.0 * _worst(t.torque_error for t in solved), 5.0),
        at_most("displacement, mm", 1e3 * _worst(t.displacement_rms_m for t in solved), 0.05),
        at_most("centre, mm", 1e3 * _worst(t.center_error_m for t in solved), 1.0),
        at_most("false slip, share of frames", float(np.mean(alarms)) if alarms else np.nan, 0.05),
        at_most("traction, ms of processor", _median(t.traction_ms for t in solved), 15.0),
    ]


def _worst(values: Iterable[float]) -> float:
    finite = [value for value in values if np.isfinite(value)]
    return max(finite, default=np.nan)


def _median(values: Iterable[float]) -> float:
    return float(np.median(list(values) or [np.nan]))


def as_dict(trials: list[ShearTrial], presets: list[PresetScore]) -> dict[str, Any]:
    """Every frame, the targets and the presets of the flow, SI units."""
    return {
        "targets": [asdict(target) for target in targets(trials)],
        "trials": [asdict(trial) for trial in trials],
        "flow_presets": [asdict(preset) for preset in presets],
    }


def to_text(trials: list[ShearTrial], presets: list[PresetScore]) -> str:
    """Tables for the terminal."""
    rows = [
        (
            t.object_name,
            "sticks" if np.isnan(t.friction) else f"{t.friction:g}",
            f"{1e3 * t.drag_m:.1f}",
            f"{np.degrees(t.twist_rad):.0f}",
            f"{t.flow_sigma_px:g}",
            f"{100.0 * t.depth_force_error:.0f} %" if t.depth_status == "ok" else t.depth_status,
            f"{100.0 * t.force_error:.1f}" if t.status == "ok" else t.status,
            f"{np.degrees(t.angle_rad):.2f}",
            f"{100.0 * t.torque_error:.1f}",
            f"{1e3 * t.displacement_rms_m:.3f}",
            f"{1e3 * t.depth_center_error_m:.1f}",
            f"{1e3 * t.center_error_m:.2f}",
            f"{100.0 * t.slip:.0f}",
            f"{100.0 * t.true_slip:.0f}",
            f"{t.traction_ms:.0f}",
        )
        for t in trials
    ]
    tables = table(_HEADER, rows), _preset_table(presets), target_table(targets(trials))
    return "\n\n".join(tables)


def _preset_table(presets: list[PresetScore]) -> str:
    rows = [
        (
            p.preset,
            f"{p.flow_rms_px:.3f}",
            f"{100.0 * p.force_error:.1f}" if p.solved == 1.0 else f"{p.solved:.0%} solved",
            f"{p.flow_ms:.0f}",
        )
        for p in presets
    ]
    return table(_PRESET_HEADER, rows)


def write(trials: list[ShearTrial], presets: list[PresetScore], folder: Path) -> list[Path]:
    """Files of the report; the folder is there."""
    written = [folder / name for name in FILES]
    write_csv(written[0], trials)
    write_csv(written[1], presets)
    write_json(written[2], as_dict(trials, presets))
    return written
