"""Pose files: POSES.csv and TUM trajectories."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from bubbleviz.errors import InputError
from bubbleviz.files import COLUMNS, pose_numbers, read_rows, whole_file, write_rows
from bubbleviz.result import Result

PoseRow = dict[str, Any]
"""One line of POSES.csv by column."""
_AXES = ("x", "y", "z", "rx", "ry", "rz")
_COVARIANCES = tuple(
    (f"cov_{first}{second}", i, j)
    for i, first in enumerate(_AXES)
    for j, second in enumerate(_AXES)
    if i <= j
)
"""Columns of the upper triangle of the covariance of position, m, and rotation vector in B, rad."""
_AREAS = ("patch_area_m2", "object_patch_area_m2")


def pose_row(result: Result) -> PoseRow:
    """Line of a frame with the product `pose`; NaN for unknown values.

    A `lost` frame has the last good pose.
    """
    if result.pose is None:
        raise ValueError('the result has no pose; process frames with the product "pose"')
    pose, patch, by_object = result.pose, result.trusted_patch, result.object_patch
    one, two = pose.stage_one, pose.stage_two
    known = np.isfinite(pose.T_B_O).all()
    numbers = pose_numbers(pose.T_B_O) if known else (np.nan,) * 7
    covariance = pose.covariance
    return {
        "frame": result.frame.index,
        "time_s": result.frame.time_s,
        "status": pose.status,
        **dict(zip(COLUMNS, numbers, strict=True)),
        "fitness": two.fitness if two else np.nan,
        "rmse_m": two.rmse_m if two else np.nan,
        "stage1_rmse_m": one.rmse_m if one else np.nan,
        "total_ms": result.times_ms["total"],
        **{name: covariance[i, j] for name, i, j in _COVARIANCES},
        "patch_area_m2": patch.area_m2 if patch else np.nan,
        "object_patch_area_m2": by_object.area_m2 if by_object else np.nan,
    }


def write_poses(
    path: Path, rows: Iterable[PoseRow], form: Literal["csv", "tum"], *, overwrite: bool = False
) -> int:
    """Write POSES.csv, or a TUM trajectory of the `ok` frames; returns the number of lines.

    The CSV has the two patch areas if any frame has an object patch. A TUM line is
    `time x y z qx qy qz qw`, s and m.

    Raises InputError: the file exists or cannot be written.
    """
    rows = list(rows)
    with whole_file(path, overwrite=overwrite) as temporary:
        if form == "csv":
            areas = any(np.isfinite(row["object_patch_area_m2"]) for row in rows)
            omitted = () if areas else _AREAS
            write_rows(temporary, [{k: v for k, v in r.items() if k not in omitted} for r in rows])
            return len(rows)
        good = [row for row in rows if row["status"] == "ok"]
        lines = [" ".join(f"{row[name]:.9g}" for name in ("time_s", *COLUMNS)) for row in good]
        temporary.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
        return len(lines)


# POSES.csv of `bubbleviz pose` as additional columns of a table.


_QUALITY = ("fitness", "rmse_m", "object_patch_area_m2")


def read_poses(path: str | Path) -> dict[int, dict[str, Any]]:
    """Columns `pose_…` by frame index: status, T_B_O as position in m and quaternion, quality.

    Raises InputError: no file of poses, or an invalid line.
    """
    path = Path(path)
    poses = {}
    for line, row in enumerate(read_rows(path, ("frame", "status", *COLUMNS)), 2):
        try:
            poses[int(row["frame"])] = pose_columns(row)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"{path}: line {line}: a value is missing or not a number ({error}); correct it"
            ) from None
    return poses


def pose_columns(row: Mapping[str, Any]) -> dict[str, Any]:
    """Columns of one frame from the fields of a line of POSES.csv; NaN for empty fields."""
    names = (*COLUMNS, *(name for name in _QUALITY if name in row))
    known = {name: row[name] for name in names if row[name] not in (None, "")}
    numbers = {f"pose_{name}": float(known.get(name, "nan")) for name in names}
    return {"pose_status": row["status"], **numbers}
