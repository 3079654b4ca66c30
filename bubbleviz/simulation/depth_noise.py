"""Noise of a simulated depth camera, which depends on seed and frame index alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.special import ndtri

from bubbleviz.camera import DepthCamera
from bubbleviz.errors import InputError
from bubbleviz.sensor import Camera, Membrane, Pneumatics, Sensor, changed
from bubbleviz.sensor_model import SensorModel

_MAX_LAG = 32  # frames over which noise may be correlated


@dataclass(frozen=True, kw_only=True)
class DepthNoise:
    """Noise model of a depth camera."""

    relative: float = 0.0  # σ of range relative to range
    absolute_m: float = 0.0  # σ of range independent of range, m; the squares of both add
    # distance in pixels at which the correlation of two pixels' noise is 1/e; 0: white noise
    correlation_px: float = 0.0
    # correlation of one pixel's noise between consecutive frames, 0 to below 1
    correlation_frames: float = 0.0
    holes: float = 0.0  # fraction of pixels without a return, in blobs of the correlation length
    outliers: float = 0.0  # fraction of pixels with a range error of up to `outlier_m`
    outlier_m: float = 0.02  # largest error of an outlier, m

    def __post_init__(self) -> None:
        bad = [name for name, value in vars(self).items() if not 0.0 <= value < np.inf]
        shares = "relative", "correlation_frames", "holes", "outliers"
        bad += [name for name in shares if getattr(self, name) >= 1.0]
        if self.absolute_m > 0.1:
            raise InputError(
                f"noise absolute_m = {self.absolute_m} (--noise-sigma): above 0.1 m; give metres, "
                "not millimetres"
            )
        if bad:
            most = "below 1" if bad[0] in shares else "finite"
            option = " (--noise-sigma)" if bad[0] == "absolute_m" else ""
            raise InputError(
                f"noise {bad[0]} = {getattr(self, bad[0])}{option}: give 0 or more, {most}"
            )

    def apply(self, range_m: np.ndarray, seed: int, index: int) -> np.ndarray:
        """Noisy copy of a range image (H, W), m; NaN where there is no return."""
        noisy = range_m.copy()
        if self.relative or self.absolute_m:
            sigma = np.hypot(self.relative * range_m, self.absolute_m)
            noisy += sigma * self._unit_field(range_m.shape, seed, index)
        if self.outliers:
            random = np.random.default_rng([seed, index, 1])
            wrong = random.random(range_m.shape) < self.outliers
            noisy += np.where(wrong, random.uniform(-1.0, 1.0, range_m.shape) * self.outlier_m, 0.0)
        if self.holes:
            random = np.random.default_rng([seed, index, 2])
            blobs = _smoothed(random.standard_normal(range_m.shape), self.correlation_px)
            noisy[blobs < ndtri(self.holes)] = np.nan
        noisy[noisy <= 0.0] = np.nan
        return noisy

    def depth_image(
        self, camera: DepthCamera, range_m: np.ndarray, seed: int, index: int
    ) -> np.ndarray:
        """The same as z-depth image of a camera, (H, W) float32, m."""
        return camera.depth_image(self.apply(range_m, seed, index)).astype(np.float32)

    def _unit_field(self, shape: tuple[int, ...], seed: int, index: int) -> np.ndarray:
        """Normal noise of unit variance with the model's correlation in space and time."""
        rho = self.correlation_frames
        back = 1 if rho == 0.0 else min(_MAX_LAG, 1 + int(np.ceil(np.log(1e-3) / np.log(rho))))
        weights = rho ** np.arange(back)
        weights /= np.linalg.norm(weights)
        field = np.zeros(shape)
        for lag, weight in enumerate(weights):
            random = np.random.default_rng([seed, index + _MAX_LAG - lag, 0])
            field += weight * random.standard_normal(shape)
        return _smoothed(field, self.correlation_px)


def _smoothed(white: np.ndarray, correlation_px: float) -> np.ndarray:
    """White noise filtered to a Gaussian correlation exp(−(d/L)²), of unit variance."""
    if correlation_px <= 0.0:
        return white
    sigma = 0.5 * correlation_px  # the autocorrelation of a Gaussian kernel is √2 times as wide
    impulse = np.zeros(2 * int(4.0 * sigma + 1.0) + 1)
    impulse[len(impulse) // 2] = 1.0
    kernel = ndimage.gaussian_filter1d(impulse, sigma, mode="constant")
    smooth: np.ndarray = ndimage.gaussian_filter(white, sigma, mode="wrap") / np.sum(kernel**2)
    return smooth


# Variants of sensors, for studies.


def dome(prestretch: float) -> Sensor:
    """Spherical dome on a rim of 45 mm radius; γ0 by Young–Laplace."""
    camera = Camera(
        width=160, height=120, fx=88.0, fy=88.0, cx=79.5, cy=59.5, position_m=(0.0, 0.0, -0.063)
    )
    membrane = Membrane(rim_radius_m=0.045, height_m=0.029, nodes=1_000, prestretch=prestretch)
    gas = Pneumatics(gauge_pressure_pa=4_000.0, chamber_volume_m3=3e-4)
    return Sensor(name="dome", membrane=membrane, pneumatics=gas, camera=camera)


def with_nodes(sensor: Sensor, nodes: int) -> Sensor:
    """Sensor with another target number of nodes."""
    return changed(sensor, membrane={"nodes": nodes})


def resized(sensor: Sensor, width: int, height: int) -> Sensor:
    """Sensor whose camera has the same view with another image size."""
    own = sensor.camera
    x, y = width / own.width, height / own.height
    size = {"width": width, "height": height, "fx": own.fx * x, "fy": own.fy * y}
    middle = {"cx": (own.cx + 0.5) * x - 0.5, "cy": (own.cy + 0.5) * y - 0.5}
    return changed(sensor, camera={**size, **middle})


def with_pixels(sensor: Sensor, pixels: int | None) -> Sensor:
    """Sensor with the same field of view and about `pixels` pixels."""
    if pixels is None:
        return sensor
    own = sensor.camera
    factor = np.sqrt(pixels / (own.width * own.height))
    return resized(sensor, round(factor * own.width), round(factor * own.height))


def with_noise(model: SensorModel, noise: DepthNoise) -> SensorModel:
    """Sensor model that assumes the given noise."""
    distance = float(np.median(np.linalg.norm(model.mesh.nodes - model.camera.center, axis=1)))
    relative = max(float(np.hypot(noise.relative, noise.absolute_m / distance)), 1e-5)
    sensor = changed(model.sensor, camera={"noise_relative": relative})
    return SensorModel(sensor, model.camera, model.mesh, model.pixels)
