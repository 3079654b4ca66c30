"""Simulated presses with ground truth."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal, Self, get_args, overload

import numpy as np

from bubbleviz.api.frames import Frames
from bubbleviz.api.results import OneBlasThread
from bubbleviz.api.summary import Summary
from bubbleviz.errors import InputError, check_choice, check_number
from bubbleviz.files import checked_pose, parse_pose, read_path, whole_file
from bubbleviz.membrane import build_mesh
from bubbleviz.output import surface_arrays
from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import Frame, RecordingWriter
from bubbleviz.rigid_object import RigidObject, load_object
from bubbleviz.sensor import Sensor, load_sensor
from bubbleviz.simulation import (
    DepthNoise,
    Model,
    SyntheticSource,
    Truth,
    press_path,
)
from bubbleviz.wording import count_of


@dataclass(frozen=True)
class SimulationSummary(Summary):
    """Summary of a saved simulation."""

    out: str
    frames: int
    max_force_n: float  # largest magnitude; 0 if the object touches nothing

    def to_text(self) -> str:
        """Text for the terminal."""
        touches = f"largest force {self.max_force_n:.3g} N"
        force = touches if self.max_force_n else "the object touches nothing"
        return f"wrote   {self.out}: {count_of(self.frames, 'frame')}, {force}"


class Simulation(Frames):
    """Simulated frames, computed on access.

    Parameters
    ----------
    source : SyntheticSource
    chosen : range, optional
        Indices of the frames in the source; all by default.
    """

    source: SyntheticSource

    @overload
    def __getitem__(self, index: int) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> Self: ...
    def __getitem__(self, index: int | slice) -> Frame | Self:
        """One frame, or a slice of frames. Raises SolveError: there is no equilibrium."""
        with OneBlasThread():
            return super().__getitem__(index)

    def truth(self, index: int) -> Truth:
        """Ground truth of a frame: displacement, contact pressure, force, patch; SI units."""
        with OneBlasThread():
            return self.source.truth(self.chosen[index])

    def save(
        self,
        out: str | Path,
        truth: str | Path | None = None,
        *,
        overwrite: bool = False,
        progress: Progress = quiet,
    ) -> SimulationSummary:
        """Write all frames as a recording, and TRUTH.npz if requested; in case of errors nothing.

        Raises
        ------
        InputError
            A file exists or cannot be written.
        SolveError
            No equilibrium at a pose.
        """
        if truth is not None and Path(truth).absolute() == Path(out).absolute():
            raise InputError(f"{out}: given for both --out and --truth; choose two names")
        truths, largest_n = list[Truth](), 0.0
        with OneBlasThread(), ExitStack() as stack:
            file = truth and stack.enter_context(whole_file(truth, ".npz", overwrite=overwrite))
            writer = stack.enter_context(RecordingWriter(out, overwrite=overwrite))
            for done, index in enumerate(self.chosen, 1):
                writer.write(self.source[index])
                force = self.source.contact(index).nodal_force_n.sum(axis=0)
                largest_n = max(largest_n, float(np.linalg.norm(force)))
                if file:
                    truths.append(self.source.truth(index))
                progress("simulating", done / len(self))
            if file:
                arrays: dict[str, Any] = _truth_arrays(self.source, self.chosen, truths)
                with file.open("wb") as opened:
                    np.savez_compressed(opened, **arrays)
        return SimulationSummary(str(out), len(self), largest_n)


def simulate(
    sensor: str | Path | Sensor,
    object: str | Path | RigidObject,
    pose: str | Path | np.ndarray,
    *,
    unit: Literal["m", "mm"] | None = None,
    frames: int = 1,
    rate_hz: float = 30.0,
    noise_sigma_m: float = 0.0,
    noise_relative: float = 0.0,
    noise_correlation_px: float = 0.0,
    holes: float = 0.0,
    outliers: float = 0.0,
    seed: int = 0,
    model: Literal["rubber", "linear"] | None = None,
    friction: float = 0.0,
    drag_m: float = 0.0,
    twist_rad: float = 0.0,
    texture: bool = False,
) -> Simulation:
    """Simulate a rigid object pressed into a sensor.

    Solves Eq. 16, or the exact membrane.

    Parameters
    ----------
    sensor : str, path or Sensor
        Sensor file or preset.
    object : str, path or RigidObject
        Preset or mesh file.
    pose : str, Path or array
        T_B_O: "x y z qx qy qz qw" (m, unit quaternion) or an array (4, 4) for all frames, an array
        (F, 4, 4), or the `Path` of a CSV with a pose for each frame.
    unit : {"m", "mm"}, optional
        Unit of the object's mesh file; by default mm if its name ends in `_mm`, else m.
    frames : int
        Frames at one pose.
    rate_hz : float
        Frames per second.
    noise_sigma_m : float
        Noise: standard deviation of range, m.
    noise_relative : float
        Noise: standard deviation of range divided by range; the variances of both add.
    noise_correlation_px : float
        1/e distance of the noise's correlation, pixels; 0: white noise.
    holes : float
        Fraction of pixels without a return, from 0 to below 1.
    outliers : float
        Fraction of pixels with a grossly wrong depth, from 0 to below 1.
    seed : int
        Seed of the noise.
    model : {"rubber", "linear"}, optional
        rubber: exact membrane, default if the sensor has a pre-stretch; linear: constant tension.
    friction : float
        Coulomb's μ between object and exact membrane, up to 5; each frame then depends on the
        previous ones. 0: frictionless.
    drag_m : float
        After a press from above at a single pose, drag the object along x of B, m; needs 10 frames
        or more.
    twist_rad : float
        After press and drag, twist the object about its z axis, rad; needs 10 frames or more.
    texture : bool
        Print a speckle texture on the membrane, and add colour images.

    Returns
    -------
    Simulation
        Frames with ground truth; access raises SolveError if a frame has no equilibrium.

    Raises
    ------
    InputError
        An input does not exist or does not match the others.

    Examples
    --------
    >>> press = bv.simulate("pico_flexx_75mm", "cylinder", "0 0 0.042 0 0 0 1", frames=3)
    >>> press.truth(0).force_n
    array([...])
    """
    check_number("--frames", frames, 1, whole=True)
    check_number("--seed", seed, 0, whole=True)
    check_number("--rate", rate_hz, 0.01, 1e4)
    check_choice("--model", model, (None, *get_args(Model)))
    noise = DepthNoise(
        relative=noise_relative,
        absolute_m=noise_sigma_m,
        correlation_px=noise_correlation_px,
        holes=holes,
        outliers=outliers,
    )
    sensor, obj, times = load_sensor(sensor), load_object(object, unit), None
    moved = drag_m != 0.0 or twist_rad != 0.0
    with OneBlasThread():
        if isinstance(pose, Path):
            poses, times = read_path(pose)
        else:
            poses = parse_pose(pose) if isinstance(pose, str) else np.asarray(pose, np.float64)
            if poses.ndim == 2 and moved:
                mesh, moved = build_mesh(sensor), False
                poses = press_path(obj, checked_pose(poses), mesh, frames, drag_m, twist_rad)
            elif poses.ndim == 2:
                poses = np.repeat(poses[None], frames, axis=0)
        if moved:
            raise InputError(
                "--drag-m and --twist-rad start from a single pose; give --pose instead of --path, "
                "or leave them out"
            )
        source = SyntheticSource(
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
    return Simulation(source)


def _truth_arrays(
    source: SyntheticSource, chosen: range, truths: list[Truth]
) -> dict[str, np.ndarray]:
    """Arrays of TRUTH.npz, with the names of RESULT.npz, on the simulation's mesh, and T_B_O."""
    touched = [np.isfinite(t.center_of_pressure_m[0]) for t in truths]
    return {
        "frame": np.arange(len(truths)),
        "time_s": source.times_s[chosen] - source.times_s[chosen[0]],
        "status": np.where(touched, "ok", "no_contact"),
        **surface_arrays(source.mesh),
        "T_B_O": source.poses[chosen],
        **{
            field.name: np.stack([getattr(truth, field.name) for truth in truths])
            for field in fields(Truth)
        },
    }
