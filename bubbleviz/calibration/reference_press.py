"""A simulated press on a sensor: what errors of its file mean for the force."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bubbleviz.calibration.surface import Quantity
from bubbleviz.errors import InputError, SolveError
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import Frame
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation import SyntheticSource, touching_height

_DEPTH = 0.15  # over the height of the dome; chosen


def reference_press(pipeline: Pipeline) -> Frame | None:
    """Press of a ball on the apex, as the camera of the sensor sees it; None: not computable."""
    model = pipeline.model
    mesh, ball = model.mesh, load_object("sphere")
    top, pose = int(np.argmax(mesh.nodes[:, 2])), np.eye(4)
    pose[:2, 3] = mesh.nodes[top, :2]
    pose[2, 3] = touching_height(ball, pose, mesh) - _DEPTH * mesh.nodes[top, 2]
    try:
        press = SyntheticSource(model, ball, pose[None])[0]
    except (InputError, SolveError):
        return None
    depth = model.biased_depth(press.depth_m * model.camera.range_per_depth)
    return replace(press, depth_m=depth.astype(np.float32))


def press_force(pipeline: Pipeline, press: Frame) -> tuple[np.ndarray, float] | None:
    """Estimated force (3,) and half of the 95 % interval of its size, N; None: not trusted."""
    pipeline.restart()
    result = pipeline.process(press, frozenset({"patch"}))
    if result.estimate is None or result.patch is None or not result.estimate.trusted:
        return None
    return result.patch.force_n, result.estimate.force_half_width_n


def reference_force(model: SensorModel) -> Quantity | None:
    """Size of the force of the press, N, as estimated with a sensor file; None: not trusted."""
    pipeline = Pipeline(model)
    press = reference_press(pipeline)
    found = None if press is None else press_force(pipeline, press)
    if found is None:
        return None
    force, half_width = float(np.linalg.norm(found[0])), found[1]
    depth = 1e3 * _DEPTH * float(np.max(model.mesh.nodes[:, 2]))
    return Quantity(force, force - half_width, force + half_width, f"{depth:.2g} mm")
