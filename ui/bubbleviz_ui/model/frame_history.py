"""What was computed so far, a few numbers a frame: 36,000 frames are 4 MB. No Qt in here."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bubbleviz.diagnostics import Numbers
from bubbleviz.pipeline import Product
from bubbleviz.recordings import Gap, measured_force
from bubbleviz.result import TRUSTED

SHEAR = ("shear_normal_n", "shear_tangential_n", "shear_tangential_half_n", "slip_share")
QUANTITIES = (
    "force_n",
    "force_half_width_n",
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
    *SHEAR,
)
"""Names of the arrays, with their units."""

MEASURED_FORCE = "measured_force_n"
OF_PATCH = ("area_m2", "center_x_m", "center_y_m", "center_z_m")
UNKNOWN, FREE, CONTACT, UNTRUSTED = -1, 0, 1, 2
"""What is known about contact in a frame; `UNTRUSTED`: the estimate is not to be trusted."""
_FRAME, _ESTIMATE, _PATCH, _SHEAR = 1, 2, 4, 8


class History:
    """Numbers of the frames that were computed."""

    def __init__(self, frames: int) -> None:
        # (F,) array of each of `QUANTITIES`; NaN where nothing is known
        self.values = {name: np.full(frames, np.nan) for name in QUANTITIES}
        # (F,) int8 array: `UNKNOWN`, `FREE`, `CONTACT` or `UNTRUSTED`
        self.contact = np.full(frames, UNKNOWN, np.int8)
        self._has = np.zeros(frames, np.uint8)
        self._wrench = np.full((frames, 3), np.nan)
        self._untouched = np.zeros(frames, bool)
        self._forgotten = np.zeros(frames, bool)

    def __len__(self) -> int:
        return len(self.contact)

    def grow(self, frames: int) -> None:
        """Make room for the frames of a live source, of which nothing is known yet."""
        for name, values in self.values.items():
            self.values[name] = grown(values, frames, np.nan)
        self.contact = grown(self.contact, frames, UNKNOWN)
        self._has = grown(self._has, frames, 0)
        self._wrench = grown(self._wrench, frames, np.nan)
        self._untouched = grown(self._untouched, frames, False)
        self._forgotten = grown(self._forgotten, frames, False)

    def take(self, frame: int, known: Numbers, *, patch: bool) -> None:
        """Keep the numbers of a frame; those of its patch only where `patch` says so."""
        self._put(frame, known, ("gas_measured_pa", "total_ms", "latency_ms"))
        self._has[frame] |= _FRAME
        self._wrench[frame] = known.wrench_n
        if known.status:
            self._put(frame, known, ("gas_law_pa", "residual_m", "solve_ms"))
            self._has[frame] |= _ESTIMATE
            self._untouched[frame] = known.status == "no_contact"
        if known.has_shear:
            self._put(frame, known, SHEAR)
            self._has[frame] |= _SHEAR
        if known.has_patch and patch:
            self._put(frame, known, ("force_n", "force_half_width_n", "area_m2"))
            for name, value in zip(OF_PATCH[1:], known.center_m, strict=True):
                self.values[name][frame] = value
            self._has[frame] |= _PATCH
            self.contact[frame] = _contact(known)

    def forget_patches(self) -> None:
        """Forget what another threshold makes different."""
        for name in OF_PATCH:
            self.values[name][:] = np.nan
        self.contact[:] = UNKNOWN
        self._forgotten |= (self._has & _PATCH) > 0
        self._has &= np.uint8(_FRAME | _ESTIMATE | _SHEAR)

    @property
    def forgotten(self) -> np.ndarray:
        """Frames whose patches were forgotten and are not known again, (k,) int."""
        return np.flatnonzero(self._forgotten & ((self._has & _PATCH) == 0))

    def of(self, name: str) -> np.ndarray:
        """Array (F,) of a quantity: one of `QUANTITIES`, or `measured_force_n`.

        The bias of the measured forces is that of the frames known to be contact-free by now.
        """
        if name == MEASURED_FORCE:
            return measured_force(self._wrench, self._untouched)
        return self.values[name]

    def next_contact(self, frame: int, direction: int) -> int | None:
        """Frame in which the next contact begins, or the last before (`direction` −1).

        As far as frames were computed; None where there is none.
        """
        touching = self.contact == CONTACT
        begins = np.flatnonzero(touching & ~np.concatenate([[False], touching[:-1]]))
        found = begins[begins > frame][:1] if direction > 0 else begins[begins < frame][-1:]
        return int(found[0]) if found.size else None

    def largest_force(self) -> int | None:
        """Frame of the largest force of those computed; None where there is no contact."""
        force = np.where(self.contact == CONTACT, self.values["force_n"], np.nan)
        return None if np.isnan(force).all() else int(np.nanargmax(force))

    def missing(self, products: frozenset[Product]) -> np.ndarray:
        """Frames of which not all was computed that these products would tell, (k,) int."""
        wanted = _FRAME
        if "estimate" in products:
            wanted |= _ESTIMATE
        if "patch" in products:
            wanted |= _PATCH
        if products & {"traction", "slip"}:
            wanted |= _SHEAR
        return np.flatnonzero((self._has & wanted) != wanted)

    def _put(self, frame: int, known: Numbers, names: tuple[str, ...]) -> None:
        for name in names:
            value = getattr(known, name)
            if name != "latency_ms" or not np.isnan(value):
                self.values[name][frame] = value


def _contact(known: Numbers) -> int:
    if known.status not in TRUSTED:
        return UNTRUSTED
    return CONTACT if known.area_m2 > 0.0 else FREE


def grown(values: np.ndarray, count: int, fill: float) -> np.ndarray:
    """An array with its first values, `count` long; within its spare room nothing is copied."""
    room = values.base if isinstance(values.base, np.ndarray) else values
    if len(room) < count:
        room = np.full((2 * count, *values.shape[1:]), fill, values.dtype)
        room[: len(values)] = values
    return room[:count]


def thinned(
    times_s: np.ndarray,
    values: np.ndarray,
    window_s: tuple[float, float],
    gaps: Sequence[Gap] = (),
    most: int = 1500,
) -> tuple[np.ndarray, np.ndarray]:
    """Points of a curve inside a window of time, with nothing lost that one would see.

    Beyond `most` frames their lowest and highest known values stand for each few of them. A NaN in
    each of the gaps breaks the curve there.
    """
    first = max(int(np.searchsorted(times_s, window_s[0])) - 1, 0)
    last = min(int(np.searchsorted(times_s, window_s[1], "right")) + 1, len(times_s))
    times_s, values = times_s[first:last], values[first:last]
    after = np.array([gap.after_frame + 1 - first for gap in gaps], np.int64)
    after = after[(after > 0) & (after < len(values))]
    if len(values) > 2 * most:
        even = np.linspace(0, len(values), most, endpoint=False).astype(np.int64)
        starts = np.union1d(even, after)
        ends = (np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts))
        times_s, values = np.repeat(times_s[starts], 2), np.column_stack(ends).ravel()
        after = 2 * np.searchsorted(starts, after)
    return np.insert(times_s, after, times_s[after]), np.insert(values, after, np.nan)
