"""The membrane as the camera sees it, at full resolution."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from bubbleviz.camera.depth_camera import DepthCamera
from bubbleviz.camera.raycast import Hits, RayCaster
from bubbleviz.membrane.mesh import MembraneMesh, faces_from

if TYPE_CHECKING:
    from bubbleviz.result import Estimate, Patch


class MembraneView:
    """Renders ranges and nodal fields of the deformed membrane into the camera's image.

    Displacements are those that `MembraneMesh.deformed` takes.

    Parameters
    ----------
    camera : DepthCamera
    mesh : MembraneMesh
    """

    def __init__(self, camera: DepthCamera, mesh: MembraneMesh) -> None:
        self.camera, self.mesh = camera, mesh
        self.shape = (camera.intrinsics.height, camera.intrinsics.width)
        self._caster = RayCaster(camera.center, camera.directions, mesh.triangles)

    def hits(self, displacement_m: np.ndarray, pixels: np.ndarray | None = None) -> Hits:
        """Where the rays of all pixels, or of those with flat indices (k,), meet the membrane."""
        return self._caster.cast(self.mesh.deformed(displacement_m), self.mesh.normals, pixels)

    @cached_property
    def at_rest(self) -> np.ndarray:
        """Triangle that each pixel sees at rest, (H·W,) int32; −1 for none."""
        return self._caster.first(self.mesh.nodes).astype(np.int32)

    def ranges(self, displacement_m: np.ndarray, pixels: np.ndarray) -> np.ndarray:
        """Modelled ranges (k,) of pixels with flat indices (k,), m; NaN where they miss.

        For every frame: each walks from the triangle that it sees at rest.
        """
        nodes = self.mesh.deformed(displacement_m)
        return self._caster.ranges(nodes, pixels, self.at_rest[pixels])

    def range_image(self, displacement_m: np.ndarray) -> np.ndarray:
        """Modelled range (H, W) in m; NaN where a ray misses the membrane."""
        hits = self.hits(displacement_m)
        image = np.full(self.shape, np.nan)
        image.ravel()[hits.ray] = hits.range_m
        return image

    @cached_property
    def rest_range(self) -> np.ndarray:
        """Range (H, W) of the membrane at rest, m."""
        return self.range_image(np.zeros(len(self.mesh.nodes)))

    def patch_pixels(self, estimate: Estimate, patch: Patch, level: float = 0.0) -> np.ndarray:
        """Pixels (H, W) that see where a patch exceeds a level."""
        mesh, estimate, levels = patch.finest(self.mesh, estimate)
        view = self if mesh is self.mesh else MembraneView(self.camera, mesh)
        return view.above(estimate.motion_m, levels, level)

    def above(self, displacement_m: np.ndarray, field: np.ndarray, level: float) -> np.ndarray:
        """Pixels (H, W) that see a part of the membrane where a nodal field exceeds a level.

        Only the triangles that reach the level are drawn: a patch is pushed towards the camera, so
        that no other part of the membrane stands before it. Lens distortion is followed at the
        nodes and is linear between them.
        """
        mask, mesh = np.zeros(self.shape, bool), self.mesh
        triangles = np.flatnonzero((field > level).take(mesh.corners).any(axis=0))
        reaching = mesh.corners.take(triangles, axis=1)
        if not reaching.size:
            return mask
        met = np.zeros(len(mesh.nodes), bool)
        met[reaching] = True
        nodes, corners = np.flatnonzero(met), (np.cumsum(met) - 1)[reaching]
        local = mesh.deformed(displacement_m)[nodes] - self.camera.center
        seen = local @ self.camera.T_B_C[:3, :3]
        places = np.ones((len(nodes), 3))
        places[:, :2] = self.camera.intrinsics.project(seen)
        # times (column, row, 1): a place's barycentric coordinates up to a positive factor
        sides = faces_from(places, corners.T).transpose(1, 0, 2)
        sides *= np.sign(np.einsum("mj,mj->m", places[corners[0]], sides[0]))[:, None]
        # over the depth, what is linear on a triangle is so in the image
        excess = ((field[nodes] - level) / seen[:, 2])[corners]
        bounds = np.concatenate([sides, np.einsum("km,kmj->mj", excess, sides)[None]])
        rows = places[corners, 1]
        _fill(mask, bounds, np.ceil(rows.min(axis=0)), np.floor(rows.max(axis=0)))
        return mask


def _fill(
    mask: np.ndarray,  # (H, W) bool
    # (k, m, 3), an area is where all k products with (column, row, 1) are positive
    bounds: np.ndarray,
    # first, last: (m,), its rows
    first: np.ndarray,
    last: np.ndarray,
) -> None:
    """Set the pixels of some convex areas, by the span of columns in each of their rows."""
    height, width = mask.shape
    first, last = first.clip(0, height).astype(int), last.clip(-1, height - 1).astype(int)
    count = np.maximum(last - first + 1, 0) * bounds.any(axis=(0, 2))
    area = np.repeat(np.arange(len(count)), count)
    row = np.arange(len(area)) + np.repeat(first - np.cumsum(count) + count, count)
    slope, across, offset = bounds.transpose(2, 0, 1).take(area, axis=2)
    here = across * row + offset
    with np.errstate(divide="ignore", invalid="ignore"):
        end = -here / slope
    # parallel to the row: all of it, or nothing
    nothing = (slope == 0.0) & (here < 0.0)
    left = np.where(slope > 0.0, end, np.where(nothing, width, -1.0)).max(axis=0)
    right = np.where(slope < 0.0, end, width).min(axis=0)
    left = np.ceil(np.minimum(np.maximum(left, 0), width))  # `clip` takes three times as long
    right = np.floor(np.minimum(np.maximum(right, -1), width - 1)) + 1
    some = left < right
    if not some.any():
        return
    row, left, right = row[some], left[some].astype(int), right[some].astype(int)
    top, west = row.min(), left.min()
    box = mask[top : row.max() + 1, west : right.max()]
    wide = box.shape[1] + 1
    starts, stops = (
        np.bincount((row - top) * wide + column - west, minlength=len(box) * wide)
        for column in (left, right)
    )
    box |= np.cumsum(starts - stops).reshape(-1, wide)[:, :-1] > 0
