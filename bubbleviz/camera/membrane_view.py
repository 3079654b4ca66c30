"""The membrane as the camera sees it, at full resolution."""

from __future__ import annotations

import numpy as np

from bubbleviz.camera.depth_camera import DepthCamera
from bubbleviz.camera.raycast import Hits, RayCaster
from bubbleviz.membrane.mesh import MembraneMesh, cross


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

        Only the triangles that reach the level are drawn: a patch is pushed towards the camera, so
        that no other part of the membrane stands before it.
        """
        mask = np.zeros(self.shape, bool)
        triangles = self.mesh.triangles
        reaching = triangles[np.any(field[triangles] > level, axis=1)]
        if not len(reaching):
            return mask
        local = self.mesh.deformed(displacement_m) - self.camera.center
        a, b, c = (local[reaching[:, k]] for k in range(3))
        # times the ray: its barycentric coordinates up to a positive factor
        faces = np.stack([cross(b, c), cross(c, a), cross(a, b)], axis=1)
        faces *= np.sign(np.einsum("mj,mj->m", a, faces[:, 0]))[:, None, None]
        excess = np.einsum("mk,mkj->mj", field[reaching] - level, faces)
        triangle, pixel = self._candidates(local, reaching)
        rays = self.camera.directions[pixel].T
        seen = np.einsum("pj,jp->p", excess[triangle], rays) > 0.0
        for face in faces.transpose(1, 0, 2):
            seen &= np.einsum("pj,jp->p", face[triangle], rays) >= 0.0
        mask.ravel()[pixel[seen]] = True
        return mask

    def _candidates(
        self, local: np.ndarray, triangles: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Triangle (k,) and flat pixel (k,) of all pixels in the boxes that triangles span.

        `local` are node positions from the camera centre in the directions of B, m.
        """
        width, height = self.shape[1], self.shape[0]
        nodes, corners = np.unique(triangles, return_inverse=True)
        uv = self.camera.intrinsics.project(local[nodes] @ self.camera.T_B_C[:3, :3])
        spans = uv[corners.reshape(-1, 3)]
        low = np.clip(np.floor(spans.min(axis=1)).astype(int), 0, (width, height))
        high = np.clip(np.ceil(spans.max(axis=1)).astype(int) + 1, 0, (width, height))
        columns, rows = (high - low).T
        count = columns * rows
        triangle = np.repeat(np.arange(len(triangles)), count)
        place = np.arange(len(triangle)) - np.repeat(np.cumsum(count) - count, count)
        row, column = np.divmod(place, columns[triangle])
        first = low[:, 1] * width + low[:, 0]
        return triangle, first[triangle] + row * width + column
