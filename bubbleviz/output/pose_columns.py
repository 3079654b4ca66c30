"""POSES.csv of `bubbleviz pose` as more columns of a table."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bubbleviz.errors import InputError
from bubbleviz.files.pose_reader import COLUMNS, read_rows

_QUALITY = ("fitness", "rmse_m", "object_patch_area_m2")


def read_poses(path: str | Path) -> dict[int, dict[str, Any]]:
    """Columns `pose_…` by frame index: status, T_B_O as position in m and quaternion, quality.

    Raises
    ------
    InputError
        Names the file and the line.
    """
    path = Path(path)
    rows = read_rows(path)
    needed = ("frame", "status", *COLUMNS)
    missing = [name for name in needed if not rows or name not in rows[0]]
    if missing:
        raise InputError(f"{path}: no column {missing[0]}; give the CSV of bubbleviz pose")
    poses = {}
    for line, row in enumerate(rows, 2):
        try:
            poses[int(row["frame"])] = pose_columns(row)
        except (TypeError, ValueError) as error:
            raise InputError(f"{path}: line {line}: {error}; correct it") from None
    return poses


def pose_columns(row: Mapping[str, Any]) -> dict[str, Any]:
    """Columns of one frame from the fields of a line of POSES.csv; what is empty is not known."""
    names = (*COLUMNS, *(name for name in _QUALITY if name in row))
    known = {name: row[name] for name in names if row[name] not in (None, "")}
    numbers = {f"pose_{name}": float(known.get(name, "nan")) for name in names}
    return {"pose_status": row["status"], **numbers}
