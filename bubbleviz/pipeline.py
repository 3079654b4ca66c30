"""Which products a consumer asks for decides which stages run."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from typing import Literal

import numpy as np

from bubbleviz.camera.depth_camera import DepthCamera
from bubbleviz.camera.intrinsics import Intrinsics
from bubbleviz.camera.observer import RangeObserver
from bubbleviz.camera.pixels import PixelModel
from bubbleviz.camera.view import MembraneView
from bubbleviz.errors import InputError
from bubbleviz.frames.frame import Frame
from bubbleviz.inverse.estimator import Estimator, EstimatorOptions
from bubbleviz.inverse.patch import default_threshold, find_patch, mean_pressure
from bubbleviz.membrane.build import build_mesh
from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.stiffness import young_laplace_tension
from bubbleviz.result import Estimate, Patch, Result
from bubbleviz.sensor import Sensor

Product = Literal["estimate", "patch", "pixel_mask", "cloud", "residual"]

_NEEDS: dict[str, tuple[Product, ...]] = {
    "estimate": ("estimate", "patch", "pixel_mask", "residual"),
    "patch": ("patch", "pixel_mask"),
    "pixel_mask": ("pixel_mask",),
    "cloud": ("cloud", "residual"),
    "residual": ("residual",),
}
"""Products that need each stage."""


class Pipeline:
    """Frame in, the products asked for out.

    Parameters
    ----------
    sensor : Sensor
    intrinsics : Intrinsics, optional
        Of the recording; they win over the sensor file's.
    kappa : float, optional
        Patch threshold as a multiple of the mean contact pressure (V-C); None for half the gauge
        pressure, see `default_threshold`.

    Attributes
    ----------
    mesh : MembraneMesh
        Reference surface.
    tension_n_per_m : float
        γ0, from the sensor file or Young–Laplace.
    counts : Counter
        How often each stage ran, by stage name.
    """

    def __init__(
        self,
        sensor: Sensor,
        *,
        intrinsics: Intrinsics | None = None,
        kappa: float | None = None,
        options: EstimatorOptions | None = None,
    ) -> None:
        self.sensor = sensor
        self.kappa = kappa
        self.options = options
        self.camera = DepthCamera.of(sensor.camera, intrinsics)
        self.mesh = build_mesh(sensor)
        gauge = sensor.pneumatics.gauge_pressure_pa
        self.tension_n_per_m = sensor.pneumatics.tension_n_per_m or young_laplace_tension(
            self.mesh, gauge
        )
        self.counts: Counter[str] = Counter()

    @cached_property
    def estimator(self) -> Estimator:
        """The inverse solver; built when the first frame needs it."""
        observer = RangeObserver(
            self.camera,
            self.mesh,
            self.sensor.camera.noise_relative,
            self.pixels,
            self._block_size(),
        )
        gas = Gas.of(self.sensor.pneumatics, self.mesh)
        return Estimator(
            observer,
            gas,
            self.tension_n_per_m,
            self.sensor.pneumatics.gauge_pressure_pa,
            self.options,
        )

    @cached_property
    def pixels(self) -> PixelModel | None:
        """Calibration of each pixel, where the sensor file names one."""
        if self.sensor.calibration is None:
            return None
        path = self.sensor.resolve(self.sensor.calibration.pixels_file)
        return PixelModel.load(path, self._view.shape)

    @cached_property
    def _view(self) -> MembraneView:
        return MembraneView(self.camera, self.mesh)

    def process(self, frame: Frame, products: frozenset[Product]) -> Result:
        """Run the stages that `products` need on one frame.

        Raises
        ------
        InputError
            The image is not of the camera's size.
        """
        self._check_size(frame)
        times: dict[str, float] = {}
        result = Result(frame)
        with self._timed("total", times):
            if self._wanted("estimate", products):
                with self._timed("estimate", times):
                    estimate = self.estimator.estimate(frame.depth_m, frame.gas_pressure_pa)
                result = replace(result, estimate=estimate)
            if self._wanted("patch", products) and result.estimate is not None:
                with self._timed("patch", times):
                    patch = self.patch(result.estimate)
                if self._wanted("pixel_mask", products):
                    with self._timed("pixel_mask", times):
                        patch = self._with_pixels(result.estimate, patch)
                result = replace(result, patch=patch)
            if self._wanted("cloud", products):
                with self._timed("cloud", times):
                    pixels = np.flatnonzero(np.isfinite(frame.depth_m))
                    cloud = self.camera.points(frame.depth_m, pixels)
                result = replace(result, cloud_m=cloud, cloud_pixels=pixels)
            if self._wanted("residual", products) and result.estimate is not None:
                with self._timed("residual", times):
                    residual = self._residual_image(frame, result.estimate)
                result = replace(result, cloud_residual_m=residual.ravel()[result.cloud_pixels])
        return replace(result, times_ms=times)

    def patch(self, estimate: Estimate) -> Patch:
        """Patch of an estimate at the present κ, without solving again."""
        return find_patch(self.mesh, estimate, self.threshold_pa(estimate))

    def threshold_pa(self, estimate: Estimate) -> float:
        """Contact pressure above which a point belongs to the patch, Pa."""
        if self.kappa is None:
            return default_threshold(self.sensor.pneumatics.gauge_pressure_pa)
        return self.kappa * mean_pressure(self.mesh, estimate.contact_pressure_pa)

    def _with_pixels(self, estimate: Estimate, patch: Patch) -> Patch:
        mask = self._view.above(
            estimate.displacement_m, estimate.contact_pressure_pa, max(patch.threshold_pa, 0.0)
        )
        return replace(patch, pixel_mask=mask)

    def _residual_image(self, frame: Frame, estimate: Estimate) -> np.ndarray:
        """Measured minus modelled range (H, W), m; the calibrated bias is part of the model."""
        model = self._view.range_image(estimate.displacement_m)
        if self.pixels is not None:
            model = model + np.where(self.pixels.mask, self.pixels.bias_m, np.nan)
        return self.camera.range_image(frame.depth_m) - model

    @staticmethod
    def _wanted(stage: str, products: frozenset[Product]) -> bool:
        return not products.isdisjoint(_NEEDS[stage])

    @contextmanager
    def _timed(self, stage: str, times: dict[str, float]) -> Iterator[None]:
        start = time.perf_counter()
        yield
        times[stage] = 1e3 * (time.perf_counter() - start)
        self.counts[stage] += 1

    def _block_size(self) -> int:
        """Side in pixels of half a mesh edge, seen from the camera: averaging loses nothing."""
        T = self.camera.T_B_C
        depth = float(np.median((self.mesh.nodes - T[:3, 3]) @ T[:3, 2]))
        focal = min(self.camera.intrinsics.fx, self.camera.intrinsics.fy)
        return max(1, int(0.5 * self.mesh.edge_length * focal / depth))

    def _check_size(self, frame: Frame) -> None:
        height, width = frame.depth_m.shape
        own = self.camera.intrinsics
        if (height, width) != (own.height, own.width):
            raise InputError(
                f"frame {frame.index}: image is {width}×{height} pixels but the sensor's camera "
                f"has {own.width}×{own.height}; choose the sensor file of this camera"
            )
