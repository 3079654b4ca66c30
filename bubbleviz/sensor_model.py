"""Sensor in memory: mesh, camera and pixel model, built from the sensor file."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from types import NoneType
from typing import Any

import numpy as np

from bubbleviz.camera import (
    OF_RANGES,
    DepthCamera,
    Intrinsics,
    MembraneView,
    PixelModel,
    RangeObserver,
    range_errors,
)
from bubbleviz.errors import InputError, check_type
from bubbleviz.membrane import (
    Gas,
    MembraneMesh,
    RubberMembrane,
    balance_tension,
    build_mesh,
    build_rubber,
    reference_tension,
)
from bubbleviz.result import Estimate
from bubbleviz.sensor import Sensor, contradiction, size_refusal
from bubbleviz.wording import size_text

_NODE_PIXELS = 10_000  # for the residuals of the nodes: some ten for each
_TENSION_OFF = 0.1
"""Largest difference of γ0 in a sensor file from Young–Laplace, relative: forces of the linear
membrane are proportional to γ0, and this is five standard deviations of errors of the model."""
_MAX_BLOCK = 32  # largest side of a block in pixels: larger blocks save no more time


@dataclass(frozen=True, repr=False)
class SensorModel:
    """One sensor for estimation, simulation and calibration."""

    sensor: Sensor
    camera: DepthCamera  # in the bubble frame B
    mesh: MembraneMesh  # reference surface
    pixels: PixelModel | None = None  # calibration of each pixel; None: not calibrated

    @classmethod
    def of(
        cls,
        sensor: Sensor,
        intrinsics: Intrinsics | None = None,  # of the recording; override the sensor file's
        nodes: int | None = None,  # mesh size of an analytic dome; None: the sensor file's
    ) -> SensorModel:
        """Build the model of a sensor file.

        Raises InputError: the intrinsics are for another image size than the sensor's camera, or
        mesh or pixels cannot be read.
        """
        own, pixels = sensor.camera, None
        shape = own.height, own.width
        check_type("intrinsics", intrinsics, Intrinsics, NoneType)
        if intrinsics is not None and intrinsics.size != own.size:
            raise size_refusal("intrinsics are for", intrinsics.size, sensor.name, own.size)
        if sensor.calibration is not None:
            pixels = PixelModel.load(sensor.resolve(sensor.calibration.pixels_file), shape)
        return cls(sensor, DepthCamera.of(own, intrinsics), build_mesh(sensor, nodes), pixels)

    def __getstate__(self) -> dict[str, Any]:
        """State for pickle, without cached properties, which are three times as large."""
        camera = DepthCamera(self.camera.intrinsics, self.camera.T_B_C)
        own = {"sensor": self.sensor, "mesh": self.mesh, "pixels": self.pixels}
        return {**own, "camera": camera}

    def __repr__(self) -> str:
        lens = self.camera.intrinsics
        nodes = len(self.mesh.nodes)
        return f"<{self.sensor.name}: {nodes} nodes, {size_text(lens.size)} pixels>"

    @cached_property
    def tension_n_per_m(self) -> float:
        """γ0 in N/m: the sensor file's, or by Young–Laplace."""
        return reference_tension(self.sensor, self.mesh)

    @cached_property
    def contradiction(self) -> str:
        """Sentence on a value that contradicts others in the sensor file; else empty."""
        return contradiction(self.sensor) or self._tension_contradiction()

    def _tension_contradiction(self) -> str:
        given = self.sensor.pneumatics.tension_n_per_m
        gauge = self.sensor.pneumatics.gauge_pressure_pa
        if given is None:
            return ""
        try:
            balanced = balance_tension(self.mesh, gauge)
        except InputError:  # a flat surface
            return ""
        if abs(given / balanced - 1.0) <= _TENSION_OFF:
            return ""
        return (
            f"tension_n_per_m = {given:g} in the sensor file, but {balanced:.4g} N/m balance its "
            f"gauge pressure of {gauge:g} Pa on its surface, so forces may be wrong by that ratio; "
            "correct either, or leave out tension_n_per_m"
        )

    @cached_property
    def gas(self) -> Gas:
        return Gas.of(self.sensor.pneumatics, self.mesh)

    @cached_property
    def rubber(self) -> RubberMembrane:
        return build_rubber(self.sensor, self.mesh, self.tension_n_per_m)

    @cached_property
    def view(self) -> MembraneView:
        return MembraneView(self.camera, self.mesh)

    @cached_property
    def camera_change_m(self) -> float:
        """Rms change of the expected ranges by intrinsics other than the sensor file's, m."""
        own = DepthCamera.of(self.sensor.camera)
        if own.intrinsics == self.camera.intrinsics:
            return 0.0
        change = self.view.rest_range - MembraneView(own, self.mesh).rest_range
        used = np.isfinite(change) & (True if self.pixels is None else self.pixels.mask)
        return float(np.sqrt(np.mean(change[used] ** 2)))

    def observer(
        self,
        block: int | None = None,  # side in pixels; None: half a mesh edge as seen by the camera
    ) -> RangeObserver:
        """Observer that averages range images over blocks of pixels."""
        noise = self.sensor.camera.noise_relative
        block, at_rest, own = block or self._block(), self.view.at_rest, self.sensor
        try:
            return RangeObserver(self.camera, self.mesh, noise, self.pixels, block, at_rest)
        except InputError as error:
            where = own.resolve(own.file) if own.file else f"sensor {own.name}"
            raise InputError(f"{where}: {error}") from error

    def _block(self) -> int:
        own = self.camera.intrinsics
        depth = float(np.median(self.camera.local(self.mesh.nodes)[:, 2]))
        size = int(0.5 * self.mesh.edge_length * min(own.fx, own.fy) / depth)
        return min(max(1, size), _MAX_BLOCK)

    def biased_depth(self, range_m: np.ndarray) -> np.ndarray:
        """z-depth image (H, W) for true ranges, m, with the bias of the pixels in use."""
        pixels = self.pixels
        bias_m = 0.0 if pixels is None else np.where(pixels.mask, pixels.bias_m, 0.0)
        return self.camera.depth_image(range_m + bias_m)

    def range_image(self, depth_m: np.ndarray) -> np.ndarray:
        """Calibrated range (H, W) of a z-depth image, m; NaN in unused pixels."""
        ranges = self.camera.range_image(depth_m)
        return ranges if self.pixels is None else self.pixels.corrected(ranges)

    def residuals(self, depth_m: np.ndarray, estimate: Estimate, pixels: np.ndarray) -> np.ndarray:
        """Measured minus modelled ranges of some pixels, (k,), m; NaN where not known.

        Modelled are the membrane and, as in the fit, the estimated errors of the whole image.

        Parameters
        ----------
        depth_m : (H, W) array
            z-depth image, m.
        estimate : Estimate
        pixels : (k,) int array
            Flat indices.
        """
        modelled = self.view.ranges(self.view.motion_seen(estimate), pixels)
        error_m = self._image_error_m(estimate, pixels, modelled)
        return self.ranges(depth_m, pixels) - modelled - error_m

    def _image_error_m(
        self, estimate: Estimate, pixels: np.ndarray, range_m: np.ndarray
    ) -> np.ndarray | float:
        """Estimated range errors (k,) of the whole image in some pixels (k,), without shifts."""
        if estimate.image_errors is None:
            return 0.0
        by_unit = range_errors(self.camera.T_B_C, self.camera.directions[pixels], range_m)
        return by_unit @ estimate.image_errors.mean[OF_RANGES]

    def node_residuals(self, depth_m: np.ndarray, estimate: Estimate) -> np.ndarray:
        """Mean of `residuals` around each node, (n,), m; NaN where not seen."""
        step = max(1, round((depth_m.size / _NODE_PIXELS) ** 0.5))
        pixels = np.arange(depth_m.size).reshape(depth_m.shape)[::step, ::step].ravel()
        hits = self.view.hits(self.view.motion_seen(estimate), pixels)
        error_m = self._image_error_m(estimate, hits.ray, hits.range_m)
        residual = self.ranges(depth_m, hits.ray) - hits.range_m - error_m
        seen = np.isfinite(residual)
        nodes = self.mesh.triangles[hits.triangle[seen]].ravel()
        count = np.bincount(nodes, minlength=len(self.mesh.nodes))
        total = np.bincount(nodes, np.repeat(residual[seen], 3), len(count))
        return np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0)

    def ranges(self, depth_m: np.ndarray, pixels: np.ndarray) -> np.ndarray:
        """Calibrated ranges of pixels given by flat indices (k,), m; NaN in unused ones."""
        ranges = depth_m.ravel()[pixels] * self.camera.range_per_depth.ravel()[pixels]
        return ranges if self.pixels is None else self.pixels.at(pixels).corrected(ranges)
