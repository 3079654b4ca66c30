"""A depth camera in the bubble frame: z-depth images, range images and points."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from bubbleviz.camera.intrinsics import Intrinsics
from bubbleviz.sensor import Camera


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
        own = Intrinsics(
            camera.width,
            camera.height,
            camera.fx,
            camera.fy,
            camera.cx,
            camera.cy,
            camera.distortion_model,
            tuple(camera.distortion),
        )
        return cls(intrinsics or own, camera.T_B_C)

    @property
    def center(self) -> np.ndarray:
        """Camera centre c in B, shape (3,), m."""
        return self.T_B_C[:3, 3]

    @cached_property
    def directions(self) -> np.ndarray:
        """Unit rays r̂ in B, row-major over pixels, shape (H·W, 3)."""
        return self.intrinsics.rays().reshape(-1, 3) @ self.T_B_C[:3, :3].T

    @cached_property
    def range_per_depth(self) -> np.ndarray:
        """Range along the ray per z-depth, ≥ 1, shape (H, W), float32."""
        along_axis = self.directions @ self.T_B_C[:3, 2]
        shape = (self.intrinsics.height, self.intrinsics.width)
        return (1.0 / along_axis).reshape(shape).astype(np.float32)

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
