"""What was computed so far, a few numbers a frame: 36,000 frames are 4 MB. No Qt in here."""

from __future__ import annotations

import numpy as np

from bubbleviz.diagnostics.frame_numbers import Numbers
from bubbleviz.pipeline import Product

QUANTITIES = (
    "force_n",
    "gas_law_pa",
    "gas_measured_pa",
    "area_m2",
    "center_x_m",
    "center_y_m",
    "center_z_m",
    "residual_m",
    "solve_ms",
    "total_ms",
    "latency_ms",
)
"""Names of the arrays, with their units."""

OF_PATCH = ("area_m2", "center_x_m", "center_y_m", "center_z_m")
UNKNOWN, FREE, CONTACT = -1, 0, 1
"""What is known about contact in a frame."""
_FRAME, _ESTIMATE, _PATCH = 1, 2, 4


class History:
    """Numbers of the frames that were computed.

    Parameters
    ----------
    frames : int
        F.

    Attributes
    ----------
    values : dict
        (F,) array of each of `QUANTITIES`; NaN where nothing is known.
    contact : (F,) int8 array
        `UNKNOWN`, `FREE` or `CONTACT`.
    """

    def __init__(self, frames: int) -> None:
        self.values = {name: np.full(frames, np.nan) for name in QUANTITIES}
        self.contact = np.full(frames, UNKNOWN, np.int8)
        self._has = np.zeros(frames, np.uint8)

    def __len__(self) -> int:
        return len(self.contact)

    def grow(self, frames: int) -> None:
        """Make room for the frames of a live source, of which nothing is known yet."""
        for name, values in self.values.items():
            self.values[name] = grown(values, frames, np.nan)
        self.contact = grown(self.contact, frames, UNKNOWN)
        self._has = grown(self._has, frames, 0)

    def take(self, frame: int, known: Numbers, *, patch: bool) -> None:
        """Keep the numbers of a frame; those of its patch only where `patch` says so."""
        self._put(frame, known, ("gas_measured_pa", "total_ms", "latency_ms"))
        self._has[frame] |= _FRAME
        if known.status:
            self._put(frame, known, ("gas_law_pa", "residual_m", "solve_ms"))
            self._has[frame] |= _ESTIMATE
        if known.has_patch and patch:
            self._put(frame, known, ("force_n", "area_m2"))
            for name, value in zip(OF_PATCH[1:], known.center_m, strict=True):
                self.values[name][frame] = value
            self._has[frame] |= _PATCH
            self.contact[frame] = _contact(known)

    def forget_patches(self) -> None:
        """Forget what another threshold makes different."""
        for name in OF_PATCH:
            self.values[name][:] = np.nan
        self.contact[:] = UNKNOWN
        self._has &= np.uint8(_FRAME | _ESTIMATE)

    def missing(self, products: frozenset[Product]) -> np.ndarray:
        """Frames of which not all was computed that these products would tell, (k,) int."""
        wanted = _FRAME
        if "estimate" in products:
            wanted |= _ESTIMATE
        if "patch" in products:
            wanted |= _PATCH
        return np.flatnonzero((self._has & wanted) != wanted)

    def _put(self, frame: int, known: Numbers, names: tuple[str, ...]) -> None:
        for name in names:
            value = getattr(known, name)
            if name != "latency_ms" or not np.isnan(value):
                self.values[name][frame] = value


def _contact(known: Numbers) -> int:
    if known.status not in ("ok", "no_contact"):
        return UNKNOWN
    return CONTACT if known.area_m2 > 0.0 else FREE


def grown(values: np.ndarray, count: int, fill: float) -> np.ndarray:
    """An array with its first values, `count` long; within its spare room nothing is copied."""
    room = values.base if isinstance(values.base, np.ndarray) else values
    if len(room) < count:
        room = np.full(2 * count, fill, values.dtype)
        room[: len(values)] = values
    return room[:count]


def thinned(
    times_s: np.ndarray, values: np.ndarray, window_s: tuple[float, float], most: int = 1500
) -> tuple[np.ndarray, np.ndarray]:
    """Points of a curve inside a window of time, with nothing lost that one would see.

    Beyond `most` frames their lowest and highest known values stand for each few of them.
    """
    first = max(int(np.searchsorted(times_s, window_s[0])) - 1, 0)
    last = min(int(np.searchsorted(times_s, window_s[1], "right")) + 1, len(times_s))
    times_s, values = times_s[first:last], values[first:last]
    if len(values) <= 2 * most:
        return times_s, values
    starts = np.linspace(0, len(values), most, endpoint=False).astype(np.int64)
    ends = (np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts))
    return np.repeat(times_s[starts], 2), np.column_stack(ends).ravel()
