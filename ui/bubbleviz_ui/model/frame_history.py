"""Numbers of all frames computed so far, about 100 bytes a frame. No Qt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bubbleviz.diagnostics import Numbers
from bubbleviz.pipeline import Product
from bubbleviz.recordings import Gap, measured_force
from bubbleviz.result import TRUSTED
from bubbleviz.zeros import WRENCH_FRAMES

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
PATCH_QUANTITIES = ("area_m2", "center_x_m", "center_y_m", "center_z_m")
UNKNOWN, FREE, CONTACT, UNTRUSTED = -1, 0, 1, 2
"""Contact state of a frame; `UNTRUSTED`: the estimate failed or is implausible."""
_FRAME, _ESTIMATE, _PATCH, _SHEAR = 1, 2, 4, 8  # bits of `has`
_BLANK = np.array(
    (*(np.nan for _ in QUANTITIES), np.nan, UNKNOWN, 0, False, False),
    [*((name, float) for name in QUANTITIES), ("wrench_n", float, 3), ("contact", np.int8),
     ("has", np.uint8), ("untouched", bool), ("outdated", bool)],
)  # fmt: skip
"""What is known of a frame that was not computed."""


OUTLIERS, OUTLIER_RATIO = 2, 1.5
"""So many frames whose largest pressure exceeds that of all others by this ratio are outliers."""
_ENOUGH = 2 * OUTLIERS + 1
"""Fewest frames in contact for outliers to be left out. The first frames of a press differ as much:
taken for outliers, they would make the scale shrink while the press grows."""


class Extremes:
    """Largest values of all frames computed so far, for scales."""

    def __init__(self) -> None:
        self.residual_m = self.force_n = 0.0
        self._peaks_pa: dict[int, float] = {}  # The highest, by frame

    @property
    def usual_peak_pa(self) -> float:
        """Largest contact pressure of all frames except outliers; 0 without contact."""
        peaks = sorted(self._peaks_pa.values(), reverse=True)
        if len(peaks) < _ENOUGH:
            return peaks[0] if peaks else 0.0
        return max(peak for peak in peaks if peak <= OUTLIER_RATIO * peaks[OUTLIERS])

    def include(self, frame: int, known: Numbers) -> None:
        self.residual_m = float(np.fmax(self.residual_m, known.residual_m))
        self.force_n = float(np.fmax(self.force_n, known.force_n))
        if known.peak_pa > 0.0:
            # never smaller: the scale of a loop stands still when a frame is solved anew
            self._peaks_pa[frame] = max(known.peak_pa, self._peaks_pa.get(frame, 0.0))
            highest = sorted(self._peaks_pa, key=self._peaks_pa.__getitem__)[-_ENOUGH:]
            self._peaks_pa = {frame: self._peaks_pa[frame] for frame in highest}


@dataclass(frozen=True)
class ContactPeriod:
    """Frames in contact between two without; others in between are unknown or not trusted."""

    first: int
    last: int
    largest: int  # Frame of the largest force
    force_n: float  # In that frame


class FrameHistory:
    """Numbers of the frames computed so far."""

    def __init__(self, frames: int) -> None:
        self.values = np.full(frames, _BLANK)  # NaN where not computed
        # (3,) force of the wrench sensor without contact; None: from the first contact-free frames
        self.wrench_bias_n: np.ndarray | None = None
        self.extremes = Extremes()

    def __len__(self) -> int:
        return len(self.values)

    @property
    def contact(self) -> np.ndarray:
        """(F,) int8 array: `UNKNOWN`, `FREE`, `CONTACT` or `UNTRUSTED`."""
        return self.values["contact"]

    def grow(self, frames: int) -> None:
        """Extend the arrays for new frames of a live source."""
        self.values = grown(self.values, frames, _BLANK)

    def record(self, frame: int, known: Numbers, *, patch: bool) -> None:
        """Record the numbers of a frame; those of its patch only if `patch`."""
        self.extremes.include(frame, known)
        self._put(frame, known, ("gas_measured_pa", "total_ms", "latency_ms"))
        self.values["has"][frame] |= _FRAME
        self.values["wrench_n"][frame] = known.wrench_n
        if known.status:
            self._put(frame, known, ("gas_law_pa", "residual_m", "solve_ms"))
            self.values["has"][frame] |= _ESTIMATE
            self.values["untouched"][frame] = known.status == "no_contact"
        if known.has_shear:
            self._put(frame, known, SHEAR)
            self.values["has"][frame] |= _SHEAR
        if known.has_patch and patch:
            self._put(frame, known, ("force_n", "force_half_width_n", "area_m2"))
            for name, value in zip(PATCH_QUANTITIES[1:], known.center_m, strict=True):
                self.values[name][frame] = value
            self.values["has"][frame] |= _PATCH
            free = FREE if known.area_m2 <= 0.0 else CONTACT
            self.contact[frame] = free if known.status in TRUSTED else UNTRUSTED

    def forget(self) -> None:
        """Drop the numbers of all frames, as forces are estimated otherwise; scales stay."""
        self.values[:] = _BLANK

    def forget_patches(self) -> None:
        """Drop the patch numbers after a change of the threshold."""
        for name in PATCH_QUANTITIES:
            self.values[name][:] = np.nan
        self.contact[:] = UNKNOWN
        self.values["outdated"] |= (self.values["has"] & _PATCH) > 0
        self.values["has"] &= np.uint8(_FRAME | _ESTIMATE | _SHEAR)

    @property
    def outdated(self) -> np.ndarray:
        """Frames whose dropped patch numbers have not been computed again, (k,) int."""
        return np.flatnonzero(self.values["outdated"] & ((self.values["has"] & _PATCH) == 0))

    def quantity(self, name: str) -> np.ndarray:
        """Array (F,) of a quantity: one of `QUANTITIES`, or `measured_force_n`."""
        if name != MEASURED_FORCE:
            return self.values[name]
        free = np.zeros(len(self), bool)
        free[np.flatnonzero(self.values["untouched"])[:WRENCH_FRAMES]] = True
        return measured_force(self.values["wrench_n"], free, self.wrench_bias_n)

    def next_start(self, kind: int, frame: int, direction: int) -> int | None:
        """First of the next frames in a contact state, or of the previous ones (`direction` −1).

        Only computed frames count, as in `contacts`; None if there is none.
        """
        known = np.flatnonzero(self.contact != UNKNOWN)
        wanted = self.contact[known] == kind
        begins = known[wanted & ~np.concatenate([[False], wanted[:-1]])]
        found = begins[begins > frame][:1] if direction > 0 else begins[begins < frame][-1:]
        return int(found[0]) if found.size else None

    def contacts(self) -> tuple[ContactPeriod, ...]:
        """Contacts in the computed frames, in order."""
        known = np.flatnonzero((self.contact == CONTACT) | (self.contact == FREE))
        touched = np.concatenate([[False], self.contact[known] == CONTACT, [False]])
        force, found = self.values["force_n"], list[ContactPeriod]()
        for begin, end in np.flatnonzero(touched[1:] != touched[:-1]).reshape(-1, 2):
            frames = known[begin:end]
            first, last, largest = frames[0], frames[-1], frames[np.argmax(force[frames])]
            found.append(ContactPeriod(int(first), int(last), int(largest), float(force[largest])))
        return tuple(found)

    def largest_force(self) -> int | None:
        """Computed frame with the largest force; None if there is no contact."""
        force = np.where(self.contact == CONTACT, self.values["force_n"], np.nan)
        return None if np.isnan(force).all() else int(np.nanargmax(force))

    def missing(self, products: frozenset[Product]) -> np.ndarray:
        """Frames for which some of these products were not computed, (k,) int."""
        wanted = _FRAME
        if "estimate" in products:
            wanted |= _ESTIMATE
        if "patch" in products:
            wanted |= _PATCH
        if products & {"traction", "slip"}:
            wanted |= _SHEAR
        return np.flatnonzero((self.values["has"] & wanted) != wanted)

    def _put(self, frame: int, known: Numbers, names: tuple[str, ...]) -> None:
        for name in names:
            value = getattr(known, name)
            if name != "latency_ms" or not np.isnan(value):
                self.values[name][frame] = value


def grown(values: np.ndarray, count: int, fill: float | np.ndarray) -> np.ndarray:
    """The array extended to `count` values; copied only when its spare capacity is used up."""
    room = values.base if isinstance(values.base, np.ndarray) else values
    if len(room) < count:
        room = np.full((2 * count, *values.shape[1:]), fill, values.dtype)
        room[: len(values)] = values
    return room[:count]


def decimated(
    times_s: np.ndarray,
    values: np.ndarray,
    window_s: tuple[float, float],
    gaps: Sequence[Gap] = (),
    most: int = 1500,
) -> tuple[np.ndarray, np.ndarray]:
    """Points of a curve inside a time window, decimated without visible loss.

    Beyond `most` frames each bin is reduced to its lowest and highest value. A NaN at each gap
    breaks the curve.
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
