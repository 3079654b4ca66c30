"""Contact-free frames of an identification with their per-pixel statistics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bubbleviz.calibration.rest.depth_statistics import MIN_FRAMES, DepthStatistics, measure_depth
from bubbleviz.camera.depth_camera import DepthCamera
from bubbleviz.errors import InputError
from bubbleviz.frames.frame_source import FrameSource
from bubbleviz.membrane.reference_mesh import build_mesh
from bubbleviz.progress import Progress, quiet
from bubbleviz.sensor import Sensor
from bubbleviz.wording import count_of

MAX_FRAMES = 150
"""Frames above which more of them only cost memory: every so many-th is used then."""

_WRONG_UNIT = np.sqrt(10.0)  # half way, in ratio, to a unit ten times as large


@dataclass(frozen=True)
class Samples:
    """Contact-free frames of one camera.

    Attributes
    ----------
    source_name : str
    frames : tuple of int
        Their numbers in the recording.
    depth_m : (F, H, W) float32 array
        z-depth, m; NaN: no return.
    gas_pressure_pa : (F,) array or None
        Absolute; None where a frame lacks it.
    camera : DepthCamera
        As the sensor file has it in B, with the recording's intrinsics.
    statistics : DepthStatistics
    """

    source_name: str
    frames: tuple[int, ...]
    depth_m: np.ndarray
    gas_pressure_pa: np.ndarray | None
    camera: DepthCamera
    statistics: DepthStatistics


def collect(
    source: FrameSource, sensor: Sensor, chosen: Sequence[int], progress: Progress = quiet
) -> Samples:
    """Read the chosen frames and measure every pixel over them.

    Parameters
    ----------
    source : FrameSource
    sensor : Sensor
        Camera pose, intrinsics where the recording has none, and how far away a membrane is.
    chosen : sequence of int
        Contact-free frames: any, so that one can be taken out again.

    Raises
    ------
    InputError
        Fewer than 5 frames, frames of another camera, no returns, or depth in a wrong unit.
    """
    if len(chosen) and not 0 <= min(chosen) <= max(chosen) < len(source):
        raise InputError(
            f"{source.name}: contact-free frames {min(chosen)}:{max(chosen) + 1} are outside its"
            f" {count_of(len(source), 'frame')}; name others"
        )
    if len(chosen) < MIN_FRAMES:
        raise InputError(
            f"{source.name}: {count_of(len(chosen), 'contact-free frame')}; name at least"
            f" {MIN_FRAMES}"
        )
    chosen = list(chosen)[:: -(-len(chosen) // MAX_FRAMES)]
    images: list[np.ndarray] = []
    pressures: list[float] = []
    for number, k in enumerate(chosen):
        frame = source[k]
        if images and frame.depth_m.shape != images[0].shape:
            raise InputError(f"{source.name}: frame {k} differs in size; record one camera mode")
        images.append(frame.depth_m)
        pressures.append(np.nan if frame.gas_pressure_pa is None else frame.gas_pressure_pa)
        if number == 0:
            camera = DepthCamera.of(sensor.camera, frame.intrinsics)
            _check_unit(source.name, frame.depth_m, sensor, camera)
        progress("reading frames", (number + 1) / len(chosen))
    progress("measuring pixels", 0.0)
    depth = np.stack(images).astype(np.float32, copy=False)
    gas = np.array(pressures)
    return Samples(
        source_name=source.name,
        frames=tuple(chosen),
        depth_m=depth,
        gas_pressure_pa=gas if np.isfinite(gas).all() else None,
        camera=camera,
        statistics=measure_depth(depth, camera.range_per_depth),
    )


def _check_unit(name: str, depth_m: np.ndarray, sensor: Sensor, camera: DepthCamera) -> None:
    """Refuse depths whose scale differs from the sensor file's by a power of ten (mm for m)."""
    valid = depth_m[np.isfinite(depth_m)]
    if not valid.size:
        return  # measure_depth says so, over all frames
    drawn = (build_mesh(sensor).nodes - camera.center) @ camera.T_B_C[:3, 2]
    measured, expected = float(np.median(valid)), float(np.median(drawn))
    if not expected / _WRONG_UNIT < measured < expected * _WRONG_UNIT:
        raise InputError(
            f"{name}: depth of {measured:.3g} m, but the sensor file has its membrane"
            f" {expected:.3g} m from the camera: wrong unit? record 16UC1 in millimetres or 32FC1"
            " in metres"
        )
