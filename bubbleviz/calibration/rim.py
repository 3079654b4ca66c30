"""Rim of the sensor file against the edge of the measured membrane: height, tilt and size."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import stdtrit

from bubbleviz.calibration.ellipsoid import Ellipsoid
from bubbleviz.camera import DepthCamera
from bubbleviz.recordings import robust_sigma, tukey_weights
from bubbleviz.result import HALF_95

_DRAWN_SIGMA_M = 0.5e-3 / np.sqrt(3.0)
"""σ of the sensor file's rim: uniform distribution over ± half a millimetre of a ruler, on which
the edge of a clamp is hardly better defined."""
_STEPS, _LARGEST_STEP, _TOLERANCE = 50, 0.1, 1e-4
"""Gauss–Newton steps and their limits; relative. The last is far below `_DRAWN_SIGMA_M`."""
_FEWEST = 10  # points that determine the plane of an edge, which has some hundred; chosen
_IN_PLANE = 0.8  # least share of the edge in a plane, within the error of a drawn rim; chosen
_DIFFERENCE = 1e-6  # for the derivatives; far above the rounding of doubles


def rim_height(
    edge_heights_m: np.ndarray,  # (k,), heights of the edge's points along the dome's axis, m
) -> tuple[float, float]:
    """Height of the rim and its uncertainty, m, from heights of the cloud's outer edge.

    Some points of the edge lie on the rim, all at one height; where depth ends early, others lie
    above it. So the rim is the mode of the heights (repeated selection of the densest half). The
    uncertainty is half the width of the densest quarter.
    """
    heights = np.sort(edge_heights_m[np.isfinite(edge_heights_m)])
    if not len(heights):
        return float("nan"), float("nan")
    spread = 0.5 * float(np.ptp(_densest(heights, max(2, len(heights) // 4))))
    while len(heights) > 3:
        heights = _densest(heights, (len(heights) + 1) // 2)
    return float(heights.mean()), spread


def _densest(ordered: np.ndarray, count: int) -> np.ndarray:
    """The `count` consecutive values of a sorted array with the smallest range."""
    count = min(count, len(ordered))
    spans = ordered[count - 1 :] - ordered[: len(ordered) - count + 1]
    start = int(np.argmin(spans))
    return ordered[start : start + count]


class RimPlane(NamedTuple):
    """Plane through the outer edge of the cloud."""

    tilt_rad: float  # against the rim plane z = 0 of the sensor file
    sigma_rad: float  # of the tilt
    T_B_C: np.ndarray  # (4, 4), pose of the camera at which the edge lies in the rim plane


def rim_plane(
    edge_m: np.ndarray,  # (k, 3), points of the cloud's outer edge in B, m
    centre_m: np.ndarray,  # (3,), of a sphere or ellipsoid fitted to the cloud, in B, m
    camera: DepthCamera,  # at the sensor file's pose
) -> RimPlane | None:
    """Robust plane through the edge; None: a fifth of it or more is not in one plane.

    Depth that ends early, at the border of the image or at an obstacle, has no edge in a plane.
    The pose keeps the turn about z, which a round rim does not determine.
    """
    if len(edge_m) < _FEWEST:
        return None
    middle = edge_m.mean(axis=0) * (1.0, 1.0, 0.0)
    sides = edge_m - middle
    sides[:, 2] = 1.0
    weights = np.ones(len(edge_m))
    for _ in range(_STEPS):
        root = np.sqrt(weights)
        plane = np.linalg.lstsq(root[:, None] * sides, root * edge_m[:, 2], rcond=None)[0]
        left = edge_m[:, 2] - sides @ plane
        weights = tukey_weights(left, max(robust_sigma(left, center=0.0), _DIFFERENCE))
    narrow = float(np.linalg.eigvalsh(np.cov(edge_m[:, :2].T))[0])  # 0 or less: a line
    if not narrow > _DRAWN_SIGMA_M**2 or np.mean(np.abs(left) < 2.0 * _DRAWN_SIGMA_M) < _IN_PLANE:
        return None
    normal = np.array([-plane[0], -plane[1], 1.0]) / np.hypot(1.0, np.hypot(*plane[:2]))
    turn = Rotation.align_vectors([[0.0, 0.0, 1.0]], [normal])[0]
    # The axis of B goes through the centre, and its origin is where it meets the plane.
    origin = turn.apply(centre_m)
    origin[2] = turn.apply(middle)[2] + plane[2] * normal[2]
    pose = np.eye(4)
    pose[:3, :3] = turn.as_matrix() @ camera.T_B_C[:3, :3]
    pose[:3, 3] = turn.apply(camera.center) - origin
    return RimPlane(float(np.arccos(normal[2])), _DRAWN_SIGMA_M / float(np.sqrt(narrow)), pose)


def lateral_scale(
    edge_m: np.ndarray,  # (k, 3), points of the cloud's outer edge in B, m
    rim_m: np.ndarray,  # (r, 3), points of the sensor file's rim in B, m
    camera: DepthCamera,  # at the sensor file's pose
    cap: Ellipsoid,  # fitted to the cloud, in B
) -> tuple[np.ndarray, np.ndarray] | None:
    """Size of the sensor file's rim over that in the image along image x and y, and its σ; (2,).

    A focal length is too large by its scale, as depth shows neither. Neighbouring points of the
    edge err together, and how many do is unknown, so the σ of the fit to all of them is as large as
    if only one were independent. None: the edge does not determine both scales.

    Where the edge is above the rim, either depth ends early, and the rim is where the cap continues
    to its plane, or the camera's pose is wrong, and the edge is the rim. The scale is uniform
    between both.
    """
    height = edge_m[:, 2:]
    continued = cap.centre_m + (edge_m - cap.centre_m) * (_width(cap, 0.0) / _width(cap, height))
    continued[:, 2:] = height
    first, other = (
        _RimFit(points, rim_m, camera).found(cap.centre_m[:2]) for points in (edge_m, continued)
    )
    if first is None or other is None:
        return None
    (size, variance), (other_size, other_variance) = first, other
    of_height = (size - other_size) ** 2 / 12.0
    drawn = _DRAWN_SIGMA_M / np.hypot(rim_m[:, 0], rim_m[:, 1]).mean()
    relative = np.sqrt(np.maximum(variance, other_variance) + of_height + drawn**2)
    scale = np.exp(0.5 * (size + other_size))
    return scale, scale * relative


def _width(cap: Ellipsoid, height_m: float | np.ndarray) -> np.ndarray:
    """Width of a cap at heights over its largest one; at its top and above, a tenth."""
    above = (height_m - cap.centre_m[2]) / cap.semi_axes_m[2]
    return np.asarray(np.sqrt(np.maximum(1.0 - above**2, 0.01)))


class _RimFit:
    """Robust least squares of the rim's size and centre to the edge of the cloud.

    Values: logarithms of the scales along image x and y, and the centre (x, y) in mean radii.
    """

    def __init__(self, edge_m: np.ndarray, rim_m: np.ndarray, camera: DepthCamera) -> None:
        self._camera, self._local = camera, camera.local(edge_m)
        angle, radius = np.arctan2(rim_m[:, 1], rim_m[:, 0]), np.hypot(rim_m[:, 0], rim_m[:, 1])
        order = np.argsort(angle)
        self._angle, self._radius = angle[order], radius[order]
        self._size_m = float(radius.mean())

    def found(self, centre_m: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Logarithms of the scales (2,) and their variances (2,); None: not determined."""
        values = np.concatenate([np.zeros(2), centre_m / self._size_m])
        for _ in range(_STEPS):
            left, J = self._beyond(values), self._derivatives(values)
            weights = tukey_weights(left, max(robust_sigma(left, center=0.0), _DIFFERENCE))
            freedom = float(weights.sum()) - len(values)
            normal = J.T * weights @ J
            if freedom <= 0.0 or np.linalg.matrix_rank(normal) < len(values):
                return None
            step = np.linalg.solve(normal, J.T @ (weights * left))
            size = float(np.abs(step).max())
            values = values - step * min(1.0, _LARGEST_STEP / max(size, _TOLERANCE))
            if size < _TOLERANCE:
                single = weights @ left**2 / freedom * (stdtrit(freedom, 0.975) / HALF_95) ** 2
                variance = single * weights.sum() * np.diag(np.linalg.inv(normal))
                return values[:2], variance[:2]
        return None

    def _beyond(self, values: np.ndarray) -> np.ndarray:
        """Distance of the edge from the rim over the radius, (k,), as long as before scaling.

        The scaled distance would vanish with the scale.
        """
        turn = self._camera.T_B_C[:3, :3].T
        scaled = self._camera.center + self._local * (*np.exp(values[:2]), 1.0) @ turn
        x, y = (scaled[:, :2] - values[2:] * self._size_m).T
        radius = np.interp(np.arctan2(y, x), self._angle, self._radius, period=2.0 * np.pi)
        return np.asarray((np.hypot(x, y) / radius - 1.0) * np.exp(-values[:2].mean()))

    def _derivatives(self, values: np.ndarray) -> np.ndarray:
        steps = _DIFFERENCE * np.eye(len(values))
        ends = [self._beyond(values + step) - self._beyond(values - step) for step in steps]
        return np.stack(ends, axis=1) / (2.0 * _DIFFERENCE)
