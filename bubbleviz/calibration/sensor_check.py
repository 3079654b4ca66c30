"""Whether contact-free frames still fit the sensor file, and what a misfit is worth in force.

The mean of the frames is compared with the range that the sensor file expects, over the blocks of
pixels and with the noise that the estimator uses. What changed is looked for among three causes,
each with a known pattern over the image: an offset of depth, its scale, and the gas pressure.
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
from bubbleviz.wording import decimals_of, rounded

Answer = Literal["fits", "drifted", "another"]

OFFSET, SCALE, GAS = "depth offset", "depth scale", "gas pressure from the shape"
_UNITS = {OFFSET: ("mm", 1e3), SCALE: ("%", 1e2), GAS: ("Pa", 1.0)}
_REMEDY = {
    True: "inflate it as in the sensor file, or identify the sensor again",
    False: "let the camera warm up, then identify the sensor again at rest",
}

_STEP = 0.01  # of gauge pressure, to find its pattern
_SECANTS, _MOST = 4, 0.5  # rounds of that, and the largest share of the gauge pressure looked for
_ROBUST = 3  # rounds in which pixels far from the others of their block lose their weight
_PRESSED = 0.15  # of the dome's height: depth of the press that tells drift in newtons; chosen


@dataclass(frozen=True)
class Checked:
    """One quantity of a check."""

    quantity: str
    unit: str  # of the text; `factor` times SI
    factor: float
    value: float  # SI
    half_width: float | None = None  # half of its 95 % interval
    limit: float | None = None  # absolute value from which it alone would no longer fit
    todo: str = ""  # what to do about it; empty where it is within its limit

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
    """Verdict on a sensor file by contact-free frames."""

    verdict: Answer
    reason: str  # one line, with what to do
    rows: tuple[Checked, ...]
    frames: tuple[int, int]  # first and last
    bias_m: float  # mean of measured minus expected z-depth, m
    # χ² of the mean image for each block of pixels, and what it is at most where nothing changed
    chi2_per_block: float
    chi2_limit: float
    # force of a simulated press, and by how much it is read wrongly by what has changed, N; None
    # where that is not known
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

    Raises InputError: too few frames, or something touches the membrane.
    """
    if len(frames) < MIN_FRAMES:
        raise InputError(f"{len(frames)} contact-free frames; give at least {MIN_FRAMES}")
    depths = [frame.depth_m for frame in frames]
    rest = _Rest(model, depths)
    camera = _camera_row(model, rest)
    fits = rest.changed <= rest.limit and not camera.todo
    shape = () if quick and fits else (*rest.rows(), camera, *_gas_rows(model, frames, rest))
    found = SensorCheck(
        verdict="fits",
        reason=f"fits: depth within {1e3 * rest.change_limit_m:.2f} mm of the sensor file",
        rows=shape,
        frames=(frames[0].index, frames[-1].index),
        bias_m=rest.bias_m,
        chi2_per_block=rest.changed,
        chi2_limit=rest.limit,
    )
    if fits:
        return found
    if camera.todo:
        return replace(found, verdict="another", reason=_another_camera(model, camera))
    turned = [depth[::-1, ::-1] for depth in depths]
    if rest.left > rest.limit and (again := _Rest(model, turned)).left <= again.limit:
        reason = (
            "another camera: its images are turned by 180°; turn it back, or identify the sensor "
            "again"
        )
        return replace(found, verdict="another", reason=reason)
    pipeline = Pipeline(model)
    if _touched(pipeline, frames[0], rest):
        raise InputError(
            "no contact-free frames: something touches the membrane in all of these frames; record"
            " it untouched"
        )
    if rest.left > rest.limit:
        reason = "another membrane or camera: identify the sensor again"
        return replace(found, verdict="another", reason=reason)
    causes = [row for row in rest.rows()[:-1] if row.todo]
    most = max(causes, key=lambda row: abs(row.value) / (row.limit or 1.0), default=None)
    what = ", ".join(f"{row.quantity} {row.texts()[1]}" for row in causes)
    press, error = _force_error(pipeline, rest) if not quick else (None, None)
    worth = "" if error is None else f", {error:.2g} N of a press of {press:.2g} N"
    reason = (
        f"drifted by {1e3 * rest.bias_m:+.2f} mm{worth} ({what or 'pattern of the pixels'}):"
        f" {most.todo if most else _REMEDY[False]}"
    )
    return replace(found, verdict="drifted", reason=reason, press_n=press, force_error_n=error)


class _Rest:
    """The mean of contact-free images against what a sensor file expects, by blocks of pixels."""

    def __init__(self, model: SensorModel, depths_m: Sequence[np.ndarray]) -> None:
        self.model, self.observer = model, model.observer()
        measured = [self.observer.measure(depth) for depth in depths_m]
        every = np.array([self.observer.weigh(each).residual_m for each in measured])
        for _ in range(_ROBUST):
            usual = np.median(every, axis=0)
            every = np.array([self.observer.weigh(each, usual).residual_m for each in measured])
        totals = np.array([each.total for each in measured])
        by_offset, *_, by_scale = self.observer.image_errors.T
        self._seen = np.asarray((totals > 0.0).all(axis=0) & (by_offset > 0.0))
        # change of the blocks (B,) by an offset and by the scale of depth
        self._by_offset, self._by_scale = by_offset[self._seen], by_scale[self._seen]
        if 2 * self._seen.sum() < len(self._seen):
            raise InputError("more than half of the membrane is not seen; uncover the camera")
        # (F, B), residuals of the blocks, m
        self.frames_m = every[:, self._seen]
        self.mean_m = self.frames_m.mean(axis=0)
        # (B,), variance of a block in one frame, as the estimator has it, and of the mean, m²
        self.one_m2 = 1.0 / self.observer.observe_everything().weight[self._seen]
        self.mean_m2 = self._variance_of_mean(1.0 / np.median(totals[:, self._seen], axis=0))
        # χ² of a block that noise does not reach
        self.limit = float(chdtri(len(self.mean_m), ndtr(-SIGNIFICANT)) / len(self.mean_m))

    def _variance_of_mean(self, noise_m2: np.ndarray) -> np.ndarray:
        """That of the frames' mean and that of the file's own, whose frames are not known.

        Pixels that were calibrated have biases from the mean of at least as many frames as
        identification accepts. Others have none, and what the mesh's facets get wrong stays.
        """
        moved = self.frames_m - self.mean_m
        spread = moved.std(axis=0)
        inflation = mean_inflation(temporal_correlation(moved[:, None], spread[None]))
        if self.model.pixels is None:
            return noise_m2 * inflation / len(moved) + np.maximum(self.one_m2 - noise_m2, 0.0)
        return noise_m2 * (inflation / len(moved) + 1.0 / MIN_FRAMES)

    def _at_limit(self, pattern: float | np.ndarray, variance_m2: np.ndarray) -> float:
        """Size of a pattern of the blocks (B,) from which χ² is too large."""
        return float(np.sqrt(self.limit / np.mean(pattern**2 / variance_m2)))

    @property
    def change_limit_m(self) -> float:
        """Rms change of the range from which something changed, m."""
        return self._at_limit(1.0, self.mean_m2)

    @property
    def bias_m(self) -> float:
        """Mean of measured minus expected z-depth, m."""
        return float(np.average(self.mean_m / self._by_offset, weights=1.0 / self.one_m2))

    @property
    def changed(self) -> float:
        """χ² of the mean for each block."""
        return float(np.mean(self.mean_m**2 / self.mean_m2))

    @property
    def left(self) -> float:
        """χ² for each block of what the causes leave, by the noise of one frame."""
        return float(np.mean(self._without(self.causes) ** 2 / self.one_m2))

    @cached_property
    def patterns(self) -> dict[str, np.ndarray]:
        """Change of the blocks (B,) by a unit of each cause: m, 1, Pa."""
        found = {OFFSET: self._by_offset, SCALE: self._by_scale}
        at_rest = self._observed(self.expected_depth_m())
        gauge = self.model.sensor.pneumatics.gauge_pressure_pa
        inflation, step = Inflation(self.model.rubber), _STEP * gauge
        for _ in range(_SECANTS):  # the membrane is no linear spring
            try:
                moved = inflation.at(gauge + step) - self.model.mesh.nodes
            except SolveError:  # inflated to its limit
                break
            pattern = (self._observed(self.expected_depth_m(moved)) - at_rest) / step
            found[GAS] = pattern
            weighted = pattern / self.mean_m2
            size = float(
                np.clip(
                    weighted @ self.mean_m / (weighted @ pattern), -_MOST * gauge, _MOST * gauge
                )
            )
            if abs(size) < _STEP * gauge:
                break
            step = size
        return found

    def expected_depth_m(self, moved_m: np.ndarray | None = None) -> np.ndarray:
        """z-depth image (H, W) of the membrane at rest, or moved (n, 3), as the pixels see it."""
        view, pixels = self.model.view, self.model.pixels
        ranges = view.rest_range if moved_m is None else view.range_image(moved_m)
        if pixels is not None:
            ranges = ranges + np.where(pixels.mask, pixels.bias_m, 0.0)
        return self.model.camera.depth_image(ranges)

    def drift_m(self) -> np.ndarray:
        """Change of the z-depth image (H, W), by blocks, m; 0 where nothing is known."""
        side, columns = self.observer.block, self.observer.columns
        row, column = np.indices(self.model.view.shape) // side
        block = row * columns + column
        change = np.zeros(block.max() + 1)
        change[self.observer.block_number[self._seen]] = self.mean_m
        return np.asarray(change[block] / self.model.camera.range_per_depth)

    def _observed(self, depth_m: np.ndarray) -> np.ndarray:
        return self.observer.observe(depth_m.astype(np.float32)).residual_m[self._seen]

    @cached_property
    def causes(self) -> tuple[str, ...]:
        """Those that explain the change: the set of least BIC; none where nothing changed."""
        if self.changed <= self.limit:
            return ()
        sets = [c for k in range(len(self.patterns) + 1) for c in combinations(self.patterns, k)]
        penalty = np.log(len(self.mean_m))
        return min(
            sets, key=lambda c: np.sum(self._without(c) ** 2 / self.mean_m2) + penalty * len(c)
        )

    def _influence(self, causes: tuple[str, ...]) -> np.ndarray:
        """Change of each cause's size by each block (k, B), of weighted least squares."""
        X = np.stack([self.patterns[name] for name in causes], axis=1)
        weighted = X.T / self.mean_m2
        return np.asarray(np.linalg.solve(weighted @ X, weighted))

    def _without(self, causes: tuple[str, ...]) -> np.ndarray:
        """The mean (B,) less the causes, m."""
        if not causes:
            return self.mean_m
        sizes = self._influence(causes) @ self.mean_m
        return np.asarray(self.mean_m - sizes @ [self.patterns[name] for name in causes])

    def size(self, cause: str) -> tuple[float, float]:
        """Size of a cause beside those that explain the change; half of its 95 % interval.

        By what it varies by from frame to frame, and by what is left in squares of blocks.
        """
        causes = tuple(dict.fromkeys((*self.causes, cause)))
        influence = self._influence(causes)[causes.index(cause)]
        squares = BlockSquares(self.observer.block_number[self._seen], self.observer.columns)
        scores = np.bincount(squares.of_block, influence * self._without(causes))
        sigma = np.hypot(error_of_mean(self.frames_m @ influence), np.linalg.norm(scores))
        return float(influence @ self.mean_m), HALF_95 * float(sigma)

    def rows(self) -> list[Checked]:
        """The causes, and what they leave."""
        rows = []
        for name in self.patterns:
            limit = self._at_limit(self.patterns[name], self.mean_m2)
            size, half = self.size(name)
            explains = name in self.causes and abs(size) > limit and self.left <= self.limit
            todo = _REMEDY[name == GAS] if explains else ""
            rows.append(Checked(name, *_UNITS[name], size, half, limit, todo))
        todo = "identify anew" if self.left > self.limit else ""
        limit_m = self._at_limit(1.0, self.one_m2)
        rows.append(Checked("rest shape, rms", "mm", 1e3, self.shape_m, None, limit_m, todo))
        return rows

    @property
    def shape_m(self) -> float:
        """What the causes leave, rms over the blocks, m."""
        left = self._without(self.causes)
        return float(np.sqrt(np.average(left**2, weights=1.0 / self.one_m2)))


def _camera_row(model: SensorModel, rest: _Rest) -> Checked:
    """Change of the expected ranges by the intrinsics of the recording, rms."""
    moved = model.camera_change_m
    todo = "choose the sensor file of this camera" if moved > rest.change_limit_m else ""
    return Checked("camera info, rms", "mm", 1e3, moved, None, rest.change_limit_m, todo)


def _gas_rows(model: SensorModel, frames: Sequence[Frame], rest: _Rest) -> list[Checked]:
    """The measured gas pressure over the sensor file's; its zero may be off by the weather."""
    gas = np.array([np.nan if f.gas_pressure_pa is None else f.gas_pressure_pa for f in frames])
    if not np.isfinite(gas).all():
        return []
    off, known = float(gas.mean()) - model.gas.P0, model.gas.P0
    inflated = rest.size(GAS)[0] if GAS in rest.causes else 0.0
    half = HALF_95 * error_of_mean(gas)
    todo = gas_warning(float(gas.mean()) - inflated, known)
    return [Checked("gas pressure measured", "Pa", 1.0, off, half, WEATHER_PA, todo)]


def _another_camera(model: SensorModel, row: Checked) -> str:
    own, there = DepthCamera.of(model.sensor.camera).intrinsics, model.camera.intrinsics
    return (
        f"another camera: fx {there.fx:.1f}, fy {there.fy:.1f} in the recording's camera info,"
        f" {own.fx:.1f} and {own.fy:.1f} pixels in the sensor file: {row.todo}, or identify the "
        "sensor again"
    )


def _touched(pipeline: Pipeline, frame: Frame, rest: _Rest) -> bool:
    """Whether a contact explains the images, and better than the causes of a drift do."""
    mean = (rest.expected_depth_m() + rest.drift_m()).astype(np.float32)
    found = pipeline.estimate_aside(replace(frame, depth_m=mean, gas_pressure_pa=None))
    return found.status == "ok" and found.residual_rms_m < rest.shape_m


def _force_error(pipeline: Pipeline, rest: _Rest) -> tuple[float | None, float | None]:
    """Force of a simulated press of a ball on top, and the change of its estimate by the drift, N.

    Both None where either cannot be found.
    """
    model = pipeline.model
    mesh, ball = model.mesh, load_object("sphere")
    top, pose = int(np.argmax(mesh.nodes[:, 2])), np.eye(4)
    pose[:2, 3] = mesh.nodes[top, :2]
    pose[2, 3] = touching_height(ball, pose, mesh) - _PRESSED * mesh.nodes[top, 2]
    try:
        press = SyntheticSource(model.sensor, ball, pose[None])[0]
    except (InputError, SolveError):
        return None, None
    pixels = model.pixels
    bias = 0.0 if pixels is None else np.where(pixels.mask, pixels.bias_m, 0.0)
    seen = model.camera.depth_image(press.depth_m * model.camera.range_per_depth + bias)
    forces = []
    for depth in (seen, seen + rest.drift_m()):
        frame = replace(press, depth_m=depth.astype(np.float32))
        pipeline.restart()
        result = pipeline.process(frame, frozenset({"patch"}))
        if result.estimate is None or result.patch is None or not result.estimate.trusted:
            return None, None
        forces.append(result.patch.force_n)
    return float(np.linalg.norm(forces[0])), float(np.linalg.norm(forces[1] - forces[0]))
