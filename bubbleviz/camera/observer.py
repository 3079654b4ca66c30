"""What a range image says about the membrane: residuals against the reference, by blocks.

Neighbouring pixels see the same triangle, so their residuals are averaged over blocks of
pixels before the membrane is asked to explain them; the blocks stay below the mesh's resolution.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from bubbleviz.camera.block_squares import MAD, BlockSquares
from bubbleviz.camera.depth_camera import DepthCamera
from bubbleviz.camera.pixel_model import PixelModel
from bubbleviz.camera.raycast import Hits, RayCaster
from bubbleviz.errors import InputError
from bubbleviz.membrane.mesh import MembraneMesh

_HUBER = 1.345
"""Residual in σ beyond which a pixel counts less: 95 % efficient on Gaussian noise."""

_FAR, _FAR_SHARE = 4.0, 1e-3
"""Gaussian noise puts 6e-5 of the pixels beyond 4 σ; more than 1e-3 are not noise."""

_LOOKS = 4
"""Pixels looked at for outliers of those that are worth one independent sample."""


@dataclass(frozen=True)
class Measured:
    """Range residuals of the pixels in use in one frame.

    Attributes
    ----------
    residual_m : (k,) array
        Measured minus reference range, m; NaN where there is no return.
    noise : float
        Factor by which this frame is noisier than expected, at least 1.
    total, moment : (B,) array
        Sums over the pixels of each block: of 1/σ² at that noise, 1/m², and of that times the
        residual, 1/m.
    """

    residual_m: np.ndarray
    noise: float
    total: np.ndarray
    moment: np.ndarray


@dataclass(frozen=True)
class Observation:
    """Range residuals of one frame against the reference configuration.

    Attributes
    ----------
    residual_m : (B,) array
        Weighted mean of measured minus reference range in each block, m; 0 where no pixel is valid.
    weight : (B,) array
        1/σ² of each block's mean, 1/m²; 0 where no pixel is valid.
    trusted : float
        Share of the weight that robust weighting left: 1 where noise explains every pixel.
    """

    residual_m: np.ndarray
    weight: np.ndarray
    trusted: float


@dataclass(frozen=True)
class Linearisation:
    """Model of the block residuals around a displacement: y(u) ≈ offset_m + D u.

    Attributes
    ----------
    hits : Hits
        Where the block rays meet the membrane.
    offset_m : (k,) array
        Constant part for each hit, m; 0 around u = 0, NaN where the membrane at rest is missed.
    """

    hits: Hits
    offset_m: np.ndarray


@dataclass(frozen=True)
class ShapeRanges:
    """Model of the block residuals around a shape: y(x + δ) ≈ model_m + D δ.

    Attributes
    ----------
    block : (k,) int array
        Blocks whose ray meets the membrane, here and at rest.
    model_m : (B,) array
        0 for the others.
    jacobian : (k, 3n) sparse array
        D of those blocks, three columns a node.
    """

    block: np.ndarray
    model_m: np.ndarray
    jacobian: sparse.csr_array


@dataclass(frozen=True)
class Misfit:
    """Residual that a model leaves.

    Attributes
    ----------
    rms_m : float
        Weighted root mean square of the block residuals, m.
    deviations : float
        Typical block residual in standard deviations.
    clumping : float
        Variance of the sums over squares of blocks over that of white residuals: 1 for white
        noise, the number of blocks worth one sample where noise is correlated.
    """

    rms_m: float
    deviations: float
    clumping: float


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
        self.columns = -(-camera.intrinsics.width // block)
        """Blocks in a row of the image."""
        hits = RayCaster(camera.center, camera.directions, mesh.triangles).cast(
            mesh.nodes, mesh.normals
        )
        bias, noise = np.zeros(len(hits.ray)), noise_relative * hits.range_m
        used, correlated = np.ones(len(hits.ray), bool), 1.0
        if pixels is not None:
            used, bias, noise = (
                image.ravel()[hits.ray] for image in (pixels.mask, pixels.bias_m, pixels.noise_m)
            )
            # What facets get wrong is as alike from pixel to pixel as a depth camera's noise is.
            correlated = pixels.correlated_pixels
            noise = np.hypot(noise, facet_error(mesh)) * np.sqrt(correlated)
        pixel = hits.ray[used]
        if not len(pixel):
            raise InputError(
                "camera: no pixel in use sees the membrane; correct the camera's position_m and "
                "quaternion_xyzw in the sensor file"
            )
        order = np.argsort(self._block_of(pixel), kind="stable")
        pixel = pixel[order]
        blocks, self._starts = np.unique(self._block_of(pixel), return_index=True)
        self.block_number = blocks
        """Number of every block, row by row over the image, (B,)."""
        self.pixel = pixel
        """Flat indices of the pixels in use, grouped by block, (k,)."""
        self.block_of_pixel = np.repeat(
            np.arange(len(blocks)), np.diff(self._starts, append=len(pixel))
        )
        self._reference = (hits.range_m + bias)[used][order].astype(np.float32)
        self._scale = camera.range_per_depth.ravel()[pixel]
        self._line = None if pixels is None or pixels.line is None else pixels.line.at(pixel)
        self._precision = (1.0 / noise[used][order] ** 2).astype(np.float32)
        self._facet_error_m = facet_error(mesh)
        self._squares = BlockSquares(blocks, self.columns)
        self._sample = self._whole_blocks(np.diff(self._starts, append=len(pixel)))
        self._spread = self._apart(max(1, int(np.sqrt(correlated / _LOOKS))))
        rows = max(500, 200_000 // block**2)
        gaussian = np.random.default_rng(0).standard_normal((rows, block**2))
        self._gaussian_scatter = _scatter(gaussian)
        noise_m = np.median(1.0 / np.sqrt(np.add.reduceat(self._precision, self._starts)))
        self.white = pixels is None and bool(noise_m > 2.0 * self._facet_error_m)
        """Whether residuals should be white: noise of the sensor file, and more than the mesh's."""
        rays = np.add.reduceat(camera.directions[pixel], self._starts, axis=0)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        self._caster = RayCaster(camera.center, rays, mesh.triangles)
        self._at_rest = self._caster.cast(mesh.nodes, mesh.normals)
        self._rest_range = np.full(len(blocks), np.nan)
        self._rest_range[self._at_rest.ray] = self._at_rest.range_m

    def _block_of(self, pixel: np.ndarray) -> np.ndarray:
        row, column = np.divmod(pixel, self.camera.intrinsics.width)
        return (row // self.block) * self.columns + column // self.block

    def _whole_blocks(self, sizes: np.ndarray) -> np.ndarray:
        """Positions of some thousand pixels in whole blocks, one block a row."""
        whole = self._starts[sizes == self.block**2] if self.block > 1 else self._starts[:0]
        rows = max(50, 4000 // self.block**2)
        whole = whole[:: max(1, len(whole) // rows)]
        return whole[:, None] + np.arange(self.block**2)

    def _apart(self, step: int) -> np.ndarray:
        """Positions of the pixels in every step-th row and column of the image."""
        row, column = np.divmod(self.pixel, self.camera.intrinsics.width)
        return np.flatnonzero((row % step == 0) & (column % step == 0))

    @property
    def blocks(self) -> int:
        """Number of blocks B."""
        return len(self._starts)

    def pixel_residuals(self, depth_m: np.ndarray) -> np.ndarray:
        """Measured minus reference range of the pixels in use, (k,), m; NaN: no return."""
        ranges = depth_m.ravel().take(self.pixel, mode="clip")  # unchecked: all are inside
        ranges *= self._scale
        if self._line is not None:
            ranges = self._line.straighten(ranges)
        ranges -= self._reference
        return ranges

    def observe(self, depth_m: np.ndarray, expected_m: np.ndarray | None = None) -> Observation:
        """Block residuals of a z-depth image.

        Parameters
        ----------
        depth_m : (H, W) array
            z-depth in m, NaN for no return.
        expected_m : (B,) array, optional
            Model of the block residuals; pixels far from it count less (Huber 1964), where there
            are more of them than noise has.
        """
        return self.weigh(self.measure(depth_m), expected_m)

    def measure(self, depth_m: np.ndarray) -> Measured:
        """Residuals of the pixels in use, and how far each is trusted before a model is known."""
        residual = self.pixel_residuals(depth_m)
        noise = self._noise_scale(residual)
        total, moment = self._sums(self._precision, residual)
        return Measured(residual, noise, total / noise**2, moment / noise**2)

    def weigh(self, measured: Measured, expected_m: np.ndarray | None = None) -> Observation:
        """Block residuals of what was measured; `expected_m` as in `observe`."""
        total, moment, share = measured.total, measured.moment, 1.0
        if expected_m is not None:
            expected = expected_m.astype(np.float32)
            squares = self._misses_squared(measured, expected, self._spread)
            if np.count_nonzero(squares > _FAR**2) > _FAR_SHARE * np.count_nonzero(squares >= 0.0):
                robust = _huber_weights(self._misses_squared(measured, expected, slice(None)))
                robust *= self._precision / np.float32(measured.noise**2)
                total, moment = self._sums(robust, measured.residual_m)
                share = float(total.sum() / measured.total.sum())
        mean = np.divide(moment, total, out=np.zeros_like(total), where=total > 0.0)
        return Observation(mean, self._weight(total), share)

    def _misses_squared(
        self, measured: Measured, expected_m: np.ndarray, pixels: np.ndarray | slice
    ) -> np.ndarray:
        """Squares in σ² of what a model (B,) leaves of some pixels; NaN where nothing returned."""
        left = measured.residual_m[pixels] - expected_m[self.block_of_pixel[pixels]]
        left *= left
        left *= self._precision[pixels] / np.float32(measured.noise**2)
        return left

    def _sums(self, precision: np.ndarray, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Sums (B,) over each block of precisions (k,), and of those times residuals (k,).

        Pixels without a return, NaN, count for nothing.
        """
        weighed, holes = precision * residual, np.flatnonzero(np.isnan(residual))
        if holes.size:
            precision = precision.copy()
            precision[holes] = weighed[holes] = 0.0
        total, moment = (np.add.reduceat(x, self._starts) for x in (precision, weighed))
        return total.astype(float), moment.astype(float)

    def _noise_scale(self, residual: np.ndarray) -> float:
        """Factor by which this frame is noisier than expected, at least 1.

        From the scatter of pixels about their block's median. Pixels that a filter has made
        alike scatter less than their σ says, and are not taken for better.
        """
        if not len(self._sample):
            return 1.0
        z = residual[self._sample] * np.sqrt(self._precision[self._sample])
        z = z[~np.isnan(z).any(axis=1)]
        scatter = _scatter(z) if len(z) else 0.0
        return max(1.0, scatter / self._gaussian_scatter)

    def observe_everything(self) -> Observation:
        """The untouched membrane seen without noise by every pixel in use."""
        total = np.add.reduceat(self._precision, self._starts).astype(float)
        return Observation(np.zeros_like(total), self._weight(total), 1.0)

    def _weight(self, precision: np.ndarray) -> np.ndarray:
        """1/σ² of the block means: noise averages out over pixels, the mesh's facets do not."""
        return precision / (1.0 + precision * self._facet_error_m**2)

    def linearise(self, displacement_m: np.ndarray | None = None) -> Linearisation:
        """Model of the block residuals around a displacement (n,), or the reference."""
        if displacement_m is None or not displacement_m.any():
            return Linearisation(self._at_rest, np.zeros(len(self._at_rest.ray)))
        hits = self._caster.cast(self.mesh.deformed(displacement_m), self.mesh.normals)
        return Linearisation(hits, self._offset(hits, displacement_m))

    def relinearise(
        self, linear: Linearisation, displacement_m: np.ndarray, triangles: np.ndarray
    ) -> Linearisation:
        """The same model, around a displacement (n,) close by for the rays of some triangles.

        Each of these rays walks to its triangle, which takes a fraction of casting them all.

        Parameters
        ----------
        linear : Linearisation
        displacement_m : (n,) array
        triangles : (m,) bool array
        """
        some = np.flatnonzero(triangles[linear.hits.triangle])
        nodes = self.mesh.deformed(displacement_m)
        moved = self._caster.recast(nodes, self.mesh.normals, linear.hits.of(some))
        offset = linear.offset_m.copy()
        offset[some] = self._offset(moved, displacement_m)
        return Linearisation(linear.hits.with_others(some, moved), offset)

    def _offset(self, hits: Hits, displacement_m: np.ndarray) -> np.ndarray:
        change = hits.range_m - self._rest_range[hits.ray]
        return change - self._along_rays(hits, displacement_m)

    def predict(self, linear: Linearisation, displacement_m: np.ndarray) -> np.ndarray:
        """Model of every block's residual at a displacement (n,), (B,) in m; 0 where unknown."""
        model = np.zeros(self.blocks)
        model[linear.hits.ray] = linear.offset_m + self._along_rays(linear.hits, displacement_m)
        model[np.isnan(model)] = 0.0
        return model

    def _along_rays(self, hits: Hits, displacement_m: np.ndarray) -> np.ndarray:
        """D u of Eq. 20, (k,)."""
        at_nodes = displacement_m[self.mesh.corners[:, hits.triangle]]
        along: np.ndarray = (hits.sensitivity.T * at_nodes).sum(axis=0)
        return along

    def misfit(
        self, observation: Observation, linear: Linearisation, displacement_m: np.ndarray
    ) -> Misfit:
        """Residual that a displacement (n,) leaves."""
        hits = linear.hits
        model = linear.offset_m + self._along_rays(hits, displacement_m)
        error = observation.residual_m[hits.ray] - model
        seen = np.isfinite(error)
        return self.left(observation, hits.ray[seen], error[seen])

    def left(self, observation: Observation, block: np.ndarray, error_m: np.ndarray) -> Misfit:
        """The same for errors (k,) of some blocks."""
        weight = observation.weight[block]
        seen = weight > 0.0
        error, weight = error_m[seen], weight[seen] / observation.trusted
        if not len(error):
            return Misfit(np.nan, np.inf, 1.0)
        z = error * np.sqrt(weight)
        sums = np.bincount(self._squares.of_block[block[seen]], z)
        return Misfit(
            rms_m=float(np.sqrt(weight @ error**2 / weight.sum())),
            deviations=float(np.median(np.abs(z)) / MAD),
            clumping=float(sums @ sums / max(z @ z, 1e-300)),
        )

    def noise_left(self, observation: Observation, block: np.ndarray, error_m: np.ndarray) -> float:
        """Factor by which errors (k,) of some blocks exceed the noise, at least 1.

        See `BlockSquares.noise_left`.
        """
        z = error_m * np.sqrt(observation.weight[block] / observation.trusted)
        return self._squares.noise_left(block, z)

    def around(self, nodes: np.ndarray) -> ShapeRanges:
        """Model of the block residuals around a shape, nodes (n, 3) in B, m."""
        hits = self._caster.cast(nodes, self.mesh.normals)
        hits = hits.of(np.isfinite(self._rest_range[hits.ray]))
        model = np.zeros(self.blocks)
        model[hits.ray] = hits.range_m - self._rest_range[hits.ray]
        slopes = self._caster.slopes(nodes, hits)
        values = hits.barycentric[:, :, None] * slopes[:, None]
        columns = 3 * self.mesh.triangles[hits.triangle][:, :, None] + np.arange(3)
        starts = np.arange(0, values.size + 1, 9)
        shape = (len(hits.ray), 3 * len(nodes))
        jacobian = sparse.csr_array((values.ravel(), columns.ravel(), starts), shape=shape)
        return ShapeRanges(hits.ray, model, jacobian)


def _scatter(values: np.ndarray) -> float:
    """Median distance from the median of the row; half of the values may be outliers."""
    return float(np.median(np.abs(values - np.median(values, axis=1, keepdims=True))))


def _huber_weights(squares: np.ndarray) -> np.ndarray:
    """Weights of pixels by their squared residual in σ², NaN where that is."""
    weights: np.ndarray = np.minimum(1.0, _HUBER / np.sqrt(np.maximum(squares, 1e-12)))
    return weights


def facet_error(mesh: MembraneMesh) -> float:
    """Distance in m between flat facets and the surface they stand for: the median sagitta."""
    i, j = mesh.triangles, np.roll(mesh.triangles, -1, axis=1)
    edge = mesh.nodes[j] - mesh.nodes[i]
    turn = np.einsum("ijk,ijk->ij", mesh.normals[j] - mesh.normals[i], edge)
    return float(np.median(np.abs(turn)) / 8.0)
