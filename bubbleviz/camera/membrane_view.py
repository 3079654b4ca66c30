"""The membrane as the camera sees it, at full resolution."""

from __future__ import annotations

import numpy as np

from bubbleviz.camera.depth_camera import DepthCamera
from bubbleviz.camera.raycast import Hits, RayCaster
from bubbleviz.membrane.mesh import MembraneMesh


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

    def range_image(self, displacement_m: np.ndarray) -> np.ndarray:
        """Modelled range (H, W) in m; NaN where a ray misses the membrane."""
        hits = self.hits(displacement_m)
        image = np.full(self.shape, np.nan)
        image.ravel()[hits.ray] = hits.range_m
        return image

    def above(self, displacement_m: np.ndarray, field: np.ndarray, level: float) -> np.ndarray:
        """Pixels (H, W) that see a part of the membrane where a nodal field exceeds a level.

        Only the triangles that reach the level are cast at: a patch is pushed towards the
        camera, so that no other part of the membrane stands before it.
        """
        mask = np.zeros(self.shape, bool)
        reaching = np.any(field[self.mesh.triangles] > level, axis=1)
        if not reaching.any():
            return mask
        nodes, corners = np.unique(self.mesh.triangles[reaching], return_inverse=True)
        points = self.mesh.deformed(displacement_m)[nodes]
        window = self._window(points)
        directions = self.camera.directions[window]
        caster = RayCaster(self.camera.center, directions, corners.reshape(-1, 3))
        hits = caster.cast(points, self.mesh.normals[nodes])
        values = field[nodes][caster.triangles[hits.triangle]]
        seen = np.einsum("ij,ij->i", hits.barycentric, values) > level
        mask.ravel()[window[hits.ray[seen]]] = True
        return mask

    def _window(self, points: np.ndarray) -> np.ndarray:
        """Flat indices of the pixels in the box that points (k, 3) in B span in the image."""
        T = self.camera.T_B_C
        uv = self.camera.intrinsics.project((points - T[:3, 3]) @ T[:3, :3])
        size = (self.shape[1], self.shape[0])
        low = np.clip(np.floor(uv.min(axis=0)).astype(int), 0, size)
        high = np.clip(np.ceil(uv.max(axis=0)).astype(int) + 1, 0, size)
        rows = np.arange(low[1], high[1])[:, None] * size[0]
        return (rows + np.arange(low[0], high[0])).ravel()
