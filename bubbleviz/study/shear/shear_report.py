"""What a shear study shows: table, targets, CSV and JSON."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bubbleviz.files.tables import table, write_csv, write_json
from bubbleviz.study.report_files import Target, at_least, at_most, target_table
from bubbleviz.study.shear.flow_presets import PresetScore
from bubbleviz.study.shear.shear_study import ShearTrial
from bubbleviz.study.shear.slip_study import EXACT, SlipTrial

FILES = ("shear.csv", "slip.csv", "flow_presets.csv", "shear.json")
TARGET_NOISE_PX = 0.03
_HEADER = (
    "object", "μ", "drag mm", "twist °", "flow px", "depth alone", "force %", "angle °", "torque %",
    "displ. mm", "depth's centre mm", "centre mm", "slip %", "true %", "traction ms",
)  # fmt: skip
_SLIP_HEADER = ("contact's radius mm", "flow", "points", "false alarms", "found in frame")
_PRESET_HEADER = ("flow", "flow error px", "force %, worst", "flow ms")


@dataclass(frozen=True)
class ShearStudy:
    """What a study found.

    Attributes
    ----------
    trials : list of ShearTrial
    slips : list of SlipTrial
    presets : list of PresetScore
    """

    trials: list[ShearTrial]
    slips: list[SlipTrial]
    presets: list[PresetScore]


def targets(study: ShearStudy) -> list[Target]:
    """Worst frames at the target's noise, and whether that will do."""
    some = [trial for trial in study.trials if trial.flow_sigma_px == TARGET_NOISE_PX]
    solved = [trial for trial in some if trial.status == "ok"]
    sticking = [t.slip > 0.0 for t in some if np.isfinite(t.slip) and np.isnan(t.friction)]
    judged = sum(t.judged for t in study.slips)
    alarms = sum(t.alarms for t in study.slips) / judged if judged else np.nan
    found_in = [t.found_in for t in study.slips if t.flow == EXACT]
    latest = max(np.nan_to_num(found_in, nan=np.inf), default=np.nan)
    return [
        at_least("share of frames solved", len(solved) / max(1, len(some)), 1.0),
        at_most("force error, %", 100.0 * _worst(t.force_error for t in solved), 3.0),
        at_most("force angle, °", np.degrees(_worst(t.angle_rad for t in solved)), 3.0),
        at_most("torque error, %", 100.0 * _worst(t.torque_error for t in solved), 5.0),
        at_most("displacement, mm", 1e3 * _worst(t.displacement_rms_m for t in solved), 0.05),
        at_most("centre, mm", 1e3 * _worst(t.center_error_m for t in solved), 1.0),
        at_most(
            "false slip, share of frames", float(np.mean(sticking)) if sticking else np.nan, 0.05
        ),
        at_most("false slip by contact size, share of frames", alarms, 0.05),
        at_most("slip found, frame", latest, 2.0),
        at_most("traction, ms of processor", _median(t.traction_ms for t in solved), 15.0),
    ]


def _worst(values: Iterable[float]) -> float:
    finite = [value for value in values if np.isfinite(value)]
    return max(finite, default=np.nan)


def _median(values: Iterable[float]) -> float:
    return float(np.median(list(values) or [np.nan]))


def as_dict(study: ShearStudy) -> dict[str, Any]:
    """Every frame, the targets, slip and the presets of the flow, SI units."""
    return {
        "targets": [asdict(target) for target in targets(study)],
        "trials": [asdict(trial) for trial in study.trials],
        "slips": [asdict(slip) for slip in study.slips],
        "flow_presets": [asdict(preset) for preset in study.presets],
    }


def to_text(study: ShearStudy) -> str:
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
        for t in study.trials
    ]
    tables = table(_HEADER, rows), _slip_table(study.slips), _preset_table(study.presets)
    return "\n\n".join((*tables, target_table(targets(study))))


def _slip_table(slips: list[SlipTrial]) -> str:
    rows = [
        (
            f"{1e3 * s.radius_m:.1f}",
            s.flow,
            str(s.points),
            f"{s.alarms} of {s.judged}",
            f"{s.found_in:.0f}" if np.isfinite(s.found_in) else "none",
        )
        for s in slips
    ]
    return table(_SLIP_HEADER, rows)


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


def write(study: ShearStudy, folder: Path) -> list[Path]:
    """Files of the report; the folder is there."""
    written = [folder / name for name in FILES]
    write_csv(written[0], study.trials)
    write_csv(written[1], study.slips)
    write_csv(written[2], study.presets)
    write_json(written[3], as_dict(study))
    return written
