"""Range residuals of a depth image against the reference surface, averaged over pixel blocks.

Neighbouring pixels see the same triangle, so their residuals are averaged over blocks of pixels,
smaller than the mesh resolves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage, sparse

from bubbleviz.camera.image_errors import (
    IMAGE_ERRORS,
    OF_RANGES,
    SHIFTS,
    SQUARE_ERROR_M,
    range_errors,
    range_shifts,
)
from bubbleviz.camera.intrinsics import DepthCamera
from bubbleviz.camera.pixel_model import PixelModel, UsedPixels
from bubbleviz.camera.raycast import Hits, RayCaster, sparse_rows, vector_columns
from bubbleviz.errors import InputError
from bubbleviz.membrane import MembraneMesh

# Squares of blocks over the image, which show correlated noise and model errors.


SQUARES = 40
"""Number of squares, the same for every mesh: model errors are similar within a square, and the
median needs some tens of them."""

UPPER_95 = 1.6
"""Upper 95 % limit of a median over `SQUARES` squares, relative to that median: its standard
deviation is a fifth."""

MAD = 0.6745  # median of |z| of a standard normal z
_MIDDLE_MEAN = 0.6934  # mean of the middle half of its |z|


class BlockSquares:
    """Groups blocks of pixels by squares of the image."""

    def __init__(
        self,
        blocks: np.ndarray,  # (B,) int, numbers of the blocks, row by row over the image
        columns: int,  # blocks in a row of the image
    ) -> None:
        self.side = max(1, round(np.sqrt(len(blocks) / SQUARES)))
        self._columns = columns
        row, column = np.divmod(blocks, columns)
        # (B,) int, number of the square of each
        self.of_block = (row // self.side) * columns + column // self.side
        half = self.side // 2
        # the same, also for squares shifted by half a square; NumPy sorts 16 bits faster
        self._shifted = [
            ((row + down) // self.side * (columns + 1) + (column + right) // self.side).astype(
                np.uint16
            )
            for down, right in ((0, 0), (0, half), (half, 0), (half, half))
        ]

    def noise_factor(
        self,
        block: np.ndarray,  # (k,) int, positions in `blocks`
        z: np.ndarray,  # (k,), errors in standard deviations; 0 where nothing was measured
        steady: bool = False,  # see below
    ) -> float:
        """Noise factor: σ of the errors over the expected σ; 1 if there are too few errors.

        By the median of their sums over squares: model errors and correlated noise are similar in
        neighbouring blocks, so they do not average out in a square. `steady`: by the mean of the
        middle half of the sums, which does not jump by the distance of two sums (5 %) if a few
        change, but needs three quarters of the squares to be without large errors.
        """
        sizes = np.abs(self._means(block, z))
        sizes = np.sort(sizes[np.isfinite(sizes)])
        if not sizes.size:
            return 1.0
        cut = round(0.25 * len(sizes)) if steady else (len(sizes) - 1) // 2
        return float(sizes[cut : len(sizes) - cut].mean() / (_MIDDLE_MEAN if steady else MAD))

    def noise_factor_by_curvature(self, block: np.ndarray, z: np.ndarray) -> float:
        """The same by second differences of squares, which smooth motion hardly changes."""
        means = self._means(block, z)
        means = np.pad(means, (0, -len(means) % self._columns), constant_values=np.nan)
        grid = means.reshape(-1, self._columns)
        bent = np.concatenate([np.diff(each, 2, axis=0).ravel() for each in (grid, grid.T)])
        bent = bent[np.isfinite(bent)]
        return float(median(np.abs(bent)) / (MAD * np.sqrt(6.0))) if bent.size else 1.0

    def largest_median(
        self, block: np.ndarray, error: np.ndarray, weight: np.ndarray, model_m: float
    ) -> float:
        """Largest absolute median of the errors (k,) of a square, in standard deviations.

        `weight` (k,) is 1/σ² of the noise of each, `model_m` the σ of an error that a square has in
        common. Only squares of which at least half is measured count. Squares shifted by half a
        square are included, so that it hardly matters where an object lies. The error of a small
        part of a square, as by a cable, changes neither its median nor the robust estimate.
        """
        order = np.argsort(error)
        order = order[weight[order] > 0.0]
        error, weight, block = error[order], weight[order], block[order]
        largest = 0.0
        for of_block in self._shifted:
            square = of_block[block]
            count, precision = np.bincount(square), np.bincount(square, weight)
            full = np.flatnonzero(count >= 0.5 * self.side**2)
            by_square = np.argsort(square, kind="stable")
            middle = error[by_square[(np.cumsum(count) - count + count // 2)[full]]]
            sigma = np.sqrt(0.5 * np.pi / precision[full] + model_m**2)
            largest = float(np.max(np.abs(middle) / sigma, initial=largest))
        return largest

    def _means(self, block: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Mean errors by number of the square, in standard deviations; NaN where few have any."""
        square = self.of_block[block]
        sums, count = np.bincount(square, z), np.bincount(square, z != 0.0)
        full = count >= 0.5 * self.side**2
        means: np.ndarray = np.where(full, sums / np.sqrt(np.maximum(count, 1)), np.nan)
        return means


def median(values: np.ndarray) -> np.ndarray:
    """Median along the last axis of values (…, k), k > 0; a third of the time of NumPy's own.

    Not checked for NaN.
    """
    count = values.shape[-1]
    low, high = (count - 1) // 2, count // 2
    ordered = np.partition(values, high if low == high else (low, high), axis=-1)
    middle: np.ndarray = 0.5 * (ordered[..., low] + ordered[..., high])
    return middle


_HUBER = 1.345
"""Residual in σ beyond which a pixel has less weight: 95 % efficient on Gaussian noise."""

_OUTLIER, _OUTLIER_SHARE = 4.0, 1e-3
"""Outliers: Gaussian noise puts 6e-5 of the pixels beyond 4 σ, so more than 1e-3 are not noise. A
block mean beyond 4 σ, which a single pixel at 60 m can cause, is not noise either."""

_MAX_WALK = 0.5
"""Motion of nodes, in mesh edges, since all rays were cast, beyond which they are cast again."""

_MILLIMETRE, _WHOLE, _LOST = 1e-3, 0.01, 0.5
"""Unit of depth images of 16 bit, m; and in this unit the distance from a whole number beyond which
a depth is not rounded, and the noise with which rounding errors average out (their first harmonic
is reduced to 0.7 %)."""

_FALSE, _AROUND = 6.0, 2
"""Distance in σ from the median of its block beyond which a return is false, in addition to the
range that a slope of the membrane of up to two explains: a mesh edge over a block, which is half as
wide. A block is compared in the same way with the median of the blocks up to this many away."""

_BORDER = 2
"""Largest distance from missing returns, in blocks of half a mesh edge, at which returns may be
biased. Each distance has an error of its own. On a simulated sensor with a specular spot whose
border is biased, 85 % of forces are in their 95 % intervals with one block, 96 % with two, 92 %
with three."""

_OUTLIER_PIXELS, _MAX_OUTLIER_PIXELS = 4, 20_000
"""Pixels checked for outliers per independent sample, and about the most of an image: they
determine a share of 1e-3 to a fifth of it."""


@dataclass(frozen=True)
class Measured:
    """Measurements of one frame in the pixels in use, before comparison with a model."""

    depth_m: np.ndarray  # (H, W), the z-depth image, m; NaN where there is no return
    noise: float  # factor by which this frame is noisier than expected, at least 1
    # total, moment: (B,), sums over the pixels of each block: of 1/σ² at `block_noise`, 1/m², and
    # of the residual over σ², 1/m
    total: np.ndarray
    moment: np.ndarray
    # (B, b), blocks at each distance from missing or masked returns, 1 or 0; b is 0 without any
    border: np.ndarray
    # variance of the block means due to rounding of the depth to millimetres, (B,), m², or 0
    rounding_m2: np.ndarray | float = 0.0
    # factor by which block means are noisier than expected: more than `noise` where that is
    # correlated between pixels
    block_noise: float = 1.0

    def at_noise(self, block_noise: float) -> Measured:
        """The same with block means at least as noisy as by a noise factor."""
        factor = max(block_noise / self.block_noise, 1.0)
        total, moment = self.total / factor**2, self.moment / factor**2
        block_noise = factor * self.block_noise
        return replace(self, total=total, moment=moment, block_noise=block_noise)


@dataclass(frozen=True)
class Observation:
    """Range residuals of one frame against the reference configuration."""

    # (B,), weighted mean of measured minus reference range in each block, m; 0 where no pixel is
    # valid
    residual_m: np.ndarray
    weight: np.ndarray  # (B,), 1/σ² of each block's mean, 1/m²; 0 where no pixel is valid
    # share of the weight after robust weighting: 1 without outliers
    trusted: float


@dataclass(frozen=True)
class ShapeRanges:
    """Model of the block residuals, linearised at a shape: y(x + δ) ≈ model_m + D δ."""

    block: np.ndarray  # (k,) int, blocks whose ray meets the membrane, here and at rest
    model_m: np.ndarray  # (B,), 0 for the others
    jacobian: sparse.csr_array  # (k, 3n) sparse, D of those blocks, three columns per node
    hits: Hits  # where those rays meet it
    cast_at_m: np.ndarray  # (n, 3), shape at which all rays were cast
    nodes_m: np.ndarray  # (n, 3), the shape itself


@dataclass(frozen=True)
class Misfit:
    rms_m: float  # weighted root mean square of the block residuals, m
    deviations: float  # typical block residual in standard deviations
    # variance of sums over squares of blocks, relative to white residuals: 1 for white noise,
    # the number of blocks worth one sample where noise is correlated
    clumping: float
    # largest median of a square, see `BlockSquares.largest_median`
    regional: float


class RangeObserver:
    """Turns z-depth images of one camera into block residuals and models them."""

    def __init__(
        self,
        camera: DepthCamera,
        mesh: MembraneMesh,
        noise_relative: float,  # σ of range / range, without a pixel calibration
        pixels: PixelModel | None = None,  # calibration of each pixel
        block: int = 1,  # side of a block in pixels
        # (H·W,) int, triangle of each pixel at rest, as `MembraneView.at_rest`; computed if None
        seen: np.ndarray | None = None,
    ) -> None:
        self.camera, self.mesh, self.block = camera, mesh, block
        self.columns = -(-camera.intrinsics.width // block)  # blocks in a row of the image
        self.facet_error_m = facet_error(mesh)
        self._model_error_m = float(np.hypot(SQUARE_ERROR_M, self.facet_error_m))
        caster = RayCaster(camera.center, camera.directions, mesh.triangles)
        seen = caster.first(mesh.nodes) if seen is None else seen
        self._group(caster.hits_on(mesh.nodes, seen), noise_relative, pixels)
        # Straight from the image to sums over blocks: one pass over the pixels.
        starts = np.append(self._starts, len(self.pixel))
        self._to_moments = sparse.csr_array(
            (self._used.precision * self._used.scale, self.pixel, starts),
            shape=(self.blocks, camera.intrinsics.width * camera.intrinsics.height),
        )
        self._squares = BlockSquares(self.block_number, self.columns)
        self._sample = self._used.of(self._whole_blocks())
        correlated = 1.0 if pixels is None else pixels.correlated_pixels
        self._noise_m = float(np.median(1.0 / np.sqrt(self._used.precision)))
        self.border_sigma_m = self._noise_m
        """Largest σ of errors beside missing returns; a hundredth, the least, is negligible."""
        if pixels is not None:  # measured on rounded depth: rounding errors do not dither it
            self._noise_m = float(np.sqrt(max(self._noise_m**2 - _MILLIMETRE**2 / 12.0, 0.0)))
        apart = max(1.0, correlated / _OUTLIER_PIXELS, len(self.pixel) / _MAX_OUTLIER_PIXELS)
        self._spread = self._used.of(self._every_nth(int(np.sqrt(apart))))
        rows = max(500, 200_000 // block**2)
        gaussian = np.random.default_rng(0).standard_normal((rows, block**2))
        self._gaussian_scatter = float(median(_from_median(gaussian).ravel()))
        noise_m = np.median(1.0 / np.sqrt(self._total))
        self.white = pixels is None and bool(noise_m > 2.0 * self.facet_error_m)
        """Whether residuals should be white: noise of the sensor file, above the mesh's error."""
        self._cast_blocks(seen[self.pixel[self._starts]])

    def _group(self, hits: Hits, noise_relative: float, pixels: PixelModel | None) -> None:
        """Group the pixels in use, of those that see the membrane, by block."""
        range_m, bias, noise = hits.range_m, np.zeros(len(hits.ray)), noise_relative * hits.range_m
        used = np.ones(len(hits.ray), bool)
        if pixels is not None:
            used, bias, noise = (
                image.ravel()[hits.ray] for image in (pixels.mask, pixels.bias_m, pixels.noise_m)
            )
            # Errors of flat facets are as correlated between pixels as a depth camera's noise.
            noise = np.hypot(noise, self.facet_error_m) * np.sqrt(pixels.correlated_pixels)
        pixel = hits.ray[used]
        if not len(pixel):
            raise InputError(
                "no pixel in use sees the membrane; correct the camera's position_m and "
                "quaternion_xyzw in the sensor file, or identify the sensor again if it has a "
                "pixels file"
            )
        order = np.argsort(self._block_of(pixel), kind="stable")
        self.pixel = pixel = pixel[order]
        """Flat indices of the pixels in use, grouped by block, (k,)."""
        blocks, self._starts, self._count = np.unique(
            self._block_of(pixel), return_index=True, return_counts=True
        )
        self.block_number = blocks  # number of every block, row by row over the image, (B,)
        # pixels by row and column of blocks, those of masked holes included
        filled = np.zeros((self.camera.intrinsics.height, self.camera.intrinsics.width), bool)
        filled.ravel()[pixel] = True
        filled = ndimage.binary_fill_holes(filled)
        rows = -(-len(filled) // self.block)
        self._whole = np.bincount(
            self._block_of(np.flatnonzero(filled)), minlength=rows * self.columns
        ).reshape(rows, self.columns)
        self._used = UsedPixels(
            number=pixel,
            block=np.repeat(np.arange(self.blocks), self._count),
            scale=self.camera.range_per_depth.ravel()[pixel],
            reference_m=(range_m + bias)[used][order].astype(np.float32),
            precision=(1.0 / noise[used][order] ** 2).astype(np.float32),
            line=None if pixels is None or pixels.line is None else pixels.line.at(pixel),
        )
        precision = self._used.precision
        self._total = self._sums(precision)
        self._moment_at_rest = self._sums(precision * self._used.reference_m.astype(float))

    def _cast_blocks(self, near: np.ndarray) -> None:
        """Cast a ray for each block, the mean of its pixels' rays.

        `near`: triangle (B,) that one of them meets.
        """
        camera, mesh = self.camera, self.mesh
        rays = np.add.reduceat(camera.directions[self.pixel], self._starts, axis=0)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        self._caster = RayCaster(camera.center, rays, mesh.triangles)
        self._walk_m = _MAX_WALK * mesh.edge_length
        self._columns = vector_columns(mesh.triangles)
        at_rest = self._caster.cast(mesh.nodes, near=near)
        self._rest_range = np.full(self.blocks, np.nan)
        self._rest_range[at_rest.ray] = at_rest.range_m
        self._at_rest = np.full(self.blocks, -1)
        self._at_rest[at_rest.ray] = at_rest.triangle
        # (B, e), errors of the block ranges under a unit of each of `IMAGE_ERRORS`, 0 for blocks
        # that do not see the membrane at rest
        corners = mesh.normals[mesh.triangles[at_rest.triangle]]
        normals = np.einsum("rk,rki->ri", at_rest.barycentric, corners)
        T_B_C, seen = camera.T_B_C, rays[at_rest.ray]
        self.image_errors = np.zeros((self.blocks, len(IMAGE_ERRORS)))
        self.image_errors[at_rest.ray, OF_RANGES] = range_errors(T_B_C, seen, at_rest.range_m)
        self.image_errors[at_rest.ray, SHIFTS] = range_shifts(T_B_C, seen, normals)

    def _block_of(self, pixel: np.ndarray) -> np.ndarray:
        row, column = np.divmod(pixel, self.camera.intrinsics.width)
        return (row // self.block) * self.columns + column // self.block

    def _whole_blocks(self) -> np.ndarray:
        """Positions of some thousand pixels in whole blocks, one after the other."""
        whole = self._starts[self._count == self.block**2] if self.block > 1 else self._starts[:0]
        rows = max(50, 4000 // self.block**2)
        whole = whole[:: max(1, len(whole) // rows)]
        return (whole[:, None] + np.arange(self.block**2)).ravel()

    def _every_nth(self, step: int) -> np.ndarray:
        """Positions of the pixels in every step-th row and column of the image."""
        row, column = np.divmod(self.pixel, self.camera.intrinsics.width)
        return np.flatnonzero((row % step == 0) & (column % step == 0))

    @property
    def blocks(self) -> int:
        return len(self._starts)

    def pixel_residuals(self, depth_m: np.ndarray) -> np.ndarray:
        """Measured minus reference range of the pixels in use, (k,), m; NaN: no return."""
        return self._used.residuals(depth_m)

    def observe(
        self,
        depth_m: np.ndarray,  # (H, W), z-depth in m, NaN for no return
        # (B,), model of the block residuals; outliers have less weight (Huber 1964) if there are
        # more than noise explains
        expected_m: np.ndarray | None = None,
    ) -> Observation:
        """Block residuals of a z-depth image."""
        return self.weigh(self.measure(depth_m), expected_m)

    def measure(self, depth_m: np.ndarray) -> Measured:
        """Sums over the blocks, and the noise of the image by its scatter within blocks.

        False returns count as none: pixels far from the median of their block.
        """
        noise, false_returns = self._scatter(depth_m)
        if false_returns:
            depth_m = self._without_false_returns(depth_m, noise)
            noise, _ = self._scatter(depth_m)
        if self._used.line is None:
            moment = self._to_moments @ depth_m.ravel() - self._moment_at_rest
        else:
            moment = self._sums(self._used.precision * self._used.residuals(depth_m))
        total = self._total
        holes = np.flatnonzero(np.isnan(moment))
        if holes.size:
            total = total.copy()
            total[holes], moment[holes] = self._sums_of(holes, depth_m)
        rounding = self._rounding_variance(total, moment) if self._is_rounded(depth_m) else 0.0
        border = self._border(total)
        total, moment = total / noise**2, moment / noise**2
        return Measured(depth_m, noise, total, moment, border, rounding, noise)

    def _border(self, total: np.ndarray) -> np.ndarray:
        """Blocks at each distance, see `Measured`, from those that lack most of their pixels.

        Most are three quarters: of blocks of four pixels, dropouts of 0.5 % of the pixels leave
        out that many in one image of 500. Masked pixels count as missing where others surround
        them, as beside a specular spot in the frames of the identification. Blocks with less than
        half of their pixels on the membrane, as at its edge, do not count.
        """
        row, column = np.divmod(self.block_number, self.columns)
        known = np.zeros(self._whole.shape)
        known[row, column] = total / self._total * self._count
        missing = (known < 0.25 * self._whole) & (self._whole > 0.5 * self.block**2)
        if not missing.any():
            return np.zeros((self.blocks, 0))
        distance = ndimage.distance_transform_cdt(~missing, "chessboard")[row, column]
        return (distance[:, None] == np.arange(_BORDER + 1)).astype(float)

    def change_noise(self, images: Sequence[Measured], lag: int) -> tuple[float, float]:
        """Noise factor of block means by their changes over `lag` images, and variance of these.

        The variance is relative to the expected one, as a mean over blocks; both are medians over
        pairs of images.
        """
        found = []
        for one, other in zip(images[:-lag], images[lag:], strict=True):
            block = np.flatnonzero((one.total > 0.0) & (other.total > 0.0))
            variance = np.zeros(len(block))
            for each in (one, other):
                variance += 1.0 / self._weight(each.total, each.rounding_m2)[block]
            before, after = (each.moment[block] / each.total[block] for each in (one, other))
            z = (after - before) / np.sqrt(variance)
            factor = self._squares.noise_factor_by_curvature(block, z)
            found.append((factor, float(z @ z) / max(len(z), 1)))
        noise, square = np.median(found, axis=0).tolist()
        return noise, square

    def weigh(self, measured: Measured, expected_m: np.ndarray | None = None) -> Observation:
        """Block residuals of a measurement; `expected_m` as in `observe`."""
        total, moment, share = measured.total, measured.moment, 1.0
        if expected_m is not None:
            expected = expected_m.astype(np.float32)
            squares = self._spread.squared_residuals(measured.depth_m, expected)
            squares /= np.float32(measured.noise**2)
            outliers = np.count_nonzero(squares > _OUTLIER**2)
            if outliers > _OUTLIER_SHARE * np.count_nonzero(squares >= 0.0):
                affected = np.arange(self.blocks)
            else:
                affected = self._outlying_blocks(measured, expected_m)
            if affected.size:
                robust = self._sums_of(affected, measured.depth_m, expected, measured.noise)
                total, moment = total.copy(), moment.copy()
                total[affected], moment[affected] = robust / measured.block_noise**2
                share = float(total.sum() / measured.total.sum())
        mean = np.divide(moment, total, out=np.zeros_like(total), where=total > 0.0)
        return Observation(mean, self._weight(total, measured.rounding_m2), share)

    def _is_rounded(self, depth_m: np.ndarray) -> bool:
        """Whether most depths are whole millimetres, as in images of 16 bit, and noise is less."""
        if self._noise_m > _LOST * _MILLIMETRE:
            return False
        some = depth_m.ravel()[self._spread.number[::16]] / _MILLIMETRE
        away = np.abs(some - np.rint(some))
        away = away[~np.isnan(away)]
        return bool(len(away)) and float(median(away)) < _WHOLE

    def _rounding_variance(self, total: np.ndarray, moment: np.ndarray) -> np.ndarray:
        """Variance of the block means (B,) due to rounding of the depth z to millimetres, m².

        The error is Σ ± sin(2πkz) / πk, in millimetres. It averages out over a block, or a square
        of blocks, in which z varies by a millimetre, and by the camera's noise. Elsewhere
        neighbouring blocks have the same error: returned is the variance of a square's mean times
        the number of its blocks, and at least the variance of the block's own. z is the measured
        depth, smoothed by the mean over squares.
        """
        side, (row, column) = self._squares.side, np.divmod(self.block_number, self.columns)
        seen, depth = np.zeros((2, row.max() + 1, self.columns))
        known = (total > 0.0) & np.isfinite(self._rest_range)
        seen[row, column] = known
        range_m = self._rest_range[known] + moment[known] / total[known]
        depth[row[known], column[known]] = range_m / self.image_errors[known, 0] / _MILLIMETRE
        share = np.maximum(ndimage.uniform_filter(seen, side), side**-2.0)
        smooth = ndimage.uniform_filter(depth, side) / share
        down, right = np.gradient(smooth)
        own, common = np.zeros((2, *smooth.shape))
        for k in (1, 2, 3):
            left = seen * np.exp(-2.0 * (np.pi * k * self._noise_m / _MILLIMETRE) ** 2) / k
            left *= np.sinc(k * down) * np.sinc(k * right)
            own += left**2
            for wave in (np.cos, np.sin):
                common += ndimage.uniform_filter(left * wave(2.0 * np.pi * k * smooth), side) ** 2
        variance = np.maximum(own, common * side**2 / share)[row, column]
        return np.asarray(variance * _MILLIMETRE**2 / (2.0 * np.pi**2))

    def _outlying_blocks(self, measured: Measured, expected_m: np.ndarray) -> np.ndarray:
        """Blocks whose means differ from a model (B,) by more than noise, (j,) int."""
        total, moment = measured.total, measured.moment
        weight = self._weight(np.maximum(total, np.finfo(float).tiny), measured.rounding_m2)
        return np.flatnonzero(
            np.abs(moment - total * expected_m) > _OUTLIER * total / np.sqrt(weight)
        )

    def _sums_of(
        self,
        blocks: np.ndarray,  # (j,) int, in ascending order
        depth_m: np.ndarray,
        # (B,), model of the block residuals, to which outliers have less weight
        expected_m: np.ndarray | None = None,
        noise: float = 1.0,
    ) -> np.ndarray:
        """Sums (2, j) over the valid pixels of some blocks, as of `Measured` without its noise."""
        count = self._count[blocks]
        ends = np.cumsum(count)
        pixels = self._used
        if len(blocks) < self.blocks:
            first = self._starts[blocks] - ends + count
            pixels = pixels.of(np.arange(ends[-1]) + np.repeat(first, count))
        weight, residual = pixels.precision, pixels.residuals(depth_m)
        if expected_m is not None:
            squares = (residual - expected_m[pixels.block]) ** 2 * weight
            weight = weight * _huber_weights(squares / np.float32(noise**2))
        missing = np.isnan(residual)
        weight, residual = np.where(missing, 0.0, weight), np.where(missing, 0.0, residual)
        both = np.stack([weight, weight * residual])
        return np.add.reduceat(both, ends - count, axis=1).astype(float)

    def _sums(self, values: np.ndarray) -> np.ndarray:
        """Sums (B,) over each block of values (k,) of the pixels."""
        return np.add.reduceat(values, self._starts).astype(float)

    def _scatter(self, depth_m: np.ndarray) -> tuple[float, bool]:
        """Factor by which this frame is noisier than expected, at least 1; any false returns.

        From the scatter of some pixels about their block's median. Less scatter than σ does not
        count as less noise: a filter may have smoothed the image.
        """
        if not len(self._sample.number):
            return 1.0, False
        root = np.sqrt(self._sample.precision).reshape(-1, self.block**2)
        away = _from_median(self._sample.residuals(depth_m).reshape(root.shape) * root)
        known = away[~np.isnan(away)]
        if not len(known):
            return 1.0, False
        noise = max(1.0, float(median(known)) / self._gaussian_scatter)
        return noise, bool((away > self._limit(root, noise)).any())

    def _limit(self, root: np.ndarray, noise: float) -> np.ndarray:
        """Distance in σ from its block's median beyond which a return is false; `root` is 1/σ."""
        limit: np.ndarray = root * np.float32(self.mesh.edge_length) + _FALSE * noise
        return limit

    def _without_false_returns(self, depth_m: np.ndarray, noise: float) -> np.ndarray:
        """Depth image (H, W) with NaN in pixels far from the median of their block.

        Also NaN in blocks far from the median of those around.
        """
        used, place = self._used, np.arange(len(self.pixel)) - np.repeat(self._starts, self._count)
        residual_m, root = used.residuals(depth_m), np.sqrt(used.precision)
        of_block = np.full((self.blocks, int(self._count.max())), np.nan, np.float32)
        of_block[used.block, place] = residual_m
        middle_m = row_median(of_block)
        row, column = np.divmod(self.block_number, self.columns)
        image = np.full((row.max() + 1 + 2 * _AROUND, self.columns + 2 * _AROUND), np.nan)
        image[row + _AROUND, column + _AROUND] = middle_m
        side = 2 * _AROUND + 1
        around = np.lib.stride_tricks.sliding_window_view(image, (side, side))[row, column]
        around_m = row_median(around.reshape(-1, side**2))
        far = np.abs(middle_m - around_m) > side * self.mesh.edge_length
        lone = np.abs(residual_m - middle_m[used.block]) * root > self._limit(root, noise)
        kept = depth_m.copy()
        kept.ravel()[used.number[lone | far[used.block]]] = np.nan
        return kept

    def observe_everything(self) -> Observation:
        """Noise-free observation of the untouched membrane by all pixels in use."""
        return Observation(np.zeros_like(self._total), self._weight(self._total), 1.0)

    def _weight(self, precision: np.ndarray, rounding: np.ndarray | float = 0.0) -> np.ndarray:
        """1/σ² of the block means: noise averages out over pixels, errors of facets do not."""
        return precision / (1.0 + precision * (self.facet_error_m**2 + rounding))

    def _visible_at_rest(self, hits: Hits) -> Hits:
        return hits.of(np.isfinite(self._rest_range[hits.ray]))

    def misfit(
        self, observation: Observation, block: np.ndarray, error_m: np.ndarray, noise: float
    ) -> Misfit:
        """Statistics of the residuals (k,) of some blocks, with a noise factor."""
        weight = observation.weight[block] / observation.trusted
        total = float(weight.sum())
        if total == 0.0:
            return Misfit(np.nan, np.inf, 1.0, 0.0)
        z = error_m * np.sqrt(weight)
        square = float(z @ z)
        sums = np.bincount(self._squares.of_block[block], z)
        return Misfit(
            rms_m=float(np.sqrt(square / total)),
            deviations=float(median(np.abs(z[weight > 0.0])) / MAD),
            clumping=float(sums @ sums) / max(square, 1e-300),
            regional=self._squares.largest_median(
                block,
                error_m,
                weight / noise**2,
                self._model_error_m,
            ),
        )

    def model_errors(self, block: np.ndarray) -> np.ndarray:
        """Errors (k, s) of the blocks' ranges, m, that a correct model leaves.

        One standard deviation in each square of the image; squares are independent.
        """
        _, square = np.unique(self._squares.of_block[block], return_inverse=True)
        errors = np.zeros((len(block), int(square.max(initial=-1)) + 1))
        errors[np.arange(len(block)), square] = self._model_error_m
        return errors

    def noise_factor(
        self,
        observation: Observation,
        block: np.ndarray,
        error_m: np.ndarray,
        steady: bool = False,
    ) -> float:
        """Noise factor of errors (k,) of some blocks, see `BlockSquares.noise_factor`.

        Below 1 it is an upper limit (95 %), and at least the error of the mesh's facets.
        """
        weight = observation.weight[block] / observation.trusted
        found = self._squares.noise_factor(block, error_m * np.sqrt(weight), steady)
        if found >= 1.0:
            return found
        facets = self.facet_error_m * float(np.sqrt(np.median(weight[weight > 0.0])))
        return max(facets, min(1.0, UPPER_95 * found))

    def around(
        self,
        nodes: np.ndarray,  # (n, 3), in B, m
        # of an earlier shape: if near, rays walk on from the triangles that they met there
        last: ShapeRanges | None = None,
        shift_m: np.ndarray | None = None,  # (2,), `camera_shift`
    ) -> ShapeRanges:
        """Model of the block residuals, linearised at a shape.

        It includes what a shift changes beyond first order, which is in `image_errors`: a camera
        that has moved sees the contact elsewhere.
        """
        if shift_m is not None:
            nodes = nodes - self.camera.T_B_C[:3, :2] @ shift_m
        if last is not None and np.array_equal(nodes, last.nodes_m):
            return last
        if last is not None and np.abs(nodes - last.cast_at_m).max() <= self._walk_m:
            cast_at, hits = last.cast_at_m, self._caster.recast(nodes, last.hits)
        else:
            cast_at = nodes
            hits = self._visible_at_rest(self._caster.cast(nodes, near=self._at_rest))
        model = np.zeros(self.blocks)
        model[hits.ray] = hits.range_m - self._rest_range[hits.ray]
        if shift_m is not None:
            model[hits.ray] -= self.image_errors[hits.ray, SHIFTS] @ shift_m
        slopes = self._caster.slopes(nodes, hits)
        values = (hits.barycentric[:, :, None] * slopes[:, None]).reshape(-1, 9)
        jacobian = sparse_rows(values, self._columns[hits.triangle], nodes.size)
        return ShapeRanges(hits.ray, model, jacobian, hits, cast_at, nodes)


def row_median(values: np.ndarray) -> np.ndarray:
    """Median (b,) of each row of values (b, k), some NaN; half may be outliers."""
    ordered = np.sort(values, axis=1)  # NaN last
    count = np.count_nonzero(~np.isnan(ordered), axis=1)
    row, last = np.arange(len(values)), np.maximum(count - 1, 0)
    middle: np.ndarray = ordered[row, last // 2] + ordered[row, np.minimum(count // 2, last)]
    return 0.5 * middle


def _from_median(values: np.ndarray) -> np.ndarray:
    """Distances of values (b, k), some NaN, from the median of their row."""
    distance: np.ndarray = np.abs(values - row_median(values)[:, None])
    return distance


def _huber_weights(squares: np.ndarray) -> np.ndarray:
    """Weights of pixels by their squared residual in σ²; NaN for NaN."""
    weights: np.ndarray = np.minimum(1.0, _HUBER / np.sqrt(np.maximum(squares, 1e-12)))
    return weights


def facet_error(mesh: MembraneMesh) -> float:
    """Distance in m between flat facets and the surface they approximate: the median sagitta."""
    return float(np.median(sagittas(mesh)))


def sagittas(mesh: MembraneMesh) -> np.ndarray:
    """Distance of the sides of every triangle from the arcs they approximate, (m, 3), m."""
    i, j = mesh.triangles, np.roll(mesh.triangles, -1, axis=1)
    edge = mesh.nodes[j] - mesh.nodes[i]
    turn = np.einsum("ijk,ijk->ij", mesh.normals[j] - mesh.normals[i], edge)
    sagitta: np.ndarray = np.abs(turn) / 8.0
    return sagitta
