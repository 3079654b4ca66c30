"""Small rigid motions about a centre: six numbers, translation in m before rotation in rad."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation


def moved(T: np.ndarray, motion: np.ndarray, center: np.ndarray) -> np.ndarray:
    """Pose T (4, 4) after a motion (6,) in B: turned about the centre (3,), then shifted."""
    R = Rotation.from_rotvec(motion[3:]).as_matrix()
    result = np.eye(4)
    result[:3, :3] = R @ T[:3, :3]
    result[:3, 3] = center + motion[:3] + R @ (T[:3, 3] - center)
    return result


def motion_between(start: np.ndarray, end: np.ndarray, center: np.ndarray) -> np.ndarray:
    """Motion (6,) in B about the centre that takes pose `start` to pose `end`, both (4, 4)."""
    R = end[:3, :3] @ start[:3, :3].T
    shift = end[:3, 3] - center - R @ (start[:3, 3] - center)
    return np.concatenate([shift, Rotation.from_matrix(R, assume_valid=True).as_rotvec()])


def about(center: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Matrix (6, 6) that turns a small motion about `center` into the same one about `other`."""
    x, y, z = other - center
    change = np.eye(6)
    change[:3, 3:] = -np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return change


def rows(directions: np.ndarray, points: np.ndarray, center: np.ndarray) -> np.ndarray:
    """Derivative (k, 6) of points' ways along unit directions by a motion of the points, (k, 3)."""
    result = np.empty((len(points), 6))
    result[:, :3] = directions
    x, y, z = (points - center).T
    a, b, c = directions.T
    result[:, 3], result[:, 4], result[:, 5] = y * c - z * b, z * a - x * c, x * b - y * a
    return result


def way_at(radius_m: float, motion: np.ndarray) -> float:
    """Way in m that a motion (6,) takes places at some radius around its centre, at most."""
    return float(np.linalg.norm(motion[:3]) + radius_m * np.linalg.norm(motion[3:]))
