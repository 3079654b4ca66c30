"""Observation model of optical flow: motion of material points of the membrane in the image."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from bubbleviz.camera.intrinsics import DepthCamera
from bubbleviz.camera.observer import BlockSquares, sagittas
from bubbleviz.camera.raycast import RayCaster, sparse_rows, vector_columns
from bubbleviz.errors import InputError
from bubbleviz.membrane import MembraneMesh

BLOCK_PX = 8  # side of a block with one motion; the size of OpenCV's patches


@dataclass(frozen=True)
class FlowField:
    """Motion of the texture from the reference image to a frame."""

    pixel: np.ndarray  # (k,) int, flat index in the reference image, ascending
    moved_px: np.ndarray  # (k, 2), motion, x to the right and y down, pixels
    sigma_px: np.ndarray  # (k,), standard deviation of each component, pixels
    shape: tuple[int, int]  # height and width of the reference image
    # reason for little or no flow, one clause; empty for enough
    problem: str = ""

    def lengths_px(self) -> np.ndarray:
        """Length of the motion as an image of blocks (H // 8, W // 8), px; NaN where unknown."""
        image = np.full([side // BLOCK_PX for side in self.shape], np.nan)
        row, column = np.divmod(self.pixel, self.shape[1])
        image[row // BLOCK_PX, column // BLOCK_PX] = np.linalg.norm(self.moved_px, axis=1)
        return image


@dataclass(frozen=True)
class MeasuredFlow:
    """Motion of material points that were visible at rest."""

    # (k,) int, index among the observer's points, one per pixel that sees the membrane
    point: np.ndarray
    moved_px: np.ndarray  # (k, 2)
    sigma_px: np.ndarray  # (k,), standard deviation of each component
    squares: BlockSquares  # parts of the image within which errors are correlated
    observer: FlowObserver

    def at(self, nodes: np.ndarray) -> ShapeFlow:
        """Model of the motion, linearised at a shape, nodes (n, 3) in B, m."""
        return self.observer.around(nodes, self.point)

    @cached_property
    def seen(self) -> np.ndarray:
        """Nodes next to which flow was measured, (n,) bool."""
        return self.observer.nodes_of(self.point)

    def noise_factor(self, error_px: np.ndarray) -> float:
        """Factor by which errors (k, 2) exceed the noise, at least 1."""
        deviations = error_px / self.sigma_px[:, None]
        every = np.arange(len(self.point))
        components = [max(1.0, self.squares.noise_factor(every, z)) for z in deviations.T]
        return float(np.sqrt(np.mean(np.square(components))))


@dataclass(frozen=True)
class ShapeFlow:
    """Model of the motion, linearised at a shape: y(x + δ) ≈ moved_px + D δ."""

    moved_px: np.ndarray  # (k, 2)
    jacobian: sparse.csr_array  # (2k, 3n) sparse, two rows per point, three columns per node, px/m


@dataclass(frozen=True)
class PinnedPoints:
    """Material points on a shape of the membrane, positioned by flow."""

    position: np.ndarray  # (k, 3), in B, m
    tangents: np.ndarray  # (k, 2, 3), orthonormal, along the facet of each
    # (k, 3, 3), of the positions, m²: along the facets by the noise of the flow, along the rays by
    # the distance between facets and the surface they stand for
    covariance: np.ndarray
    area: np.ndarray  # (k,), of a pixel on the membrane, m²


class FlowObserver:
    """Models the optical flow of the membrane in a camera.

    Raises InputError: the camera does not see the membrane.
    """

    def __init__(
        self,
        camera: DepthCamera,  # of the images, in the bubble frame
        mesh: MembraneMesh,
    ) -> None:
        self._camera, self._mesh = camera, mesh
        caster = RayCaster(camera.center, camera.directions, mesh.triangles)
        hits = caster.cast(mesh.nodes)
        if not len(hits.ray):
            raise InputError(
                "colour camera: no pixel sees the membrane; check the poses of the colour camera "
                "(/tf_static) and of the depth camera (sensor file)"
            )
        self._point_of_pixel = np.full(len(camera.directions), -1)
        self._point_of_pixel[hits.ray] = np.arange(len(hits.ray))
        self._triangle, self._corners = hits.triangle, mesh.triangles[hits.triangle]
        self._columns = vector_columns(mesh.triangles)
        self._barycentric = hits.barycentric
        rows_and_columns = np.divmod(hits.ray, camera.intrinsics.width)
        self._rest_px = np.stack(rows_and_columns[::-1], axis=1).astype(float)

    def measure(self, flow: FlowField) -> MeasuredFlow:
        """Motions of the points of the membrane."""
        point = self._point_of_pixel[flow.pixel]
        valid = (point >= 0) & np.isfinite(flow.moved_px).all(axis=1) & (flow.sigma_px > 0.0)
        columns = -(-self._camera.intrinsics.width // BLOCK_PX)
        row, column = np.divmod(flow.pixel[valid], self._camera.intrinsics.width)
        block = (row // BLOCK_PX) * columns + column // BLOCK_PX
        return MeasuredFlow(
            point[valid],
            flow.moved_px[valid],
            flow.sigma_px[valid],
            BlockSquares(block, columns),
            self,
        )

    def nodes_of(self, point: np.ndarray) -> np.ndarray:
        """Nodes (n,) bool of the triangles that points (k,) lie on."""
        nodes = np.zeros(len(self._mesh.nodes), bool)
        nodes[self._corners[point]] = True
        return nodes

    def interpolated(self, values: np.ndarray, point: np.ndarray) -> np.ndarray:
        """Values of the nodes (n,) at points (k,)."""
        return np.einsum("ij,ij->i", self._barycentric[point], values[self._corners[point]])

    def pinned(
        self, nodes: np.ndarray, point: np.ndarray, moved_px: np.ndarray, sigma_px: np.ndarray
    ) -> PinnedPoints:
        """Points (k,) on a shape, nodes (n, 3) in B, m, shifted along its facets to their pixels.

        The flow (k, 2) determines the ray of a point, the shape its place along the ray.
        """
        a, b, c = nodes[self._corners[point]].transpose(1, 0, 2)
        first, normal = b - a, np.cross(b - a, c - a)
        tangents = np.stack([first, np.cross(normal, first)], axis=1)
        tangents /= np.linalg.norm(tangents, axis=2, keepdims=True)
        places, pixels, slopes = self._projected(nodes, point)
        along = np.linalg.inv(slopes @ tangents.swapaxes(1, 2))  # m/px
        step = np.einsum("kij,kj->ki", along, moved_px + self._rest_px[point] - pixels)
        spread = np.einsum("kji,kjx->kix", along, tangents) * sigma_px[:, None, None]
        flat = replace(self._mesh, nodes=nodes)
        distance = sagittas(flat).mean(axis=1)[self._triangle[point]]
        out = np.cross(tangents[:, 0], tangents[:, 1])
        ray = places - self._camera.center
        ray *= (distance / np.einsum("kx,kx->k", ray, out))[:, None]
        return PinnedPoints(
            places + np.einsum("ki,kix->kx", step, tangents),
            tangents,
            np.einsum("kix,kiy->kxy", spread, spread) + ray[:, :, None] * ray[:, None],
            np.abs(np.linalg.det(along)),
        )

    def around(self, nodes: np.ndarray, point: np.ndarray) -> ShapeFlow:
        """Model of the motion of points (k,), linearised at a shape, nodes (n, 3) in B, m."""
        barycentric = self._barycentric.take(point, axis=0)
        _, pixels, slopes = self._projected(nodes, point)
        values = slopes[:, :, None, :] * barycentric[:, None, :, None]
        columns = self._columns.take(self._triangle[point], axis=0).repeat(2, axis=0)
        jacobian = sparse_rows(values.reshape(-1, 9), columns, nodes.size)
        return ShapeFlow(pixels - self._rest_px[point], jacobian)

    def _projected(
        self, nodes: np.ndarray, point: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points in B, (k, 3), m, and in the image, (k, 2), and the derivative, (k, 2, 3), px/m."""
        camera = self._camera
        corners = nodes.take(self._corners.take(point, axis=0), axis=0)
        places = np.einsum("ij,ijk->ik", self._barycentric.take(point, axis=0), corners)
        pixels, slopes = camera.intrinsics.projection(camera.local(places))
        return places, pixels, slopes @ camera.T_B_C[:3, :3].T
