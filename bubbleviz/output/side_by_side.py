"""Two estimator settings on the same frame: run time and error of each."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from bubbleviz.camera import Intrinsics
from bubbleviz.diagnostics import Numbers, numbers_of
from bubbleviz.inverse import EstimatorOptions
from bubbleviz.membrane import MembraneMesh
from bubbleviz.pipeline import FrameOptions, Pipeline, Product
from bubbleviz.recordings import Frame
from bubbleviz.result import Result
from bubbleviz.sensor import Sensor
from bubbleviz.simulation import Truth

# How well two masks of one image agree.


def iou(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of two masks; 1 where both are empty."""
    union = np.count_nonzero(a | b)
    return np.count_nonzero(a & b) / union if union else 1.0


PRODUCTS: frozenset[Product] = frozenset({"estimate", "patch", "pixel_mask"})


@dataclass(frozen=True)
class Measured:
    """One setting on one frame; NaN where there is no number, or no truth to compare with."""

    result: Result  # what it made of the frame
    numbers: Numbers  # of the result
    mesh: MembraneMesh  # reference surface it did that on
    solver: str
    iou: float = float("nan")  # of the patch's pixels with the true ones
    # length of the difference of the force vectors over the length of the true one
    force_error: float = float("nan")


class SideBySide:
    """Measures settings; keeps what they need built."""

    def __init__(
        self,
        sensor: Sensor,
        intrinsics: Intrinsics | None = None,  # of the recording
    ) -> None:
        self._sensor, self._intrinsics = sensor, intrinsics
        self.pipelines: dict[EstimatorOptions, Pipeline] = {}  # kept ready, by setting

    def keep(self, settings: Collection[EstimatorOptions]) -> None:
        """Drop pipelines built for other settings, whose solvers take a lot of memory."""
        self.pipelines = {o: pipeline for o, pipeline in self.pipelines.items() if o in settings}

    def measure(
        self,
        options: EstimatorOptions,
        frame: Frame,  # its gas pressure already zeroed
        rule: FrameOptions | None = None,  # what makes the patch
        truth: Truth | None = None,
        *,
        # the frame has one answer; else it is warm-started from the frame before, as in playback
        settled: bool = False,
    ) -> Measured:
        """Process a frame with a setting.

        Raises InputError: the setting is impossible.
        """
        pipeline = self._pipeline(options)
        if settled or not pipeline.counts:
            pipeline.settle(frame)
        result = pipeline.process(frame, PRODUCTS, rule)
        estimate, patch = result.solution
        errors: dict[str, float] = {}
        if truth is not None and estimate.trusted and patch.pixel_mask is not None:
            errors["iou"] = iou(patch.pixel_mask, truth.patch_mask)
            errors["force_error"] = truth.force_error(patch.force_n)
        numbers = numbers_of(result, pipeline.model.gas)
        return Measured(result, numbers, pipeline.mesh, pipeline.estimator.solver_name, **errors)

    def _pipeline(self, options: EstimatorOptions) -> Pipeline:
        pipeline = self.pipelines.get(options)
        if pipeline is None:
            pipeline = Pipeline.of(self._sensor, self._intrinsics, options)
            pipeline.prepare(PRODUCTS)
            self.pipelines[options] = pipeline
        return pipeline
