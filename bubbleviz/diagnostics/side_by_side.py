"""Two estimator settings on the same frame: run time and error of each."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from bubbleviz.camera.intrinsics import Intrinsics
from bubbleviz.diagnostics.frame_numbers import numbers_of
from bubbleviz.frames.frame import Frame
from bubbleviz.inverse.estimator import EstimatorOptions
from bubbleviz.pipeline import FrameOptions, Pipeline, Product
from bubbleviz.sensor import Sensor
from bubbleviz.simulation.synthetic_source import Truth
from bubbleviz.study.error_metrics import iou

PRODUCTS: frozenset[Product] = frozenset({"estimate", "patch", "pixel_mask"})
SETTLING = 3
"""Times a new pipeline sees its first frame before it is measured: the solver is built then, and
rays are cast again at the shape it ends at."""


@dataclass(frozen=True)
class Measured:
    """One setting on one frame; NaN where there is no number, or no truth to compare with.

    Attributes
    ----------
    solver, status : str
    nodes : int
        Of the mesh.
    total_ms, solve_ms : float
        Depth image in → patch and its pixels out; the solver alone.
    force_n, area_m2, residual_m : float
        As in `Patch` and `Estimate`.
    force_half_width_n : float
        Half of the 95 % interval of the force.
    iou : float
        Of the patch's pixels with the true ones.
    force_error : float
        Length of the difference of the force vectors over the length of the true one.
    """

    solver: str
    status: str
    nodes: int
    total_ms: float
    solve_ms: float
    force_n: float
    area_m2: float
    residual_m: float
    force_half_width_n: float = float("nan")
    iou: float = float("nan")
    force_error: float = float("nan")


class SideBySide:
    """Measures settings; keeps what they need built.

    Parameters
    ----------
    sensor : Sensor
    intrinsics : Intrinsics or None
        Of the recording.

    Attributes
    ----------
    pipelines : dict
        Kept ready, by setting.
    """

    def __init__(self, sensor: Sensor, intrinsics: Intrinsics | None = None) -> None:
        self._sensor, self._intrinsics = sensor, intrinsics
        self.pipelines: dict[EstimatorOptions, Pipeline] = {}

    def keep(self, settings: Collection[EstimatorOptions]) -> None:
        """Drop pipelines built for other settings, whose solvers take a lot of memory."""
        self.pipelines = {o: pipeline for o, pipeline in self.pipelines.items() if o in settings}

    def measure(
        self,
        options: EstimatorOptions,
        frame: Frame,
        kappa: float | None = None,
        truth: Truth | None = None,
    ) -> Measured:
        """Process a frame with a setting, warm-started from the frame before as in playback.

        Raises
        ------
        InputError
            The setting is impossible.
        """
        pipeline = self._pipeline(options, frame)
        result = pipeline.process(frame, PRODUCTS, FrameOptions(kappa))
        estimate, patch = result.estimate, result.patch
        if estimate is None or patch is None or patch.pixel_mask is None:
            raise AssertionError("asked for all of them")
        errors: dict[str, float] = {}
        if truth is not None and estimate.trusted:
            force = float(np.linalg.norm(truth.force_n))
            difference = float(np.linalg.norm(patch.force_n - truth.force_n))
            errors = {
                "iou": iou(patch.pixel_mask, truth.patch_mask),
                "force_error": difference / force if force > 0.0 else float("nan"),
            }
        numbers = numbers_of(result, pipeline.model.gas)
        return Measured(
            solver=pipeline.estimator.solver_name,
            status=estimate.status,
            nodes=len(pipeline.mesh.nodes),
            total_ms=result.times_ms["total"],
            solve_ms=estimate.solve_ms,
            force_n=numbers.force_n,
            area_m2=numbers.area_m2,
            residual_m=numbers.residual_m,
            force_half_width_n=numbers.force_half_width_n,
            **errors,
        )

    def _pipeline(self, options: EstimatorOptions, frame: Frame) -> Pipeline:
        pipeline = self.pipelines.get(options)
        if pipeline is None:
            pipeline = Pipeline.of(self._sensor, self._intrinsics, options)
            for _ in range(SETTLING):
                pipeline.process(frame, PRODUCTS)
            self.pipelines[options] = pipeline
        return pipeline
