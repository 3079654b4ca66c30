"""Check of a sensor file against contact-free frames, and the force error of a misfit.

The mean of the frames is compared with the range that the sensor file predicts, with the blocks of
pixels and the noise of the estimator. A change is explained by up to three causes, each with a
known pattern over the image: an offset of depth, its scale, and the gas pressure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Literal

import numpy as np
from scipy.special import chdtri, ndtr

from bubbleviz.camera import BlockSquares, DepthCamera
from bubbleviz.errors import InputError, SolveError
from bubbleviz.files import table
from bubbleviz.membrane import Inflation
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import (
    MIN_FRAMES,
    SIGNIFICANT,
    WEATHER_PA,
    Frame,
    error_of_mean,
    gas_warning,
    mean_inflation,
    temporal_correlation,
)
from bubbleviz.result import HALF_95
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation import SyntheticSource, touching_height
from bubbleviz.wording import count_of, decimals_of, rounded

CheckVerdict = Literal["fits", "drifted", "another"]

OFFSET, SCALE, GAS = "depth offset", "depth scale", "gas pressure change from the shape"
_UNITS = {OFFSET: ("mm", 1e3), SCALE: ("%", 1e2), GAS: ("Pa", 1.0)}
_REMEDY = {
    True: "inflate the sensor to the gauge pressure in its file, or identify it again",
    False: "let the camera warm up, then identify the sensor again, untouched",
}

_STEP = 0.01  # of the gauge pressure, for the first secant of its pattern
_SECANTS, _MAX_STEP = 4, 0.5  # iterations, and the largest step over the gauge pressure
_ROBUST_ROUNDS = 3  # of weighting pixels by their distance from the median of their block
_PRESS_DEPTH = 0.15  # over the dome's height, of the press that converts drift to force; chosen


@dataclass(frozen=True)
class CheckRow:
    """One quantity of a check."""

    quantity: str
    unit: str  # of the text; `factor` times SI
    factor: float
    value: float  # SI
    half_width: float | None = None  # half of the 95 % interval
    limit: float | None = None  # absolute value beyond which this quantity alone is a misfit
    todo: str = ""  # remedy; empty where the value is within its limit

    def texts(self) -> tuple[str, ...]:
        """Cells of a row of the table."""
        digits = decimals_of(self.factor * (self.half_width or self.limit or 0.0), 3)
        value, half, limit = (
            "" if number is None else rounded(self.factor * number, digits)
            for number in (self.value, self.half_width, self.limit)
        )
        cells = f"{value} {self.unit}", half and f"± {half}", limit and f"± {limit}"
        return self.quantity, *cells, self.todo


@dataclass(frozen=True)
class SensorCheck:
    """Verdict on a sensor file from contact-free frames."""

    verdict: CheckVerdict
    reason: str  # one line, with the remedy
    rows: tuple[CheckRow, ...]
    frames: tuple[int, int]  # first and last
    bias_m: float  # mean of measured minus expected z-depth, m
    # χ² of the mean image per block of pixels, and its limit by noise alone
    chi2_per_block: float
    chi2_limit: float
    # force of a simulated press, and the error that the drift causes in its estimate, N; None:
    # unknown
    press_n: float | None = None
    force_error_n: float | None = None

    def to_text(self) -> str:
        """The verdict, and the table below it."""
        header = "quantity", "value", "95 %", "limit", "what to do"
        return f"{self.reason}\n\n{table(header, [row.texts() for row in self.rows])}"


def check_sensor(
    model: SensorModel,  # with the camera of the frames
    frames: Sequence[Frame],  # without contact
    *,
    quick: bool = False,  # no table where it fits, and no force
) -> SensorCheck:
    """Compare contact-free frames of one camera with a sensor file.

    Raises InputError: too few frames, a half-hidden membrane, or contact in all frames.
    """
    if len(frames) < MIN_FRAMES:
        count = count_of(len(frames), "contact-free frame")
        raise InputError(f"only {count}; give or record at least {MIN_FRAMES}")
    depths = [frame.depth_m for frame in frames]
    rest = _RestComparison(model, depths)
    camera = _camera_row(model, rest)
    fits = rest.chi2 <= rest.chi2_limit and not camera.todo
    rows = () if quick and fits else (*rest.rows(), camera, *_gas_rows(model, frames, rest))
    found = SensorCheck(
        verdict="fits",
        reason=f"fits: depth within {1e3 * rest.change_limit_m:.2f} mm rms of the sensor file",
        rows=rows,
        frames=(frames[0].index, frames[-1].index),
        bias_m=rest.bias_m,
        chi2_per_block=rest.chi2,
        chi2_limit=rest.chi2_limit,
    )
    if fits:
        return found
    if camera.todo:
        return replace(found, verdict="another", reason=_another_camera(model, camera))
    turned = [depth[::-1, ::-1] for depth in depths]
    if not rest.explained and _RestComparison(model, turned).explained:
        reason = (
            "another camera, or mounted the other way: the images are turned by 180°; turn the "
            "camera back, or identify the sensor again"
        )
        return replace(found, verdict="another", reason=reason)
    pipeline = Pipeline(model)
    if _contact_explains(pipeline, frames[0], rest):
        raise InputError(
            "no contact-free frames: a contact explains these frames better than a drift does; "
            "record the sensor untouched, or choose contact-free frames"
        )
    if not rest.explained:
        reason = "another membrane or camera, or the camera moved: identify the sensor again"
        return replace(found, verdict="another", reason=reason)
    causes = [row for row in rest.rows()[:-1] if row.todo]
    largest = max(causes, key=lambda row: abs(row.value) / (row.limit or 1.0), default=None)
    names = ", ".join(f"{row.quantity} {row.texts()[1]}" for row in causes)
    press, error = _force_error(pipeline, rest) if not quick else (None, None)
    force = "" if error is None else f", which changes a force of {press:.2g} N by {error:.2g} N"
    reason = (
        f"drifted by {1e3 * rest.bias_m:+.2f} mm in mean depth{force} "
        f"({names or 'pattern of the pixels'}): {largest.todo if largest else _REMEDY[False]}"
    )
    return replace(found, verdict="drifted", reason=reason, press_n=press, force_error_n=error)


class _RestComparison:
    """Mean of contact-free images against the prediction of a sensor file, by blocks of pixels."""

    def __init__(self, model: SensorModel, depths_m: Sequence[np.ndarray]) -> None:
        self.model, self.observer = model, model.observer()
        measured = [self.observer.measure(depth) for depth in depths_m]
        residuals = np.array([self.observer.weigh(each).residual_m for each in measured])
        for _ in range(_ROBUST_ROUNDS):
            middle = np.median(residuals, axis=0)
            residuals = np.array(
                [self.observer.weigh(each, middle).residual_m for each in measured]
            )
        totals = np.array([each.total for each in measured])
        by_offset, *_, by_scale = self.observer.image_errors.T
        self._visible = np.asarray((totals > 0.0).all(axis=0) & (by_offset > 0.0))
        # derivative of the residuals (B,) by an offset and by the scale of depth
        self._by_offset, self._by_scale = by_offset[self._visible], by_scale[self._visible]
        if 2 * self._visible.sum() < len(self._visible):
            raise InputError(
                "the part of the membrane with valid depth in all frames is less than half; "
                "uncover the camera, or choose other frames"
            )
        # (F, B), residuals of the blocks, m
        self.frames_m = residuals[:, self._visible]
        self.mean_m = self.frames_m.mean(axis=0)
        # (B,), variance of a block in one frame, as in the estimator, and in the mean, m²
        self.frame_variance_m2 = 1.0 / self.observer.observe_everything().weight[self._visible]
        self.mean_variance_m2 = self._variance_of_mean(
            1.0 / np.median(totals[:, self._visible], axis=0)
        )
        # χ² per block that noise alone does not exceed
        self.chi2_limit = float(chdtri(len(self.mean_m), ndtr(-SIGNIFICANT)) / len(self.mean_m))

    def _variance_of_mean(self, noise_m2: np.ndarray) -> np.ndarray:
        """Variance of the frames' mean plus that of the sensor file's biases.

        Calibrated pixels have biases from the mean of at least as many frames as an identification
        requires. Without calibration the error of the mesh's flat facets remains.
        """
        moved = self.frames_m - self.mean_m
        spread = moved.std(axis=0)
        inflation = mean_inflation(temporal_correlation(moved[:, None], spread[None]))
        if self.model.pixels is None:
            facets_m2 = np.maximum(self.frame_variance_m2 - noise_m2, 0.0)
            return noise_m2 * inflation / len(moved) + facets_m2
        return noise_m2 * (inflation / len(moved) + 1.0 / MIN_FRAMES)

    def _detectable(self, pattern: float | np.ndarray, variance_m2: np.ndarray) -> float:
        """Size of a pattern (B,) of the blocks at which χ² is at its limit."""
        return float(np.sqrt(self.chi2_limit / np.mean(pattern**2 / variance_m2)))

    @property
    def change_limit_m(self) -> float:
        """Smallest rms change of the range that is significant, m."""
        return self._detectable(1.0, self.mean_variance_m2)

    @property
    def bias_m(self) -> float:
        """Mean of measured minus expected z-depth, m."""
        return float(
            np.average(self.mean_m / self._by_offset, weights=1.0 / self.frame_variance_m2)
        )

    @property
    def chi2(self) -> float:
        """χ² of the mean per block."""
        return float(np.mean(self.mean_m**2 / self.mean_variance_m2))

    @property
    def explained(self) -> bool:
        """Whether the residual without the causes is within the noise of one frame."""
        residual = self._without(self.causes)
        return bool(np.mean(residual**2 / self.frame_variance_m2) <= self.chi2_limit)

    @cached_property
    def patterns(self) -> dict[str, np.ndarray]:
        """Derivative of the residuals (B,) by each cause, in m, 1 and Pa."""
        found = {OFFSET: self._by_offset, SCALE: self._by_scale}
        at_rest = self._observed(self.expected_depth_m())
        gauge = self.model.sensor.pneumatics.gauge_pressure_pa
        inflation, step = Inflation(self.model.rubber), _STEP * gauge
        for _ in range(_SECANTS):  # the response to pressure is nonlinear
            try:
                moved = inflation.at(gauge + step) - self.model.mesh.nodes
            except SolveError:  # inflated to its limit
                break
            pattern = (self._observed(self.expected_depth_m(moved)) - at_rest) / step
            found[GAS] = pattern
            weighted = pattern / self.mean_variance_m2
            limit = _MAX_STEP * gauge
            size = float(np.clip(weighted @ self.mean_m / (weighted @ pattern), -limit, limit))
            if abs(size) < _STEP * gauge:
                break
            step = size
        return found

    def expected_depth_m(self, moved_m: np.ndarray | None = None) -> np.ndarray:
        """z-depth image (H, W) of the membrane at rest, or displaced by (n, 3), with pixel bias."""
        view, pixels = self.model.view, self.model.pixels
        ranges = view.rest_range if moved_m is None else view.range_image(moved_m)
        if pixels is not None:
            ranges = ranges + np.where(pixels.mask, pixels.bias_m, 0.0)
        return self.model.camera.depth_image(ranges)

    def drift_m(self) -> np.ndarray:
        """Change of the z-depth image (H, W), by blocks, m; 0 where unknown."""
        side, columns = self.observer.block, self.observer.columns
        row, column = np.indices(self.model.view.shape) // side
        block = row * columns + column
        change = np.zeros(block.max() + 1)
        change[self.observer.block_number[self._visible]] = self.mean_m
        return np.asarray(change[block] / self.model.camera.range_per_depth)

    def _observed(self, depth_m: np.ndarray) -> np.ndarray:
        return self.observer.observe(depth_m.astype(np.float32)).residual_m[self._visible]

    @cached_property
    def causes(self) -> tuple[str, ...]:
        """Set of causes with the smallest BIC; empty where the change is not significant."""
        if self.chi2 <= self.chi2_limit:
            return ()
        sets = [c for k in range(len(self.patterns) + 1) for c in combinations(self.patterns, k)]
        penalty = np.log(len(self.mean_m))

        def bic(causes: tuple[str, ...]) -> float:
            squares = self._without(causes) ** 2 / self.mean_variance_m2
            return float(np.sum(squares) + penalty * len(causes))

        return min(sets, key=bic)

    def _influence(self, causes: tuple[str, ...]) -> np.ndarray:
        """Derivative of each cause's size by each block (k, B), in weighted least squares."""
        X = np.stack([self.patterns[name] for name in causes], axis=1)
        weighted = X.T / self.mean_variance_m2
        return np.asarray(np.linalg.solve(weighted @ X, weighted))

    def _without(self, causes: tuple[str, ...]) -> np.ndarray:
        """The mean residual (B,) minus the fitted causes, m."""
        if not causes:
            return self.mean_m
        sizes = self._influence(causes) @ self.mean_m
        return np.asarray(self.mean_m - sizes @ [self.patterns[name] for name in causes])

    def size(self, cause: str) -> tuple[float, float]:
        """Size of a cause, fitted with the other causes, and half of its 95 % interval.

        The interval combines the variation between frames with the residuals of squares of blocks.
        """
        causes = tuple(dict.fromkeys((*self.causes, cause)))
        influence = self._influence(causes)[causes.index(cause)]
        squares = BlockSquares(self.observer.block_number[self._visible], self.observer.columns)
        scores = np.bincount(squares.of_block, influence * self._without(causes))
        sigma = np.hypot(error_of_mean(self.frames_m @ influence), np.linalg.norm(scores))
        return float(influence @ self.mean_m), HALF_95 * float(sigma)

    def rows(self) -> list[CheckRow]:
        """The causes, and the residual without them."""
        rows = []
        for name in self.patterns:
            limit = self._detectable(self.patterns[name], self.mean_variance_m2)
            size, half = self.size(name)
            significant = name in self.causes and abs(size) > limit and self.explained
            remedy = _REMEDY[name == GAS] if significant else ""
            rows.append(CheckRow(name, *_UNITS[name], size, half, limit, remedy))
        remedy = "" if self.explained else "identify the sensor again"
        limit_m = self._detectable(1.0, self.frame_variance_m2)
        rows.append(CheckRow("rest shape, rms", "mm", 1e3, self.shape_m, None, limit_m, remedy))
        return rows

    @property
    def shape_m(self) -> float:
        """Rms over the blocks of the residual without the causes, m."""
        residual = self._without(self.causes)
        return float(np.sqrt(np.average(residual**2, weights=1.0 / self.frame_variance_m2)))


def _camera_row(model: SensorModel, rest: _RestComparison) -> CheckRow:
    """Rms change of the expected ranges by the intrinsics of the recording."""
    change_m, limit_m = model.camera_change_m, rest.change_limit_m
    remedy = "choose the sensor file of this camera" if change_m > limit_m else ""
    return CheckRow("camera info, rms", "mm", 1e3, change_m, None, limit_m, remedy)


def _gas_rows(model: SensorModel, frames: Sequence[Frame], rest: _RestComparison) -> list[CheckRow]:
    """Measured gas pressure minus the sensor file's, which may differ by the weather."""
    gas = np.array([np.nan if f.gas_pressure_pa is None else f.gas_pressure_pa for f in frames])
    if not np.isfinite(gas).all():
        return []
    known = model.gas.P0
    difference = float(gas.mean()) - known
    inflation = rest.size(GAS)[0] if GAS in rest.causes else 0.0
    half = HALF_95 * error_of_mean(gas)
    remedy = gas_warning(float(gas.mean()) - inflation, known)
    return [
        CheckRow("gas pressure change measured", "Pa", 1.0, difference, half, WEATHER_PA, remedy)
    ]


def _another_camera(model: SensorModel, row: CheckRow) -> str:
    in_file, recorded = DepthCamera.of(model.sensor.camera).intrinsics, model.camera.intrinsics
    new, old = (
        f"fx {each.fx:.1f}, fy {each.fy:.1f}, cx {each.cx:.1f}, cy {each.cy:.1f}"
        for each in (recorded, in_file)
    )
    return (
        f"another camera: its intrinsics ({new} pixels) change the ranges by "
        f"{1e3 * row.value:.2g} mm rms from those of the sensor file ({old}): {row.todo}, or "
        "identify the sensor again"
    )


def _contact_explains(pipeline: Pipeline, frame: Frame, rest: _RestComparison) -> bool:
    """Whether a contact explains the images better than the causes of a drift."""
    mean = (rest.expected_depth_m() + rest.drift_m()).astype(np.float32)
    found = pipeline.estimate_once(replace(frame, depth_m=mean, gas_pressure_pa=None))
    return found.status == "ok" and found.residual_rms_m < rest.shape_m


def _force_error(pipeline: Pipeline, rest: _RestComparison) -> tuple[float | None, float | None]:
    """Force of a simulated press of a ball on the apex, and the change of its estimate by drift, N.

    Both None where either cannot be computed.
    """
    model = pipeline.model
    mesh, ball = model.mesh, load_object("sphere")
    top, pose = int(np.argmax(mesh.nodes[:, 2])), np.eye(4)
    pose[:2, 3] = mesh.nodes[top, :2]
    pose[2, 3] = touching_height(ball, pose, mesh) - _PRESS_DEPTH * mesh.nodes[top, 2]
    try:
        press = SyntheticSource(model.sensor, ball, pose[None])[0]
    except (InputError, SolveError):
        return None, None
    pixels = model.pixels
    bias = 0.0 if pixels is None else np.where(pixels.mask, pixels.bias_m, 0.0)
    undrifted = model.camera.depth_image(press.depth_m * model.camera.range_per_depth + bias)
    forces = []
    for depth in (undrifted, undrifted + rest.drift_m()):
        frame = replace(press, depth_m=depth.astype(np.float32))
        pipeline.restart()
        result = pipeline.process(frame, frozenset({"patch"}))
        if result.estimate is None or result.patch is None or not result.estimate.trusted:
            return None, None
        forces.append(result.patch.force_n)
    return float(np.linalg.norm(forces[0])), float(np.linalg.norm(forces[1] - forces[0]))
