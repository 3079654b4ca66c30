"""Check of a sensor file against contact-free frames, and the force error of a misfit.

The mean of the frames is compared with the range that the sensor file predicts, with the blocks of
pixels and the noise of the estimator. A least-squares fit explains a change by errors of the whole
image, as in the estimator, and by the gas pressure; its effect on the shape is uncertain, as the
material is.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Literal

import numpy as np
from scipy.special import chdtri, ndtr

from bubbleviz.calibration.fit_errors import height_rings, jackknife_errors, tile_errors
from bubbleviz.calibration.identification import PRESSURE_ERROR
from bubbleviz.calibration.reference_press import press_force, reference_press
from bubbleviz.camera import IMAGE_ERRORS, BlockSquares, DepthCamera
from bubbleviz.errors import InputError, SolveError
from bubbleviz.files import table
from bubbleviz.membrane import Inflation, rubber_and_variants
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
from bubbleviz.sensor import WEATHER_SIGMA_PA
from bubbleviz.sensor_model import SensorModel
from bubbleviz.wording import count_of, decimals_of, rounded

CheckVerdict = Literal["fits", "drifted", "another"]

_CAUSES = {
    "depth offset": "m",
    "depth tilt to the right, at 45°": "m",
    "depth tilt downwards, at 45°": "m",
    "depth scale": "1",
    "camera shift to the right": "m",
    "camera shift downwards": "m",
    "gas pressure change from the shape": "Pa",
}
"""Unit of each cause: those of `IMAGE_ERRORS`, and the gas pressure."""
_SHOWN = {"m": ("mm", 1e3), "1": ("%", 1e2)}  # in the text
_GAS = len(IMAGE_ERRORS)  # place of the gas pressure among the causes
_MOUNTING = "check the camera's mounting, then identify the sensor again, untouched"
_WARM_UP = (
    "let the camera warm up and check its mounting, then identify the sensor again, untouched"
)
_INFLATE = "inflate the sensor to the gauge pressure in its file, or identify it again"

_STEP = 0.01  # of the gauge pressure, for the first secant of its pattern
_SECANTS, _MAX_STEP = 4, 0.5  # iterations, and the largest step over the gauge pressure
_ROBUST_ROUNDS = 3  # of weighting pixels by their distance from the median of their block


@dataclass(frozen=True)
class CheckRow:
    """One quantity of a check."""

    quantity: str
    unit: str  # SI, or °C
    value: float | None  # SI; None: not determined
    half_width: float | None = None  # half of the 95 % interval
    limit: float | None = None  # absolute value beyond which this quantity alone is a misfit
    todo: str = ""  # remedy; empty where the value is within its limit

    def texts(self) -> tuple[str, ...]:
        """Cells of a row of the table."""
        unit, factor = _SHOWN.get(self.unit, (self.unit, 1.0))
        digits = decimals_of(factor * (self.half_width or self.limit or 0.0), 3)
        value, half, limit = (
            "" if number is None else rounded(factor * number, digits)
            for number in (self.value, self.half_width, self.limit)
        )
        cells = value or "needs λ", half and f"± {half}", value and unit, limit and f"± {limit}"
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
        texts = [row.texts() for row in self.rows]
        width = max((len(row.todo) for row in self.rows), default=0)
        header = "quantity", "value", "95 %", "unit", "limit", "what to do".ljust(width)
        aligned = [(*cells, todo.ljust(width)) for *cells, todo in texts]
        return f"{self.reason}\n\n{table(header, aligned)}"


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
    rest = _RestComparison(model, frames)
    change_m, limit_m = model.camera_change_m, rest.change_limit_m
    todo = "choose the sensor file of this camera" if change_m > limit_m else ""
    camera = CheckRow("camera info, rms", "m", change_m, None, limit_m, todo)
    fits = rest.chi2 <= rest.chi2_limit and not camera.todo
    rows = [] if quick and fits else rest.rows()
    found = SensorCheck(
        verdict="fits",
        reason=f"fits: depth within {1e3 * rest.change_limit_m:.2f} mm rms of the sensor file",
        rows=(*rows, camera, *rest.gas_rows(rows[_GAS])) if rows else (),
        frames=(frames[0].index, frames[-1].index),
        bias_m=rest.bias_m,
        chi2_per_block=rest.chi2,
        chi2_limit=rest.chi2_limit,
    )
    if fits:
        return found
    if camera.todo:
        return replace(found, verdict="another", reason=_another_camera(model, camera))
    turned = [replace(frame, depth_m=frame.depth_m[::-1, ::-1]) for frame in frames]
    if rest.shape.todo and not _RestComparison(model, turned).shape.todo:
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
    if rest.shape.todo:
        reason = "another membrane or camera, or the camera moved: identify the sensor again"
        return replace(found, verdict="another", reason=reason)
    causes = [row for row in rows if row.todo]
    largest = max(causes, key=lambda row: abs(row.value or 0.0) / (row.limit or 1.0), default=None)
    names = ", ".join(" ".join(filter(None, row.texts()[:4])) for row in causes)
    press, error = _force_error(pipeline, rest) if not quick else (None, None)
    force = "" if error is None else f", which changes a force of {press:.2g} N by {error:.2g} N"
    reason = (
        f"drifted by {1e3 * rest.bias_m:+.2f} mm in mean depth{force} "
        f"({names or 'pattern of the pixels'}): {largest.todo if largest else _MOUNTING}"
    )
    return replace(found, verdict="drifted", reason=reason, press_n=press, force_error_n=error)


class _RestComparison:
    """Mean of contact-free images against the prediction of a sensor file, by blocks of pixels."""

    def __init__(self, model: SensorModel, frames: Sequence[Frame]) -> None:
        self.model, self.observer = model, model.observer()
        measured = [self.observer.measure(frame.depth_m) for frame in frames]
        residuals = np.array([self.observer.weigh(each).residual_m for each in measured])
        for _ in range(_ROBUST_ROUNDS):
            middle = np.median(residuals, axis=0)
            residuals = np.array(
                [self.observer.weigh(each, middle).residual_m for each in measured]
            )
        totals, by_image = np.array([each.total for each in measured]), self.observer.image_errors
        self._visible = np.asarray((totals > 0.0).all(axis=0) & (by_image[:, 0] > 0.0))
        if 2 * self._visible.sum() < len(self._visible):
            raise InputError(
                "the part of the membrane with valid depth in all frames is less than half; "
                "uncover the camera, or choose other frames"
            )
        self._by_image = by_image[self._visible]
        blocks = self.observer.block_number[self._visible]
        self._squares = BlockSquares(blocks, self.observer.columns)
        self._ring = height_rings(self.observer)[self._visible]
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
        gas = np.array([frame.gas_pressure_pa for frame in frames], float)
        # measured gas pressure minus the sensor file's, and its standard error; NaN: not measured
        self.gas_change_pa = float(np.mean(gas)) - model.gas.P0
        self.gas_error_pa = error_of_mean(gas)

    def _variance_of_mean(self, noise_m2: np.ndarray) -> np.ndarray:
        """Variance of the frames' mean plus that of the sensor file's biases.

        Calibrated pixels have biases from the mean of at least as many frames as an identification
        requires. Without calibration the error of the mesh's flat facets remains.
        """
        moved = self.frames_m - self.mean_m
        spread = moved.std(axis=0)
        inflation = mean_inflation(temporal_correlation(moved[:, None], spread[None]))
        if self.model.pixels is None:
            return noise_m2 * inflation / len(moved) + self.observer.facet_error_m**2
        return noise_m2 * (inflation / len(moved) + 1.0 / MIN_FRAMES)

    def _detectable(self, pattern: float | np.ndarray, variance_m2: np.ndarray) -> float:
        """Size of a pattern (B,) of the blocks at which χ² is at its limit."""
        strength = np.mean(pattern**2 / variance_m2)
        return float(np.sqrt(self.chi2_limit / max(strength, np.finfo(float).tiny)))

    @property
    def change_limit_m(self) -> float:
        """Smallest rms change of the range that is significant, m."""
        return self._detectable(1.0, self.mean_variance_m2)

    @property
    def bias_m(self) -> float:
        """Mean of measured minus expected z-depth, m."""
        return float(
            np.average(self.mean_m / self._by_image[:, 0], weights=1.0 / self.frame_variance_m2)
        )

    @property
    def chi2(self) -> float:
        """χ² of the mean per block."""
        return self._chi2_without(())

    def _chi2_without(self, causes: tuple[int, ...]) -> float:
        """The same after the causes were fitted."""
        return float(np.mean(self._without(causes) ** 2 / self.mean_variance_m2))

    @cached_property
    def shape(self) -> CheckRow:
        """Residual without the causes; if it is the noise of one frame, they explain the change."""
        square = np.average(self._without(self.causes) ** 2, weights=1.0 / self.frame_variance_m2)
        rms_m, limit_m = float(np.sqrt(square)), self._detectable(1.0, self.frame_variance_m2)
        todo = "identify the sensor again" if rms_m > limit_m else ""
        return CheckRow("rest shape, rms", "m", rms_m, None, limit_m, todo)

    @cached_property
    def _by_gas(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivative of the residuals by the gas pressure, (B,), m/Pa, and its errors (k, B).

        The errors are changes of it by one standard deviation of each material parameter. The
        response is nonlinear: these are secants to the change of pressure that explains the most.
        """
        sensor, mesh = self.model.sensor, self.model.mesh
        gauge = sensor.pneumatics.gauge_pressure_pa
        rubber, varied = rubber_and_variants(sensor, mesh, self.model.tension_n_per_m)
        inflation, materials = Inflation(rubber), [Inflation(each) for each in varied]
        secants, step = [], _STEP * gauge
        for _ in range(_SECANTS):
            try:
                by_gas = self._moved_m(inflation, step) / step
            except SolveError:  # inflated to its limit
                break
            secants.append((by_gas, step))
            weighted = by_gas / self.mean_variance_m2
            size = float(weighted @ self.mean_m / (weighted @ by_gas))
            if abs(size) < _STEP * gauge:
                break
            step = float(np.clip(size, -_MAX_STEP * gauge, _MAX_STEP * gauge))
        for by_gas, step in reversed(secants):
            try:
                others = [self._moved_m(each, step) / step for each in materials]
            except SolveError:  # a softer one has a lower limit
                continue
            return by_gas, np.stack([each - by_gas for each in (by_gas, *others)])
        return 0.0 * self.mean_m, 0.0 * self.mean_m[None]

    def _moved_m(self, membrane: Inflation, change_pa: float) -> np.ndarray:
        """Change of the range of the blocks (B,) by that of the gas pressure, m."""
        nodes = membrane.at(membrane.membrane.gauge_pressure_pa + change_pa)
        return self.observer.around(nodes).model_m[self._visible]

    @cached_property
    def patterns(self) -> np.ndarray:
        """Derivative of the residuals by each cause, (B, c), see `_CAUSES`."""
        return np.column_stack([self._by_image, self._by_gas[0]])

    @cached_property
    def causes(self) -> tuple[int, ...]:
        """Numbers of the causes, all of them beyond their intervals and limits.

        None if the change is not significant. Otherwise causes are added until χ² per block is at
        most 1, the value of noise: for each number of causes those with the least χ².
        """
        chosen: tuple[int, ...] = ()
        limit = self.chi2_limit
        while len(chosen) < len(_CAUSES) and self._chi2_without(chosen) > limit:
            best = min(combinations(range(len(_CAUSES)), len(chosen) + 1), key=self._chi2_without)
            for cause in best:
                # errors of the material scale the effect of the gas: they matter only for its size
                size, half = self._size(cause, best, material=cause != _GAS)
                if abs(size) <= max(half, self._limit(cause)):
                    return chosen
            chosen, limit = best, 1.0
        return chosen

    def _limit(self, cause: int) -> float:
        """Size beyond which a cause alone is a misfit."""
        return self._detectable(self.patterns[:, cause], self.mean_variance_m2)

    @property
    def _inflation(self) -> tuple[float, float]:
        """Change of the gas pressure behind the membrane as measured, and its σ, Pa.

        As in an identification, weather may have caused the change, but does not hide one.
        """
        if not np.isfinite(self.gas_change_pa):
            return 0.0, np.inf
        weather = min(abs(self.gas_change_pa), WEATHER_SIGMA_PA)
        drift = PRESSURE_ERROR * self.model.sensor.pneumatics.gauge_pressure_pa
        return self.gas_change_pa, float(np.linalg.norm([self.gas_error_pa, weather, drift]))

    def _influence(self, causes: Sequence[int], kept: np.ndarray | float = 1.0) -> np.ndarray:
        """Derivative of each cause's size by each block (k, B), in weighted least squares."""
        X = self.patterns[:, causes]
        weighted = X.T * kept / self.mean_variance_m2
        return np.asarray(np.linalg.solve(weighted @ X, weighted))

    def _without(self, causes: Sequence[int]) -> np.ndarray:
        """The mean residual (B,) minus the fitted causes, m."""
        if not causes:
            return self.mean_m
        sizes = self._influence(causes) @ self.mean_m
        return np.asarray(self.mean_m - self.patterns[:, causes] @ sizes)

    def _size(
        self, cause: int, causes: Iterable[int], *, material: bool = True
    ) -> tuple[float, float]:
        """Size of a cause fitted with others, and half of its 95 % interval.

        From the images and the measured gas pressure. The interval combines the variation between
        frames (about a straight line, as a continuing drift is not noise), the residuals of squares
        of blocks, the differences between rings from rim to top, and the error of the material
        unless it is left out.
        """
        causes = (cause, *(each for each in causes if each != cause))
        influence, left_m = self._influence(causes), self._without(causes)
        sizes, squares = influence @ self.mean_m, self._squares.of_block
        of_gas = np.array([each == _GAS for each in causes], float)
        varied, time = influence @ self.frames_m.T, np.linspace(-1.0, 1.0, len(self.frames_m))
        varied -= np.outer(varied @ time, time) / (time @ time)
        errors = [
            np.array([[error_of_mean(each, fitted=2)] for each in varied]),
            tile_errors(influence.T, left_m, squares, len(causes)).T,
            jackknife_errors(lambda kept: self._influence(causes, kept) @ left_m, self._ring).T,
            material * (of_gas @ sizes) * influence @ self._by_gas[1].T,
        ]
        every = np.hstack(errors)
        covariance = every @ every.T
        by_gas = covariance @ of_gas
        measured_pa, sigma_pa = self._inflation
        gain = by_gas[0] / (of_gas @ by_gas + sigma_pa**2)
        size = sizes[0] + gain * (measured_pa - of_gas @ sizes)
        return float(size), HALF_95 * float(np.sqrt(covariance[0, 0] - gain * by_gas[0]))

    def drift_m(self) -> np.ndarray:
        """Change of the z-depth image (H, W), by blocks, m; 0 where unknown."""
        side, columns = self.observer.block, self.observer.columns
        height, width = self.model.view.shape
        change = np.zeros((-(-height // side), columns))
        change.ravel()[self.observer.block_number[self._visible]] = self.mean_m
        image = change.repeat(side, axis=0).repeat(side, axis=1)[:height, :width]
        return np.asarray(image / self.model.camera.range_per_depth)

    def rows(self) -> list[CheckRow]:
        """The causes, and the residual without them.

        Offset, scale and gas pressure change similar patterns. If more than one cause is found,
        none is excluded, and all are fitted together.
        """
        rows, together = [], self.causes if len(self.causes) < 2 else range(len(_CAUSES))
        for k, (name, unit) in enumerate(_CAUSES.items()):
            size, half = self._size(k, together)
            remedy = _INFLATE if k == _GAS else _MOUNTING if "shift" in name else _WARM_UP
            found = k in self.causes and not self.shape.todo
            rows.append(CheckRow(name, unit, size, half, self._limit(k), remedy if found else ""))
        if self.model.sensor.membrane.prestretch is None:  # the stiffness is unknown
            rows[_GAS] = replace(rows[_GAS], value=None, half_width=None, limit=None)
        return [*rows, self.shape]

    def gas_rows(self, by_shape: CheckRow) -> list[CheckRow]:
        """Measured change of the gas pressure, which may be the weather's as well."""
        if not np.isfinite(self.gas_change_pa):
            return []
        known = self.model.gas.P0
        weather = self.gas_change_pa - ((by_shape.value or 0.0) if by_shape.todo else 0.0)
        large = abs(weather) > WEATHER_PA
        remedy = gas_warning(known + self.gas_change_pa, known) if large else ""
        change = self.gas_change_pa, HALF_95 * self.gas_error_pa, WEATHER_PA, remedy
        return [CheckRow("gas pressure change measured", "Pa", *change)]


def _another_camera(model: SensorModel, row: CheckRow) -> str:
    in_file, recorded = DepthCamera.of(model.sensor.camera).intrinsics, model.camera.intrinsics
    new, old = (
        f"fx {each.fx:.1f}, fy {each.fy:.1f}, cx {each.cx:.1f}, cy {each.cy:.1f} pixels"
        for each in (recorded, in_file)
    )
    if new == old:
        new, old = (
            " ".join(["distortion", each.distortion_model, *(f"{k:.3g}" for k in each.distortion)])
            for each in (recorded, in_file)
        )
    return (
        f"another camera: its intrinsics ({new}) change the ranges by "
        f"{1e3 * model.camera_change_m:.2g} mm rms from those of the sensor file ({old}): "
        f"{row.todo}, or identify the sensor again"
    )


def _contact_explains(pipeline: Pipeline, frame: Frame, rest: _RestComparison) -> bool:
    """Whether a contact explains the images better than the causes of a drift."""
    model = pipeline.model
    mean = model.biased_depth(model.view.rest_range) + rest.drift_m()
    frame = replace(frame, depth_m=mean.astype(np.float32), gas_pressure_pa=None)
    found = pipeline.estimate_once(frame)
    return found.status == "ok" and found.residual_rms_m < (rest.shape.value or 0.0)


def _force_error(pipeline: Pipeline, rest: _RestComparison) -> tuple[float | None, float | None]:
    """Force of a simulated press, and the change of its estimate by drift, N.

    Both None where either cannot be computed.
    """
    press = reference_press(pipeline)
    if press is None:
        return None, None
    depth_m = (press.frame.depth_m + rest.drift_m()).astype(np.float32)
    before = press_force(pipeline, press.frame)
    after = press_force(pipeline, replace(press.frame, depth_m=depth_m))
    if before is None or after is None:
        return None, None
    return float(np.linalg.norm(before[0])), float(np.linalg.norm(after[0] - before[0]))
