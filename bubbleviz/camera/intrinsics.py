"""Pinhole camera with lens distortion: pixels to rays and back."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, Literal
from weakref import WeakValueDictionary

import numpy as np

from bubbleviz.camera.image_errors import camera_shift

if TYPE_CHECKING:  # recordings start without the sensor file's validation
    from bubbleviz.result import Estimate
    from bubbleviz.sensor import Camera

_TOLERANCE = 1e-5  # of image-plane coordinates: the step that follows is exact to rounding

DistortionModel = Literal["none", "plumb_bob", "inverse_brown_conrady"]


@dataclass(frozen=True)
class Intrinsics:
    """Intrinsics of a depth camera, optical convention (+z along the view)."""

    # width, height: image size in pixels
    width: int
    height: int
    # fx, fy, cx, cy: focal lengths and principal point in pixels
    fx: float
    fy: float
    cx: float
    cy: float
    # `plumb_bob` distorts on projection (ROS, OpenCV); `inverse_brown_conrady` distorts on
    # deprojection (RealSense)
    distortion_model: DistortionModel = "none"
    distortion: tuple[float, ...] = ()  # k1, k2, p1, p2, k3; empty when there is none

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, pixels."""
        return self.width, self.height

    def slopes(self) -> np.ndarray:
        """Ideal image-plane coordinates (x/z, y/z) of every pixel centre, shape (H, W, 2)."""
        v, u = np.mgrid[0 : self.height, 0 : self.width].astype(np.float64)
        x, y = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        coefficients = self._coefficients()
        if self.distortion_model == "inverse_brown_conrady":
            x, y = _brown_conrady(x, y, coefficients)
        elif self.distortion_model == "plumb_bob":
            x, y = _undistort(x, y, coefficients)
        return np.stack([x, y], axis=-1)

    def rays(self) -> np.ndarray:
        """Unit ray directions r̂ in the camera frame C, shape (H, W, 3)."""
        slopes = self.slopes()
        rays = np.concatenate([slopes, np.ones_like(slopes[..., :1])], axis=-1)
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        return rays

    def project(self, points: np.ndarray) -> np.ndarray:
        """Pixel coordinates (u, v) of points (…, 3) in C; shape (…, 2)."""
        x, y = points[..., 0] / points[..., 2], points[..., 1] / points[..., 2]
        coefficients = self._coefficients()
        if self.distortion_model == "plumb_bob":
            x, y = _brown_conrady(x, y, coefficients)
        elif self.distortion_model == "inverse_brown_conrady":
            x, y = _undistort(x, y, coefficients)
        return np.stack([x * self.fx + self.cx, y * self.fy + self.cy], axis=-1)

    def projection(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixel coordinates of points (k, 3) in C, (k, 2), and their derivative, (k, 2, 3), 1/m."""
        pixels, depth = self.project(points), points[:, 2]
        ideal = points[:, :2] / depth[:, None]
        x, y = ideal.T
        if self.distortion_model == "inverse_brown_conrady":
            x, y = ((pixels - [self.cx, self.cy]) / [self.fx, self.fy]).T
        xx, xy, yy = _brown_conrady_slopes(x, y, self._coefficients())
        if self.distortion_model == "inverse_brown_conrady":
            determinant = xx * yy - xy * xy
            xx, xy, yy = yy / determinant, -xy / determinant, xx / determinant
        by_point = np.empty((len(points), 2, 3))
        by_point[:, 0, 0], by_point[:, 0, 1] = self.fx * xx / depth, self.fx * xy / depth
        by_point[:, 1, 0], by_point[:, 1, 1] = self.fy * xy / depth, self.fy * yy / depth
        by_point[:, :, 2] = -np.einsum("kij,kj->ki", by_point[:, :, :2], ideal)
        return pixels, by_point

    def _coefficients(self) -> tuple[float, float, float, float, float]:
        known = () if self.distortion_model == "none" else self.distortion
        k1, k2, p1, p2, k3 = (*known, 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
        return k1, k2, p1, p2, k3


def _brown_conrady(
    x: np.ndarray, y: np.ndarray, coefficients: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Radial and tangential polynomial of Brown and Conrady (OpenCV, librealsense)."""
    k1, k2, p1, p2, k3 = coefficients
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return (
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y),
    )


def _brown_conrady_slopes(
    x: np.ndarray, y: np.ndarray, coefficients: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """∂x'/∂x, ∂x'/∂y = ∂y'/∂x and ∂y'/∂y of `_brown_conrady`."""
    k1, k2, p1, p2, k3 = coefficients
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * k3 * r2))
    return (
        radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x,
        slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y,
        radial + slope * y * y + 2.0 * p2 * x + 6.0 * p1 * y,
    )


def _undistort(
    x: np.ndarray, y: np.ndarray, coefficients: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Inverse of `_brown_conrady` by Newton's method, from the distorted point itself."""
    x0, y0 = x, y
    for _ in range(10):  # more than any lens needs
        xx, xy, yy = _brown_conrady_slopes(x, y, coefficients)
        xd, yd = _brown_conrady(x, y, coefficients)
        ex, ey = x0 - xd, y0 - yd
        determinant = xx * yy - xy * xy
        x = x + (yy * ex - xy * ey) / determinant
        y = y + (xx * ey - xy * ex) / determinant
        if max(np.abs(ex).max(initial=0.0), np.abs(ey).max(initial=0.0)) < _TOLERANCE:
            break
    return x, y


# A depth camera in the bubble frame: z-depth images, range images and points.


_DIRECTIONS = WeakValueDictionary[tuple[Intrinsics, bytes], np.ndarray]()
"""Rays by intrinsics and rotation: every model of a sensor has a camera, and 7 MB of them."""


class DepthCamera:
    """Intrinsics with the camera's pose in the bubble frame B."""

    def __init__(
        self,
        intrinsics: Intrinsics,
        T_B_C: np.ndarray,  # (4, 4), pose of the camera (optical convention) in B
    ) -> None:
        self.intrinsics = intrinsics
        self.T_B_C = T_B_C

    @classmethod
    def of(cls, camera: Camera, intrinsics: Intrinsics | None = None) -> DepthCamera:
        """Camera of a sensor file, with a recording's intrinsics where it has them."""
        own = {each.name: getattr(camera, each.name) for each in fields(Intrinsics)}
        return cls(intrinsics or Intrinsics(**own), camera.T_B_C)

    def shifted(self, shift_m: np.ndarray) -> DepthCamera:
        """The camera moved in B by (3,), m, with the rays of this one."""
        T_B_C = self.T_B_C.copy()
        T_B_C[:3, 3] += shift_m
        moved = DepthCamera(self.intrinsics, T_B_C)
        moved.range_per_depth = self.range_per_depth
        return moved

    def displaced(self, estimate: Estimate | None) -> DepthCamera:
        """The camera where an estimate says that it is, as it may have been moved."""
        errors = None if estimate is None else estimate.image_errors
        shift_m = np.zeros(2) if errors is None else camera_shift(errors.mean)
        return self.shifted(self.T_B_C[:3, :2] @ shift_m) if shift_m.any() else self

    @property
    def center(self) -> np.ndarray:
        """Camera centre c in B, shape (3,), m."""
        return self.T_B_C[:3, 3]

    @cached_property
    def directions(self) -> np.ndarray:
        """Unit rays r̂ in B, row-major over pixels, shape (H·W, 3)."""
        turn = self.T_B_C[:3, :3]
        key = self.intrinsics, turn.tobytes()
        directions = _DIRECTIONS.get(key)
        if directions is None:
            _DIRECTIONS[key] = directions = self.intrinsics.rays().reshape(-1, 3) @ turn.T
            directions.setflags(write=False)  # cameras share it
        return directions

    @cached_property
    def range_per_depth(self) -> np.ndarray:
        """Range along the ray per z-depth, ≥ 1, shape (H, W), float32."""
        along_axis = self.directions @ self.T_B_C[:3, 2]
        shape = (self.intrinsics.height, self.intrinsics.width)
        return (1.0 / along_axis).reshape(shape).astype(np.float32)

    def local(self, points_m: np.ndarray) -> np.ndarray:
        """Points (…, 3) in B in the camera frame C, m."""
        return (points_m - self.center) @ self.T_B_C[:3, :3]

    def project(self, points_m: np.ndarray) -> np.ndarray:
        """Pixel coordinates (u, v) of points (…, 3) in B; shape (…, 2)."""
        return self.intrinsics.project(self.local(points_m))

    def range_image(self, depth_m: np.ndarray) -> np.ndarray:
        """Range in m of a z-depth image (H, W)."""
        return depth_m * self.range_per_depth

    def depth_image(self, range_m: np.ndarray) -> np.ndarray:
        """z-depth in m of a range image (H, W)."""
        return range_m / self.range_per_depth

    def points(self, depth_m: np.ndarray, pixels: np.ndarray) -> np.ndarray:
        """Points in B of the pixels with the given flat indices (k,); shape (k, 3), m."""
        ranges = depth_m.ravel()[pixels] * self.range_per_depth.ravel()[pixels]
        return self.center + ranges[:, None] * self.directions[pixels]

    def points_at(self, range_m: np.ndarray, pixels: np.ndarray) -> np.ndarray:
        """Points in B by a range image (H, W) instead of a depth image, m."""
        return self.center + range_m.ravel()[pixels, None] * self.directions[pixels]
