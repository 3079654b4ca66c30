"""Probe: a pixel of the depth image with its point in 3-D and the nearest node."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.camera.depth_camera import DepthCamera
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.result import Result

Pixel = tuple[int, int]  # row and column
CLOSE_PX = 4  # how far a pixel may be from the one whose residual stands for it; chosen


@dataclass(frozen=True)
class Probed:
    """Values at a probed place."""

    pixel: Pixel | None  # row and column; None for a place outside the image
    point_m: np.ndarray  # (3,), measured point in B; NaN where the pixel has no return
    depth_m: float  # z-depth; NaN where the pixel has no return
    node: int  # nearest node of the membrane
    node_m: np.ndarray  # (3,), where it is now, in B
    node_pixel: tuple[float, float]  # row and column at which the camera sees it
    # displacement_m, pressure_pa: u and p_c of the node; NaN without an estimate
    displacement_m: float
    pressure_pa: float
    unexplained_pa: float  # pressure at the node without evidence of contact, 0 where there is none
    residual_m: float  # measured less modelled range of the pixel; NaN where the result has none


class Probe:
    """Finds places in results of one camera and membrane."""

    def __init__(self, camera: DepthCamera, mesh: MembraneMesh) -> None:
        self._camera, self._mesh = camera, mesh

    def at_pixel(self, pixel: Pixel, result: Result) -> Probed | None:
        """Place that a pixel sees; None outside the image.

        Its node is the one nearest to the measured point, or to the ray where there is no return.
        """
        height, width = result.frame.depth_m.shape
        row, column = pixel
        if not (0 <= row < height and 0 <= column < width):
            return None
        nodes = self._nodes(result)
        point = self._point(pixel, result)
        away = nodes - (point if np.isfinite(point).all() else self._camera.center)
        if not np.isfinite(point).all():
            ray = self._camera.directions[row * width + column]
            away = away - np.outer(away @ ray, ray)
        return self._probed(pixel, result, nodes, int(np.argmin(np.sum(away**2, axis=1))))

    def at_point(self, point_m: np.ndarray, result: Result) -> Probed:
        """Place at a point (3,) in B, of the membrane as it is drawn or of the cloud."""
        nodes = self._nodes(result)
        node = int(np.argmin(np.sum((nodes - point_m) ** 2, axis=1)))
        row, column = (round(c) for c in self._seen_at(point_m))
        height, width = result.frame.depth_m.shape
        inside = 0 <= row < height and 0 <= column < width
        return self._probed((row, column) if inside else None, result, nodes, node)

    def _probed(self, pixel: Pixel | None, result: Result, nodes: np.ndarray, node: int) -> Probed:
        estimate = result.trusted_estimate
        unexplained = None if estimate is None else estimate.unexplained_pressure_pa
        return Probed(
            pixel=pixel,
            point_m=self._point(pixel, result) if pixel else np.full(3, np.nan),
            depth_m=float(result.frame.depth_m[pixel]) if pixel else np.nan,
            node=node,
            node_m=nodes[node],
            node_pixel=self._seen_at(nodes[node]),
            displacement_m=float(estimate.displacement_m[node]) if estimate else np.nan,
            pressure_pa=float(estimate.contact_pressure_pa[node]) if estimate else np.nan,
            unexplained_pa=0.0 if unexplained is None else float(unexplained[node]),
            residual_m=_residual(pixel, result) if pixel else np.nan,
        )

    def _nodes(self, result: Result) -> np.ndarray:
        if result.estimate is None:
            return self._mesh.nodes
        return self._mesh.deformed(result.estimate.motion_m)

    def _point(self, pixel: Pixel, result: Result) -> np.ndarray:
        """Measured point of a pixel in B, (3,), m."""
        depth = result.frame.depth_m
        index = np.array([pixel[0] * depth.shape[1] + pixel[1]])
        return self._camera.points(depth, index)[0]

    def _seen_at(self, point_m: np.ndarray) -> tuple[float, float]:
        """Row and column at which the camera sees a point in B."""
        T = self._camera.T_B_C
        u, v = self._camera.intrinsics.project((point_m - T[:3, 3]) @ T[:3, :3])
        return float(v), float(u)


def _residual(pixel: Pixel, result: Result) -> float:
    """Residual of the pixel, or of one close by in its row where the cloud is thinned, m."""
    residual, pixels, depth = result.cloud_residual_m, result.cloud_pixels, result.frame.depth_m
    if residual is None or pixels is None or not len(pixels) or not np.isfinite(depth[pixel]):
        return np.nan
    wide = depth.shape[1]
    next_one = int(np.searchsorted(pixels, pixel[0] * wide + pixel[1]))
    beside = np.clip([next_one - 1, next_one], 0, len(pixels) - 1)
    row, column = np.divmod(pixels[beside], wide)
    off = np.where(row == pixel[0], np.abs(column - pixel[1]), wide)
    nearest = int(np.argmin(off))
    return float(residual[beside[nearest]]) if off[nearest] <= CLOSE_PX else np.nan
