"""Poses as text: one on the command line, a sequence in a CSV file."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from bubbleviz.errors import InputError
from bubbleviz.files.reading import as_input_error

COLUMNS = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
_MAX_DISTANCE_M = 2.0  # larger numbers are in millimetres
_MAX_TIME_S = 2.0**31  # s since 1970, limited by stamps of messages


def parse_pose(text: str) -> np.ndarray:
    """4×4 transform from "x y z qx qy qz qw" (m, quaternion xyzw of unit length)."""
    words = text.replace(",", " ").split()
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) != 7:
        raise InputError(
            f'pose "{text}": give seven numbers, x y z in m and the unit quaternion qx qy qz qw'
        )
    try:
        return pose_matrix(np.array(numbers))
    except InputError as error:
        raise InputError(f'pose "{text}": {error}') from None


def pose_matrix(numbers: np.ndarray) -> np.ndarray:
    """4×4 transform from x, y, z in m and a unit quaternion xyzw, shape (7,)."""
    position, quaternion = numbers[:3], numbers[3:]
    if not np.isfinite(numbers).all():
        raise InputError("a number is missing or not finite; correct it")
    if not is_unit(quaternion):
        raise InputError(
            "the quaternion qx qy qz qw is not of unit length; divide it by its length, or give "
            "0 0 0 1 for no rotation"
        )
    return checked_pose(transform(position, quaternion))


def checked_pose(T: np.ndarray) -> np.ndarray:
    """Pose as a 4×4 float array. Raises InputError: it is not a rigid transform in metres."""
    pose = np.asarray(T, dtype=np.float64)
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise InputError("the pose is not a finite 4×4 matrix; give a rigid transform")
    R = pose[:3, :3]
    if np.abs(R @ R.T - np.eye(3)).max() > 1e-6 or np.linalg.det(R) < 0.0:
        raise InputError("the pose's 3×3 part is not a rotation; give a rigid transform")
    if np.abs(pose[:3, 3]).max() > _MAX_DISTANCE_M:
        raise InputError("a coordinate is beyond ±2 m; give x y z in metres, not millimetres")
    return pose


def transform(
    position_m: Sequence[float] | np.ndarray, quaternion_xyzw: Sequence[float] | np.ndarray
) -> np.ndarray:
    """4×4 transform of a position and a quaternion."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(quaternion_xyzw).as_matrix()
    T[:3, 3] = position_m
    return T


def is_unit(quaternion: Sequence[float] | np.ndarray) -> bool:
    """Whether four numbers have unit length; safe from overflow."""
    return bool(np.abs(quaternion).max() < 2.0 and abs(np.linalg.norm(quaternion) - 1.0) <= 1e-3)


def pose_numbers(T: np.ndarray) -> tuple[float, float, float, float, float, float, float]:
    """x, y, z in m and the unit quaternion xyzw of a transform (4, 4)."""
    x, y, z = (float(v) for v in T[:3, 3])
    qx, qy, qz, qw = (float(q) for q in Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True))
    return x, y, z, qx, qy, qz, qw


def pose_of_angles(position_m: np.ndarray, angles_rad: np.ndarray) -> np.ndarray:
    """4×4 transform from a position (3,) and extrinsic xyz Euler angles (3,)."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", angles_rad).as_matrix()
    T[:3, 3] = position_m
    return T


def angles_of_pose(T: np.ndarray) -> np.ndarray:
    """Extrinsic xyz Euler angles (3,), rad, of a transform (4, 4)."""
    return Rotation.from_matrix(T[:3, :3]).as_euler("xyz")


def read_path(path: str | Path) -> tuple[np.ndarray, np.ndarray | None]:
    """Poses (F, 4, 4) and, if the file has them, times (F,) in s.

    Reads the columns x_m, y_m, z_m, qx, qy, qz, qw and time_s; others are ignored.

    Raises InputError: a missing column or an invalid line.
    """
    path = Path(path)
    rows = read_rows(path, COLUMNS)
    poses = np.empty((len(rows), 4, 4))
    for k, row in enumerate(rows):
        try:
            poses[k] = pose_matrix(np.array([float(row[name] or "nan") for name in COLUMNS]))
        except InputError as error:
            raise InputError(f"{path}: line {k + 2}: {error}") from None
        except ValueError as error:
            raise InputError(f"{path}: line {k + 2}: {error}; correct it") from None
    return poses, _times(path, rows)


def read_rows(path: Path, needed: Sequence[str]) -> list[dict[str, str]]:
    """Lines of a CSV file of poses, one or more, by the names in its header.

    Raises InputError: it cannot be read as CSV, or lacks a column that is needed.
    """
    with (
        as_input_error(path, "the CSV file", "correct the file or its path"),
        path.open(newline="", encoding="utf-8-sig") as file,
    ):
        rows = list(csv.DictReader(file))
    if not rows:
        raise InputError(f"{path}: no poses; give a line for each frame below the header")
    for name in needed:
        if name not in rows[0]:
            raise InputError(
                f"{path}: no column {name}; add it, as the header needs {','.join(needed)}"
            )
    return rows


def _times(path: Path, rows: list[dict[str, str]]) -> np.ndarray | None:
    if "time_s" not in rows[0]:
        return None
    try:
        times = np.array([float(row["time_s"] or "nan") for row in rows])
    except ValueError as error:
        raise InputError(f"{path}: time_s: {error}; give times in s") from None
    if not (np.abs(times) < _MAX_TIME_S).all():
        raise InputError(
            f"{path}: time_s: a time is missing, not finite or beyond 2³¹ s; give s since 1970 or "
            "since the start"
        )
    if not (np.diff(times) > 0.0).all():
        raise InputError(f"{path}: time_s does not increase from line to line; correct it")
    return times - times[0]
