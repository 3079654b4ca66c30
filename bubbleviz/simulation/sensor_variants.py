"""Sensors that differ from another in one thing, for studies."""

from __future__ import annotations

import numpy as np

from bubbleviz.sensor import Camera, Membrane, Pneumatics, Sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation.depth_noise import DepthNoise


def dome(prestretch: float) -> Sensor:
    """Spherical dome on a rim of 45 mm radius; γ0 by Young–Laplace."""
    camera = Camera(
        width=160, height=120, fx=88.0, fy=88.0, cx=79.5, cy=59.5, position_m=(0.0, 0.0, -0.063)
    )
    membrane = Membrane(rim_radius_m=0.045, height_m=0.029, nodes=1_000, prestretch=prestretch)
    gas = Pneumatics(gauge_pressure_pa=4_000.0, chamber_volume_m3=3e-4)
    return Sensor(name="dome", membrane=membrane, pneumatics=gas, camera=camera)


def with_nodes(sensor: Sensor, nodes: int | None) -> Sensor:
    """Sensor with another target number of nodes."""
    if nodes is None:
        return sensor
    membrane = sensor.membrane.model_copy(update={"nodes": nodes})
    return sensor.model_copy(update={"membrane": membrane})


def strided(sensor: Sensor, stride: int) -> Sensor:
    """Sensor whose camera has only every stride-th pixel of every stride-th row."""
    own = sensor.camera
    size = {name: -(-getattr(own, name) // stride) for name in ("width", "height")}
    lens = {name: getattr(own, name) / stride for name in ("fx", "fy", "cx", "cy")}
    return sensor.model_copy(update={"camera": own.model_copy(update={**size, **lens})})


def resized(sensor: Sensor, width: int, height: int) -> Sensor:
    """Sensor whose camera sees the same with other pixels."""
    own = sensor.camera
    x, y = width / own.width, height / own.height
    size = {"width": width, "height": height, "fx": own.fx * x, "fy": own.fy * y}
    middle = {"cx": (own.cx + 0.5) * x - 0.5, "cy": (own.cy + 0.5) * y - 0.5}
    return sensor.model_copy(update={"camera": own.model_copy(update={**size, **middle})})


def with_pixels(sensor: Sensor, pixels: int | None) -> Sensor:
    """Sensor whose camera sees the same with about as many pixels as asked."""
    if pixels is None:
        return sensor
    own = sensor.camera
    factor = np.sqrt(pixels / (own.width * own.height))
    return resized(sensor, round(factor * own.width), round(factor * own.height))


def with_noise(model: SensorModel, noise: DepthNoise) -> SensorModel:
    """The sensor with the noise of its camera."""
    distance = float(np.median(np.linalg.norm(model.mesh.nodes - model.camera.center, axis=1)))
    relative = max(float(np.hypot(noise.relative, noise.absolute_m / distance)), 1e-5)
    camera = model.sensor.camera.model_copy(update={"noise_relative": relative})
    sensor = model.sensor.model_copy(update={"camera": camera})
    return SensorModel(sensor, model.camera, model.mesh, model.pixels)
