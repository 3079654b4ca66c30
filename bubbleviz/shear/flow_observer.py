"""What optical flow says about the membrane: motion of material points in the image, by blocks.

The flow of neighbouring pixels is of one patch of texture and alike, so that a block of pixels is
one sample whatever their number.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from bubbleviz.camera.block_squares import BlockSquares
from bubbleviz.camera.depth_camera import DepthCamera
from bubbleviz.camera.raycast import RayCaster
from bubbleviz.colour.flow_field import FlowField
from bubbleviz.errors import InputError
from bubbleviz.membrane.mesh import MembraneMesh

_STRIDE = 2
"""Every how many pixels of a row and a column flow is looked at: those between say the same."""
_LEAST_SHARE = 0.5
"""Of a block's pixels that must have flow: with fewer their mean is not that of the block."""


@dataclass(frozen=True)
class MeasuredFlow:
    """Motion of the material points of blocks of pixels.

    Attributes
    ----------
    block : (k,) int array
        Blocks with flow.
    moved_px : (k, 2) array
    sigma_px : (k,) array
        Standard deviation of each component.
    """

    block: np.ndarray
    moved_px: np.ndarray
    sigma_px: np.ndarray


@dataclass(frozen=True)
class ShapeFlow:
    """Model of the motion around a shape: y(x + δ) ≈ moved_px + D δ.

    Attributes
    ----------
    moved_px : (k, 2) array
    jacobian : (2k, 3n) sparse array
        Two rows a block, three columns a node, pixels/m.
    """

    moved_px: np.ndarray
    jacobian: sparse.csr_array


class FlowObserver:
    """Turns flow fields of one camera into motions of blocks and models them.

    Parameters
    ----------
    camera : DepthCamera
        Whose contact-free image the flow starts from.
    mesh : MembraneMesh
    block : int
        Side of a block in pixels.

    Raises
    ------
    InputError
        The camera does not see the membrane.
    """

    def __init__(self, camera: DepthCamera, mesh: MembraneMesh, block: int) -> None:
        self._camera, self._mesh = camera, mesh
        width, height = camera.intrinsics.width, camera.intrinsics.height
        columns = -(-width // block)
        hits = RayCaster(camera.center, camera.directions, mesh.triangles).cast(
            mesh.nodes, mesh.normals
        )
        if not len(hits.ray):
            raise InputError(
                "colour camera: no pixel sees the membrane; correct its pose in the sensor file"
            )
        row, column = np.divmod(hits.ray, width)
        stride = min(_STRIDE, block)
        some = (row % stride == 0) & (column % stride == 0)
        number = (row // block) * columns + column // block
        blocks, which = np.unique(number, return_inverse=True)
        rays = np.zeros((len(blocks), 3))
        for k in range(3):
            rays[:, k] = np.bincount(which, camera.directions[hits.ray, k])
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        points = RayCaster(camera.center, rays, mesh.triangles).cast(mesh.nodes, mesh.normals)
        kept = np.full(len(blocks), -1)
        kept[points.ray] = np.arange(len(points.ray))
        self._block_of_pixel = np.full(width * height, -1)
        self._block_of_pixel[hits.ray[some]] = kept[which[some]]
        self._pixels = np.bincount(which[some], minlength=len(blocks))[points.ray]
        self._corners = mesh.triangles[points.triangle]
        self._barycentric = points.barycentric
        self._rest_px = camera.intrinsics.project(self._in_camera(mesh.nodes, slice(None)))
        self.squares = BlockSquares(blocks[points.ray], columns)
        """Parts of the image in which flow is wrong alike."""

    def measure(self, flow: FlowField) -> MeasuredFlow:
        """Motions of the blocks that have flow."""
        block = self._block_of_pixel[flow.pixel]
        some = np.flatnonzero(block >= 0)
        block, moved, sigma = block[some], flow.moved_px[some], flow.sigma_px[some]
        seen = np.isfinite(moved).all(axis=1) & (sigma > 0.0)
        block, moved, sigma = block[seen], moved[seen], sigma[seen]
        count = np.bincount(block, minlength=len(self._pixels))
        full = np.flatnonzero(count >= np.maximum(1.0, _LEAST_SHARE * self._pixels))
        sums = [np.bincount(block, each, minlength=len(count))[full] for each in moved.T]
        variance = np.bincount(block, sigma**2, minlength=len(count))[full] / count[full]
        mean = np.stack(sums, axis=1) / count[full][:, None]
        return MeasuredFlow(full, mean, np.sqrt(variance))

    def seen_share(self, measured: MeasuredFlow, nodes: np.ndarray) -> float:
        """Share of nodes (n,) bool with flow on a triangle beside them."""
        beside = np.zeros(len(nodes), bool)
        beside[self._corners[measured.block]] = True
        return int(np.count_nonzero(beside & nodes)) / max(1, int(np.count_nonzero(nodes)))

    def around(self, nodes: np.ndarray, block: np.ndarray) -> ShapeFlow:
        """Model of the motion of blocks (k,) around a shape, nodes (n, 3) in B, m."""
        points = self._in_camera(nodes, block)
        pixels, slopes = self._camera.intrinsics.projection(points)
        slopes = slopes @ self._camera.T_B_C[:3, :3].T
        values = slopes[:, :, None, :] * self._barycentric[block][:, None, :, None]
        columns = 3 * self._corners[block][:, None, :, None] + np.arange(3)
        columns = np.broadcast_to(columns, values.shape)
        starts = np.arange(0, values.size + 1, 9)
        shape = (2 * len(block), 3 * len(nodes))
        jacobian = sparse.csr_array((values.ravel(), columns.ravel(), starts), shape=shape)
        return ShapeFlow(pixels - self._rest_px[block], jacobian)

    def _in_camera(self, nodes: np.ndarray, block: np.ndarray | slice) -> np.ndarray:
        """Material points of blocks in the camera's frame, (k, 3), m."""
        T = self._camera.T_B_C
        corners = ((nodes - T[:3, 3]) @ T[:3, :3])[self._corners[block]]
        points: np.ndarray = np.einsum("ij,ijk->ik", self._barycentric[block], corners)
        return points
