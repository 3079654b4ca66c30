"""What a range image says about the membrane: residuals against the reference, by blocks.

Neighbouring pixels see the same triangle, so their residuals are averaged over blocks of
pixels before the membrane is asked to explain them; the blocks stay below the mesh's resolution.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.camera.depth_camera import DepthCamera
from bubbleviz.camera.pixels import PixelModel
from bubbleviz.camera.raycast import Hits, RayCaster
from bubbleviz.membrane.mesh import MembraneMesh


@dataclass(frozen=True)
class Observation:
    """Range residuals of one frame against the reference configuration.

    Attributes
    ----------
    residual_m : (B,) array
        Weighted mean of measured minus reference range in each block, m; 0 where no pixel is valid.
    weight : (B,) array
        Sum of 1/σ² over the valid pixels of each block, 1/m².
    valid_pixels : int
        Pixels that returned something.
    """

    residual_m: np.ndarray
    weight: np.ndarray
    valid_pixels: int


@dataclass(frozen=True)
class Linearisation:
    """Model of the block residuals around a displacement: y(u) ≈ offset_m + D u.

    Attributes
    ----------
    hits : Hits
        Where the block rays meet the membrane.
    offset_m : (k,) array
        Constant part for each hit, m; 0 around u = 0.
    """

    hits: Hits
    offset_m: np.ndarray


class RangeObserver:
    """Turns z-depth images of one camera into block residuals and models them.

    Parameters
    ----------
    camera : DepthCamera
    mesh : MembraneMesh
    noise_relative : float
        σ of range / range, where no calibration tells.
    pixels : PixelModel, optional
        Calibration of each pixel.
    block : int
        Side of a block in pixels.
    """

    def __init__(
        self,
        camera: DepthCamera,
        mesh: MembraneMesh,
        noise_relative: float,
        pixels: PixelModel | None = None,
        block: int = 1,
    ) -> None:
        self.camera, self.mesh, self.block = camera, mesh, block
        hits = RayCaster(camera.center, camera.directions, mesh.triangles).cast(
            mesh.nodes, mesh.normals
        )
        bias, noise = np.zeros(len(hits.ray)), noise_relative * hits.range_m
        used = np.ones(len(hits.ray), bool)
        if pixels is not None:
            used, bias, noise = (
                image.ravel()[hits.ray] for image in (pixels.mask, pixels.bias_m, pixels.noise_m)
            )
        pixel = hits.ray[used]
        order = np.argsort(self._block_of(pixel), kind="stable")
        pixel = pixel[order]
        blocks, self._starts = np.unique(self._block_of(pixel), return_index=True)
        self.pixel = pixel
        """Flat indices of the pixels in use, grouped by block, (k,)."""
        self.block_of_pixel = np.repeat(
            np.arange(len(blocks)), np.diff(self._starts, append=len(pixel))
        )
        self._reference = (hits.range_m + bias)[used][order].astype(np.float32)
        self._scale = camera.range_per_depth.ravel()[pixel]
        self._precision = (1.0 / noise[used][order] ** 2).astype(np.float32)
        rays = np.add.reduceat(camera.directions[pixel], self._starts, axis=0)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        self._caster = RayCaster(camera.center, rays, mesh.triangles)
        self._at_rest = self._caster.cast(mesh.nodes, mesh.normals)
        self._rest_range = np.full(len(blocks), np.nan)
        self._rest_range[self._at_rest.ray] = self._at_rest.range_m

    def _block_of(self, pixel: np.ndarray) -> np.ndarray:
        row, column = np.divmod(pixel, self.camera.intrinsics.width)
        columns = -(-self.camera.intrinsics.width // self.block)
        return (row // self.block) * columns + column // self.block

    @property
    def blocks(self) -> int:
        """Number of blocks B."""
        return len(self._starts)

    def pixel_residuals(self, depth_m: np.ndarray) -> np.ndarray:
        """Measured minus reference range of the pixels in use, (k,), m; NaN: no return."""
        return depth_m.ravel()[self.pixel] * self._scale - self._reference

    def observe(self, depth_m: np.ndarray) -> Observation:
        """Block residuals of a z-depth image (H, W) in m with NaN for no return."""
        residual = self.pixel_residuals(depth_m)
        valid = np.isfinite(residual)
        precision = np.where(valid, self._precision, np.float32(0.0))
        residual[~valid] = 0.0
        weight = np.add.reduceat(precision, self._starts).astype(float)
        total = np.add.reduceat(precision * residual, self._starts).astype(float)
        mean = np.divide(total, weight, out=np.zeros_like(total), where=weight > 0)
        return Observation(mean, weight, int(np.count_nonzero(valid)))

    def linearise(self, displacement_m: np.ndarray | None = None) -> Linearisation:
        """Model of the block residuals around a displacement (n,), or the reference."""
        if displacement_m is None:
            return Linearisation(self._at_rest, np.zeros(len(self._at_rest.ray)))
        hits = self._caster.cast(self.mesh.deformed(displacement_m), self.mesh.normals)
        change = hits.range_m - self._rest_range[hits.ray]  # NaN: missed the membrane at rest
        at_nodes = displacement_m[self.mesh.triangles[hits.triangle]]
        offset = change - np.einsum("ij,ij->i", hits.sensitivity, at_nodes)
        return Linearisation(hits, offset)
