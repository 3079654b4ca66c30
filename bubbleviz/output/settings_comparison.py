"""Comparison of estimator settings on one frame: result, run time and error of each."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from bubbleviz.camera import Intrinsics
from bubbleviz.diagnostics import Numbers, numbers_of
from bubbleviz.inverse import EstimatorOptions
from bubbleviz.membrane import MembraneMesh
from bubbleviz.pipeline import FrameOptions, Pipeline, Product
from bubbleviz.recordings import Frame
from bubbleviz.result import Result
from bubbleviz.sensor import Sensor
from bubbleviz.simulation import Truth, iou

PRODUCTS: frozenset[Product] = frozenset({"estimate", "patch", "pixel_mask"})


@dataclass(frozen=True)
class ComparedResult:
    """Result of one setting on one frame; errors are NaN without estimate or ground truth."""

    result: Result
    numbers: Numbers  # of the result
    mesh: MembraneMesh  # reference surface
    solver: str
    iou: float = float("nan")  # of the patch's pixels with the true ones
    force_error: float = float("nan")  # |difference of the forces| over |true force|


class SettingsComparison:
    """Processes frames with several settings, and caches the pipelines."""

    def __init__(
        self,
        sensor: Sensor,
        intrinsics: Intrinsics | None = None,  # of the recording
    ) -> None:
        self._sensor, self._intrinsics = sensor, intrinsics
        self.pipelines: dict[EstimatorOptions, Pipeline] = {}

    def keep(self, settings: Collection[EstimatorOptions]) -> None:
        """Drop the pipelines of all other settings, as solvers take a lot of memory."""
        self.pipelines = {o: pipeline for o, pipeline in self.pipelines.items() if o in settings}

    def measure(
        self,
        options: EstimatorOptions,
        frame: Frame,  # with corrected zero of the gas pressure
        rule: FrameOptions | None = None,  # of the patch
        truth: Truth | None = None,
        *,
        # independent of earlier frames; else warm-started from the previous frame, as in playback
        alone: bool = False,
    ) -> ComparedResult:
        """Process a frame with a setting.

        Raises InputError: invalid settings.
        """
        pipeline = self._pipeline(options)
        if alone:
            pipeline.restart()
        result = pipeline.process(frame, PRODUCTS, rule)
        estimate, patch = result.solution
        errors: dict[str, float] = {}
        if truth is not None and estimate.trusted and patch.pixel_mask is not None:
            errors["iou"] = iou(patch.pixel_mask, truth.patch_mask)
            errors["force_error"] = truth.force_error(patch.force_n)
        numbers = numbers_of(result, pipeline.model.gas)
        solver = pipeline.estimator.solver_name
        return ComparedResult(result, numbers, pipeline.mesh, solver, **errors)

    def _pipeline(self, options: EstimatorOptions) -> Pipeline:
        pipeline = self.pipelines.get(options)
        if pipeline is None:
            pipeline = Pipeline.of(self._sensor, self._intrinsics, options)
            pipeline.prepare(PRODUCTS)
            self.pipelines[options] = pipeline
        return pipeline
