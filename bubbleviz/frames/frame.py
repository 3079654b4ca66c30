"""One frame of one sensor, from any source."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bubbleviz.camera.intrinsics import Intrinsics
from bubbleviz.colour.colour_image import ColourImage

NO_COLOUR = "no colour images in this source"


@dataclass(frozen=True)
class Frame:
    """A depth image and what was measured with it.

    Attributes
    ----------
    index : int
        Index in the recording, or count since a live source started.
    time_s : float
        Seconds from the start of the recording.
    depth_m : (H, W) float32 array
        z-depth in metres; NaN where there is no return.
    intrinsics : Intrinsics or None
        From the recording's CameraInfo, which wins over the sensor file's.
    gas_pressure_pa : float or None
        Absolute gas pressure at the frame's time, in Pa.
    wrench : (6,) array or None
        Force in N and torque in N·m as recorded, in the wrench sensor's own axes.
    stamp_ns : int
        The message's own time stamp.
    arrival_ns : int
        When a live frame arrived here, ns since 1970; 0 for a recording's.
    find_colour : callable or None
        Finds the colour image whose stamp is nearest to this frame's plus a time in s; nothing is
        read before it is asked for.
    colour_delay_s : float
        Stamp of a colour image minus that of the depth image of the same moment, s: negative where
        colour leads depth. Live streams and `Pipeline` set the sensor's; else 0.
    no_colour : str
        Why there is no `find_colour`, in a few words.
    gas_sigma_pa : float
        Standard deviation of the zero of the gas pressure, Pa: the weather's where that of the
        sensor file's day is not known to hold, see `PressureZero`.
    """

    index: int
    time_s: float
    depth_m: np.ndarray
    intrinsics: Intrinsics | None = None
    gas_pressure_pa: float | None = None
    wrench: np.ndarray | None = None
    stamp_ns: int = 0
    arrival_ns: int = 0
    find_colour: Callable[[float], ColourImage | None] | None = None
    colour_delay_s: float = 0.0
    no_colour: str = NO_COLOUR
    gas_sigma_pa: float = 0.0

    @property
    def colour(self) -> ColourImage | None:
        """Colour image of the moment of the depth image, by `colour_delay_s`; None without one."""
        return None if self.find_colour is None else self.find_colour(self.colour_delay_s)
