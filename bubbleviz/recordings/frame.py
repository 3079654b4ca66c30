"""One frame of one sensor, from any source."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from bubbleviz.camera import ColourImage, ImageErrors, Intrinsics
from bubbleviz.errors import InputError

NO_COLOUR = "no colour images of this sensor in a known encoding"
SAME_CLOCK_NS = 5_000_000_000
"""Stamps further than this from the arrival are from another clock: age counts from arrival."""


@dataclass(frozen=True, repr=False, eq=False)
class Frame:
    """A depth image and what was measured with it.

    Attributes
    ----------
    index : int
        Index in the recording, or count since a live source started.
    time_s : float
        Seconds from the start of the recording.
    depth_m : (H, W) float32 array
        z-depth in metres; NaN where there is no return. Given zeros and negative values become NaN.
    intrinsics : Intrinsics or None
        From the recording's CameraInfo, instead of the sensor file's.
    gas_pressure_pa : float or None
        Absolute gas pressure at the frame's time, in Pa.
    wrench : (6,) array or None
        Force in N and torque in N·m as recorded, in the wrench sensor's own axes.
    stamp_ns : int
        The message's own time stamp.
    arrival_ns : int
        When a live frame arrived here, ns since 1970; 0 for a recording's.
    find_colour : callable or None
        Finds the colour image whose stamp is nearest to this frame's plus a time in s, and reads it
        only then.
    colour_delay_s : float
        Stamp of a colour image minus that of the depth image of the same moment, s: negative where
        colour leads depth. Live streams and `Pipeline` set the sensor's; else 0.
    no_colour : str
        Why there is no `find_colour`, in a few words.
    gas_sigma_pa : float
        Standard deviation of the zero of the gas pressure, Pa: the weather's if the zero was not
        measured in this recording, see `PressureZero`.
    image_errors : ImageErrors or None
        Errors of the entire depth image as known from frames without contact, see `ImageZero`.
    noise : float
        Noise factor of the depth image averaged over blocks of pixels, as known from frames without
        contact, see `ImageZero`: above 1 where noise is larger than in the sensor file, or
        correlated.
    mean_depth_m : (H, W) float32 array or None
        Mean of this depth image and those around that show the same, see `StillFrames`.
    images : int
        Number of depth images in that mean.
    mean_noise : float
        Standard deviation of the mean image's noise over that of one image, if the noise of images
        is independent. 1 in a stream, where the mean is not refined for the sake of the rate.
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
    image_errors: ImageErrors | None = None
    noise: float = 1.0
    mean_depth_m: np.ndarray | None = None
    images: int = 1
    mean_noise: float = 1.0

    def __post_init__(self) -> None:
        no_return = self.depth_m <= 0.0  # as plug-ins and callers write it
        if no_return.any():
            object.__setattr__(
                self, "depth_m", np.where(no_return, np.float32(np.nan), self.depth_m)
            )

    @property
    def steady_depth_m(self) -> np.ndarray:
        """Depth image (H, W) that estimates use: the mean if there is one, else the frame's own."""
        return self.depth_m if self.mean_depth_m is None else self.mean_depth_m

    @property
    def colour(self) -> ColourImage | None:
        """Colour image of the moment of the depth image, by `colour_delay_s`; None without one."""
        return None if self.find_colour is None else self.find_colour(self.colour_delay_s)

    @property
    def taken_ns(self) -> int | None:
        """Time a live image was taken, ns since 1970 on the local clock; None for others.

        Its stamp or, if that is from another clock, its arrival.
        """
        if not self.arrival_ns:
            return None
        same_clock = abs(self.arrival_ns - self.stamp_ns) < SAME_CLOCK_NS
        return self.stamp_ns if same_clock else self.arrival_ns

    def __repr__(self) -> str:
        height, width = self.depth_m.shape
        image = f"{width}×{height} pixels" if self.depth_m.size else "image not kept"
        gas = self.gas_pressure_pa
        measured = "" if gas is None else f", gas {1e-3 * gas:.2f} kPa"
        return f"<frame {self.index} at {self.time_s:.3f} s: {image}{measured}>"


# Interface of the frame sources.


@runtime_checkable
class FrameSource(Protocol):
    """Frames by index: a recording, or a simulation that renders them on demand.

    Attributes
    ----------
    name : str
        Name in the window title.
    """

    name: str

    @property
    def times_s(self) -> np.ndarray:
        """Time of each frame from the start, s, (F,)."""

    def __len__(self) -> int:
        """Count the frames."""

    def __getitem__(self, index: int) -> Frame:
        """Frame number `index`; IndexError outside 0 … F−1, InputError if it cannot be read."""

    def close(self) -> None:
        """Close files."""


def shown_name(source: FrameSource) -> str:
    """Name of a source in messages: the path of a file, else its name."""
    return str(getattr(source, "path", None) or source.name)


def check_index(index: int, source: FrameSource) -> None:
    """Raise IndexError unless a source has a frame of this index."""
    if not 0 <= index < len(source):
        raise IndexError(f"frame {index} is outside 0 … {len(source) - 1} of {shown_name(source)}")


FROZEN_AFTER = 30  # equal images in a row, a second of most cameras; chosen


class EqualImages:
    """Counts depth images in a row that are equal to the last bit.

    The noise of a working camera never repeats; a hung camera repeats its last image.
    """

    def __init__(self) -> None:
        self._last: np.ndarray | None = None
        self._row = 1
        self.most = 1  # images in the longest row

    def take(self, depth_m: np.ndarray) -> None:
        """Compare an image (H, W) with the previous one; images without returns are ignored."""
        last, self._last = self._last, depth_m
        some = depth_m[::16, ::16]  # differs in nearly all cases
        same = last is not None and np.array_equal(last[::16, ::16], some, equal_nan=True)
        same = same and np.array_equal(last, depth_m, equal_nan=True)  # type: ignore[arg-type]
        self._row = self._row + 1 if same and np.isfinite(depth_m).any() else 1
        self.most = max(self.most, self._row)

    @property
    def warning(self) -> str:
        """Warning about a camera that repeated one image; stays after the camera recovers."""
        if self.most < FROZEN_AFTER:
            return ""
        return (
            f"{self.most} depth images in a row were identical to the last bit: the camera hung "
            "(restart it), or this is a simulation without noise"
        )


# A source that is iterated several times but read once.


CACHE_BYTES = 512 << 20
"""Memory for cached depth images: 436 of 640×480 pixels."""


class CachedFrames:
    """Caches the frames of a source as they are read, up to a memory limit.

    The first frames are cached, since several calibration steps use the contact-free ones; later
    frames are read again.
    """

    def __init__(
        self,
        source: FrameSource,  # not closed with this
        limit_bytes: int = CACHE_BYTES,  # of depth images
    ) -> None:
        self._source, self._limit, self._left = source, limit_bytes, limit_bytes
        self._frames: dict[int, Frame] = {}
        self.name = source.name
        self.path: Path | None = getattr(source, "path", None)  # of the source, where it is a file

    @property
    def times_s(self) -> np.ndarray:
        """Time of each frame from the start, s, (F,)."""
        return self._source.times_s

    def __len__(self) -> int:
        return len(self._source)

    def __getitem__(self, index: int) -> Frame:
        """Frame number `index`; the same errors as the source."""
        if index in self._frames:
            return self._frames[index]
        frame = self._source[index]
        if frame.depth_m.nbytes <= self._left:
            self._left -= frame.depth_m.nbytes
            self._frames[index] = frame
        return frame

    def close(self) -> None:
        self._frames.clear()
        self._left = self._limit


class HeldFrames:
    """A source of frames in memory; InputError if there are none."""

    def __init__(self, frames: Sequence[Frame], name: str = "") -> None:
        if not frames:
            raise InputError(f"{name or 'list of frames'}: no frames; give at least one")
        one = f"frame {frames[0].index}" if len(frames) == 1 else f"{len(frames)} frames"
        self.name = name or one
        self._frames = tuple(frames)
        self.times_s = np.array([frame.time_s for frame in frames])

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> Frame:
        check_index(index, self)
        return self._frames[index]

    def close(self) -> None:
        """Do nothing."""


# Gaps in a recording, and the positions of its frames on a time axis.


@dataclass(frozen=True)
class Gap:
    after_frame: int  # index of the last frame before the gap
    missing: int  # number of frames missing there
    duration_s: float  # time between the frames on either side, s


def find_gaps(
    times_s: np.ndarray,  # (F,), time of each frame, s, not falling
) -> tuple[Gap, ...]:
    """Gaps between consecutive frames.

    A step of about n + 1 periods misses n frames. A late frame is not missing: the neighbouring
    steps are shorter by its delay, so two on either side count, minus their whole periods.
    """
    steps = np.diff(times_s)
    median = usual_step(steps)
    if median is None:
        return ()
    # unlike the median, the mean of the single steps is not biased by lateness
    period = steps[(steps > 0) & (steps < 1.5 * median)].mean()
    excess = steps / period - 1.0
    fraction = excess - np.maximum(np.rint(excess), 0.0)
    beside = np.convolve(fraction, [1, 1, 0, 1, 1])[2 : 2 + len(steps)]
    missing = np.where(excess > 0.25, np.rint(excess + beside), 0).astype(np.int64)
    return tuple(Gap(int(k), int(missing[k]), float(steps[k])) for k in np.flatnonzero(missing > 0))


def usual_step(steps: np.ndarray) -> float | None:
    """Median of the positive time steps, s; None without one."""
    steps = steps[steps > 0]
    return float(np.median(steps)) if len(steps) else None


class TimeAxis:
    """Places of frames from 0 to 1, linear in their times.

    Where time does not increase, as in a restarted replay, a frame follows after a usual step.
    """

    def __init__(
        self,
        times_s: np.ndarray,  # (F,), time of each frame, s
    ) -> None:
        steps = np.diff(times_s)
        usual_s = usual_step(steps) or 1.0
        after_s = np.zeros(len(times_s))
        np.cumsum(np.where(steps > 0, steps, usual_s), out=after_s[1:])
        self.span_s = float(after_s.max(initial=0.0))  # time from the first frame to the last, s
        self.places = after_s / (self.span_s or 1.0)  # (F,), place of each frame
        self.step = usual_s / (self.span_s or 1.0)  # usual distance of one frame from the next
        self._between = 0.5 * (self.places[1:] + self.places[:-1])

    def __len__(self) -> int:
        return len(self.places)

    def nearest(self, places: np.ndarray | float) -> np.ndarray:
        """Frames nearest to places, of any shape."""
        return np.searchsorted(self._between, places)
