"""Which products a consumer asks for decides which stages run."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from bubbleviz.camera.depth_camera import DepthCamera
from bubbleviz.camera.intrinsics import Intrinsics
from bubbleviz.camera.membrane_view import MembraneView
from bubbleviz.camera.observer import RangeObserver
from bubbleviz.camera.pixel_model import PixelModel
from bubbleviz.errors import InputError
from bubbleviz.frames.frame import Frame
from bubbleviz.inverse.estimator import Estimator, EstimatorOptions
from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.reference_mesh import build_mesh, reference_tension
from bubbleviz.patch.components import without_small
from bubbleviz.patch.patch_finder import PatchFinder
from bubbleviz.result import Estimate, Patch, Result
from bubbleviz.rigid_object import RigidObject
from bubbleviz.sensor import Sensor

if TYPE_CHECKING:
    from bubbleviz.pose.tracker import PoseTracker

Product = Literal["estimate", "patch", "pixel_mask", "cloud", "residual", "pose"]

MAX_BLOCK = 32
"""Largest side of a block in pixels: beyond it averaging saves no more time."""

_NEEDS: dict[str, tuple[Product, ...]] = {
    "estimate": ("estimate", "patch", "pixel_mask", "residual", "pose"),
    "patch": ("patch", "pixel_mask", "pose"),
    "pixel_mask": ("pixel_mask",),
    "cloud": ("cloud", "residual"),
    "residual": ("residual",),
    "pose": ("pose",),
}
"""Products that need each stage."""


def stages(products: frozenset[Product]) -> frozenset[str]:
    """Names of the stages that run for these products."""
    return frozenset(name for name, needing in _NEEDS.items() if not products.isdisjoint(needing))


class Pipeline:
    """Frame in, the products asked for out.

    Parameters
    ----------
    sensor : Sensor
    intrinsics : Intrinsics, optional
        Of the recording; they win over the sensor file's.
    kappa : float, optional
        Patch threshold as a multiple of the mean contact pressure (V-C); None for the physical
        one of `PatchFinder`.

    Attributes
    ----------
    mesh : MembraneMesh
        Reference surface.
    tension_n_per_m : float
        γ0, from the sensor file or Young–Laplace.
    least_area_m2 : float
        Parts of the patch smaller than this are left out.
    cloud_points : int or None
        Most points of the cloud, spread evenly over the image; None for all.
    counts : Counter
        How often each stage ran, by stage name.
    tracker : PoseTracker or None
        Of the object to look for, see `follow`.

    Raises
    ------
    InputError
        The recording's intrinsics are for another image size than the sensor file's camera.
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
        self.options = options or EstimatorOptions()
        self.least_area_m2 = 0.0
        self.cloud_points: int | None = None
        _check_size(sensor, intrinsics)
        self.camera = DepthCamera.of(sensor.camera, intrinsics)
        self.mesh = build_mesh(sensor, self.options.nodes)
        self.tension_n_per_m = reference_tension(sensor, self.mesh)
        self.counts: Counter[str] = Counter()
        self.tracker: PoseTracker | None = None

    @cached_property
    def estimator(self) -> Estimator:
        """The inverse solver; built when the first frame needs it."""
        observer = RangeObserver(
            self.camera,
            self.mesh,
            self.sensor.camera.noise_relative,
            self.pixels,
            self.options.block or self._block_size(),
        )
        gas = Gas.of(self.sensor.pneumatics, self.mesh)
        return Estimator(observer, gas, self.tension_n_per_m, self.options)

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
            if self._wanted("pose", products) and self.tracker is not None:
                result = self._with_pose(result, self.tracker, times)
            if self._wanted("cloud", products):
                with self._timed("cloud", times):
                    pixels = self._cloud_pixels(frame)
                    cloud = self.camera.points(frame.depth_m, pixels)
                result = replace(result, cloud_m=cloud, cloud_pixels=pixels)
            if self._wanted("residual", products) and result.estimate is not None:
                with self._timed("residual", times):
                    residual = self._residual(frame, result.estimate, result.cloud_pixels)
                result = replace(result, cloud_residual_m=residual)
        return replace(result, times_ms=times)

    def prepare(self, products: frozenset[Product]) -> None:
        """Build now what the first frame would otherwise wait for."""
        if self._wanted("estimate", products):
            _ = self.estimator
        if self._wanted("patch", products):
            _ = self._finder, self._view

    def follow(self, obj: RigidObject | None, start: np.ndarray | None = None) -> None:
        """Look for an object in frames to come, or for none.

        Parameters
        ----------
        obj : RigidObject or None
        start : (4, 4) array, optional
            T_B_O in the first of them; searched for when None.

        Raises
        ------
        InputError
            The object has no area, or is in other units than the bubble.
        """
        if obj is None:
            self.tracker = None
            return
        from bubbleviz.pose.tracker import PoseTracker

        self.tracker = PoseTracker(self.estimator, obj, start)

    def patch(self, estimate: Estimate, *, pixel_mask: bool = False) -> Patch:
        """Patch of an estimate at the present κ, without solving again."""
        patch = self.whole_patch(estimate)
        if self.least_area_m2 > 0.0:
            patch = without_small(self.mesh, estimate, patch, self.least_area_m2)
        return self._with_pixels(estimate, patch) if pixel_mask else patch

    def whole_patch(self, estimate: Estimate) -> Patch:
        """Patch of an estimate with all its parts, however small."""
        return self._finder.find(estimate, self.kappa)

    @cached_property
    def _finder(self) -> PatchFinder:
        return PatchFinder(self.mesh, self.estimator.held_pressure_pa, self.estimator.resolution_m)

    def _with_pose(self, result: Result, tracker: PoseTracker, times: dict[str, float]) -> Result:
        if result.estimate is None or result.patch is None:
            return result
        with self._timed("pose", times):
            pose = tracker.update(result.frame, result.estimate, result.patch)
        return replace(result, pose=pose)

    def _with_pixels(self, estimate: Estimate, patch: Patch) -> Patch:
        mask = self._view.above(estimate.displacement_m, patch.level, 0.0)
        return replace(patch, pixel_mask=mask)

    def _cloud_pixels(self, frame: Frame) -> np.ndarray:
        """Flat indices of the pixels of the cloud."""
        pixels = np.flatnonzero(np.isfinite(frame.depth_m))
        if self.cloud_points is None:
            return pixels
        return pixels[:: max(1, -(-len(pixels) // self.cloud_points))]

    def _residual(self, frame: Frame, estimate: Estimate, pixels: np.ndarray | None) -> np.ndarray:
        """Measured minus modelled range of some pixels, m; the bias is part of the model."""
        if pixels is None:
            pixels = self._cloud_pixels(frame)
        model = np.full(len(pixels), np.nan)
        hits = self._view.hits(estimate.displacement_m, pixels)
        model[np.searchsorted(pixels, hits.ray)] = hits.range_m
        measured = self.camera.range_image(frame.depth_m)
        if self.pixels is not None:
            model += np.where(self.pixels.mask, self.pixels.bias_m, np.nan).ravel()[pixels]
            measured = self.pixels.straightened(measured)
        return measured.ravel()[pixels] - model

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
        size = int(0.5 * self.mesh.edge_length * focal / depth)
        return min(max(1, size), MAX_BLOCK)

    def _check_size(self, frame: Frame) -> None:
        height, width = frame.depth_m.shape
        own = self.camera.intrinsics
        if (height, width) != (own.height, own.width):
            raise InputError(
                f"frame {frame.index}: image is {width}×{height} pixels but the sensor's camera "
                f"has {own.width}×{own.height}; choose the sensor file of this camera"
            )


def _check_size(sensor: Sensor, intrinsics: Intrinsics | None) -> None:
    own = sensor.camera
    if intrinsics is not None and (intrinsics.width, intrinsics.height) != (own.width, own.height):
        raise InputError(
            f"sensor {sensor.name}: its camera has {own.width}×{own.height} pixels, the "
            f"recording's {intrinsics.width}×{intrinsics.height}; choose the sensor of this camera"
        )
