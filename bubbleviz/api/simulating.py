"""Presses that never happened, with the truth behind them."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, Self, overload

import numpy as np

from bubbleviz.api.blas_threads import OneBlasThread
from bubbleviz.api.chosen_frames import Frames
from bubbleviz.commands.simulate import simulated_press, write_simulation
from bubbleviz.frames.frame import Frame
from bubbleviz.rigid_object import RigidObject
from bubbleviz.sensor import Sensor
from bubbleviz.simulation.depth_noise import DepthNoise
from bubbleviz.simulation.printed_speckle import Speckle
from bubbleviz.simulation.synthetic_source import SyntheticSource
from bubbleviz.simulation.truth import Truth


class Simulation(Frames):
    """Simulated frames, made when they are asked for.

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
        """One frame, or some of them; SolveError where there is no equilibrium."""
        with OneBlasThread():
            return super().__getitem__(index)

    def truth(self, index: int) -> Truth:
        """What is true of a frame: displacement, contact pressure, force, patch; SI units."""
        with OneBlasThread():
            return self.source.truth(self.chosen[index])

    def save(self, recording: str | Path, truth: str | Path | None = None) -> None:
        """Write all frames as a recording, and TRUTH.npz where it is asked for.

        Raises
        ------
        InputError
            A file exists or cannot be written; nothing is written then.
        """
        with OneBlasThread():
            write_simulation(self.source, Path(recording), None if truth is None else Path(truth))


def simulate(
    sensor: str | Path | Sensor,
    object: str | Path | RigidObject,
    pose: str | Path | np.ndarray,
    *,
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
    """Press a rigid object into a simulated sensor (Eq. 16, or the exact membrane).

    Parameters
    ----------
    sensor : str, path or Sensor
        Sensor file or preset.
    object : str, path or RigidObject
        Mesh file or preset.
    pose : str, Path or array
        T_B_O: "x y z qx qy qz qw" (m, unit quaternion) or an array (4, 4) for all frames, an array
        (F, 4, 4), or the `Path` of a CSV with a pose for each frame.
    frames : int
        Frames at one pose.
    rate_hz : float
        Frames a second.
    noise_sigma_m, noise_relative : float
        σ of range, m, and over range; both add in squares.
    noise_correlation_px : float
        1/e distance of the noise, pixels; 0 for white noise.
    holes, outliers : float
        Fractions of pixels without a return, and far off.
    seed : int
    model : {"rubber", "linear"}, optional
        By default the exact membrane where the sensor has a pre-stretch.
    friction : float
        Coulomb's μ between object and exact membrane, up to 5; each frame then follows from those
        before. 0: it slides freely.
    drag_m, twist_rad : float
        The object comes from above to the one pose given, is dragged along x of the bubble frame,
        m, and twisted about its own z axis, rad; 10 frames or more.
    texture : bool
        Print a speckle on the membrane, which `frame.colour` shows.

    Returns
    -------
    Simulation
        Frames with their truth; InputError and SolveError where a frame has no equilibrium.

    Raises
    ------
    InputError
        Something given does not exist or does not fit together.

    Examples
    --------
    >>> press = bv.simulate("pico_flexx_75mm", "cylinder", "0 0 0.042 0 0 0 1", frames=3)
    >>> press.truth(0).force_n
    array([...])
    """
    noise = DepthNoise(
        relative=noise_relative,
        absolute_m=noise_sigma_m,
        correlation_px=noise_correlation_px,
        holes=holes,
        outliers=outliers,
    )
    with OneBlasThread():
        source = simulated_press(
            sensor,
            object,
            pose,
            noise,
            frames=frames,
            rate_hz=rate_hz,
            seed=seed,
            model=model,
            friction=friction,
            drag_m=drag_m,
            twist_rad=twist_rad,
            texture=Speckle(seed=seed) if texture else None,
        )
    return Simulation(source)
