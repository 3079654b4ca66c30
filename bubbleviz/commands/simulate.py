"""The work of `bubbleviz simulate`: a recording of a simulated press, and the truth behind it."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from bubbleviz.errors import InputError
from bubbleviz.files.output_files import refuse_existing, whole_file
from bubbleviz.files.pose_reader import parse_pose, read_path
from bubbleviz.frames.recording_writer import RecordingWriter
from bubbleviz.membrane.gap import checked_pose
from bubbleviz.membrane.reference_mesh import build_mesh
from bubbleviz.rigid_object import RigidObject, load_object
from bubbleviz.sensor import Sensor, load_sensor
from bubbleviz.simulation.depth_noise import DepthNoise
from bubbleviz.simulation.press_path import press_path
from bubbleviz.simulation.printed_speckle import Speckle
from bubbleviz.simulation.synthetic_source import Model, SyntheticSource
from bubbleviz.simulation.truth import Truth


def simulated_press(
    sensor: str | Path | Sensor,
    object_name: str | Path | RigidObject,
    pose: str | Path | np.ndarray,
    noise: DepthNoise,
    *,
    frames: int = 1,
    rate_hz: float = 30.0,
    seed: int = 0,
    model: Model | None = None,
    friction: float = 0.0,
    drag_m: float = 0.0,
    twist_rad: float = 0.0,
    texture: Speckle | None = None,
) -> SyntheticSource:
    """Source of the frames that the command line describes.

    Parameters
    ----------
    sensor : str, path or Sensor
    object_name : str, path or RigidObject
        File or preset where it is not loaded yet.
    pose : str, Path or array
        T_B_O: a `Path` is a CSV with a pose for each frame, an array (F, 4, 4) has them; text, or
        an array (4, 4), is one pose, kept for `frames` frames.
    noise : DepthNoise
    frames : int
    rate_hz : float
        Where the CSV has no times.
    seed : int
    model, texture : optional
        As of `SyntheticSource`.
    friction : float
        As of `SyntheticSource`.
    drag_m, twist_rad : float
        Motion of an object that is pressed to one pose, as of `press_path`.

    Raises
    ------
    InputError
        Something given does not exist or does not fit together.
    """
    sensor, obj, times = load_sensor(sensor), load_object(object_name), None
    moved = drag_m != 0.0 or twist_rad != 0.0
    if isinstance(pose, Path):
        poses, times = read_path(pose)
    else:
        poses = parse_pose(pose) if isinstance(pose, str) else np.asarray(pose, dtype=np.float64)
        if poses.ndim == 2 and moved:
            mesh, moved = build_mesh(sensor), False
            poses = press_path(obj, checked_pose(poses), mesh, frames, drag_m, twist_rad)
        elif poses.ndim == 2:
            poses = np.repeat(poses[None], frames, axis=0)
    if moved:
        raise InputError("drag and twist: give one pose to press to, not a path")
    return SyntheticSource(
        sensor,
        obj,
        poses,
        noise,
        rate_hz,
        seed,
        times_s=times,
        model=model,
        friction=friction,
        texture=texture,
    )


def write_simulation(source: SyntheticSource, out: Path, truth: Path | None = None) -> int:
    """Write all frames of a source, and TRUTH.npz where it is asked for; count of frames.

    Raises
    ------
    InputError
        A file exists or cannot be written.
    SolveError
        No equilibrium at a pose; nothing is written.
    """
    for path in filter(None, (out, truth)):
        refuse_existing(path)
    truths: list[Truth] = []
    with ExitStack() as stack:
        temporary = stack.enter_context(whole_file(truth)) if truth else None
        writer = stack.enter_context(RecordingWriter(out))
        for index in tqdm(range(len(source)), unit="frame", disable=None):  # only on a terminal
            writer.write(source[index])
            if temporary:
                truths.append(source.truth(index))
        if temporary:
            with temporary.open("wb") as file:
                arrays: dict[str, Any] = truth_arrays(source, truths)
                np.savez_compressed(file, **arrays)
    return len(source)


def truth_arrays(source: SyntheticSource, truths: list[Truth]) -> dict[str, np.ndarray]:
    """Arrays of TRUTH.npz: the names of RESULT.npz, on the simulation's mesh, and T_B_O."""
    mesh = source.mesh
    touched = [np.isfinite(t.center_of_pressure_m[0]) for t in truths]
    return {
        "frame": np.arange(len(truths)),
        "time_s": source.times_s[: len(truths)],
        "status": np.where(touched, "ok", "no_contact"),
        "nodes_m": mesh.nodes,
        "normals": mesh.normals,
        "triangles": mesh.triangles,
        "rim": mesh.rim,
        "T_B_O": source.poses[: len(truths)],
        **{
            field.name: np.stack([getattr(truth, field.name) for truth in truths])
            for field in fields(Truth)
        },
    }
