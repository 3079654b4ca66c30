"""A simulated press on a sensor: what errors of its file mean for the force."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bubbleviz.calibration.surface import Quantity
from bubbleviz.errors import InputError, SolveError
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import Frame
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation import DepthNoise, SyntheticSource, touching_height

_DEPTH = 0.15  # over the height of the dome; chosen


class Press(NamedTuple):
    """A simulated press, and its true force (3,), N."""

    frame: Frame
    force_n: np.ndarray


def reference_press(pipeline: Pipeline, noise: DepthNoise | None = None) -> Press | None:
    """Press of a ball on the apex, as the camera of the sensor sees it; None: not computable."""
    model = pipeline.model
    mesh, ball = model.mesh, load_object("sphere")
    top, pose = int(np.argmax(mesh.nodes[:, 2])), np.eye(4)
    pose[:2, 3] = mesh.nodes[top, :2]
    pose[2, 3] = touching_height(ball, pose, mesh) - _DEPTH * mesh.nodes[top, 2]
    try:
        source = SyntheticSource(model, ball, pose[None], noise)
        press, force_n = source[0], source.truth(0).force_n
    except (InputError, SolveError):
        return None
    depth = model.biased_depth(press.depth_m * model.camera.range_per_depth)
    return Press(replace(press, depth_m=depth.astype(np.float32)), force_n)


def press_force(pipeline: Pipeline, press: Frame) -> tuple[np.ndarray, float] | None:
    """Estimated force (3,) and half of the 95 % interval of its size, N; None: no such estimate."""
    pipeline.restart()
    result = pipeline.process(press, frozenset({"patch"}))
    if result.patch is None or result.estimate is None or result.estimate.status != "ok":
        return None
    return result.patch.force_n, result.estimate.force_half_width_n


def reference_force(model: SensorModel) -> Quantity | None:
    """True force of the press with the interval of its estimate, N; None: no estimate.

    The estimate is of one image with the noise of the sensor file. Where its error is larger than
    half of its interval, the interval is as wide as the error. The intervals of λ and gauge
    pressure are included; a λ without interval counts as exact.
    """
    pipeline = Pipeline(model)
    press = reference_press(pipeline, DepthNoise(relative=model.sensor.camera.noise_relative))
    if press is None or (found := press_force(pipeline, press.frame)) is None:
        return None
    estimated_n, half_width = found
    force = float(np.linalg.norm(press.force_n))
    half_width = max(half_width, float(np.linalg.norm(estimated_n - press.force_n)))
    depth = 1e3 * _DEPTH * float(np.max(model.mesh.nodes[:, 2]))
    source = f"a simulated press of {depth:.2g} mm"
    return Quantity(force, force - half_width, force + half_width, source)
