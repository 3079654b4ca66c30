"""Zeros of gas pressure and wrench sensor, from frames of a recording without contact.

That of the gas pressure removes changes of ambient pressure and the sensor's offset.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from bubbleviz.errors import InputError
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import Frame, FrameSource, force_of
from bubbleviz.result import HALF_95
from bubbleviz.sensor import WEATHER_SIGMA_PA

ZERO_FRAMES = 15  # contact-free frames for a zero, which is their median: half a second at 30 Hz
MIN_FRAMES = 3
"""Fewest consecutive contact-free frames for the zero of a recording: a single one may be a failed
image."""
WRENCH_FRAMES = 100  # contact-free frames for the bias of a wrench sensor, which is their median
_SEARCH_POINTS = 20  # positions in a recording where contact-free frames are searched
SKIPPED = 6  # live frames after one with contact that are not tested


class PressureZero:
    """Shifts the measured gas pressure so that it equals the sensor file's without contact.

    The sensor file has gauge and atmospheric pressure of the day it was made. The weather of
    another day (±2 kPa) and the offset of a pressure sensor would look like contact, so they are
    subtracted. Until they are known, frames have the weather's standard deviation in
    `gas_sigma_pa`.
    """

    def __init__(
        self,
        reference_pa: float,  # absolute pressure of the inflated, untouched bubble in the file, Pa
    ) -> None:
        self.reference_pa = reference_pa
        self.offset_pa: float | None = None  # of the measured pressure; None: unknown
        self.frames = 0  # contact-free frames used for the offset
        self._free: list[float] = []
        self._collecting = True
        self._to_skip = 0

    @property
    def waiting(self) -> bool:
        """Whether contact-free frames are still being collected."""
        return self._collecting

    def refer_to(self, reference_pa: float) -> None:
        """Use the gas pressure of another sensor file, Pa.

        The pressure measured at rest is kept, so the offset changes with the reference. A new zero
        is collected, as frames without contact by one sensor file may have contact by the other.
        """
        if reference_pa == self.reference_pa:
            return
        if self.offset_pa is not None:
            self.offset_pa += self.reference_pa - reference_pa
        self.reference_pa = reference_pa
        self.zero_now()

    def zero_now(self) -> None:
        """Collect a new zero from the next contact-free frames; keep the offset until then."""
        self._free, self._collecting = [], True

    @property
    def rest_pa(self) -> float | None:
        """Pressure measured without contact, Pa; None if unknown."""
        return None if self.offset_pa is None else self.offset_pa + self.reference_pa

    def restore(self, rest_pa: float | None, *, waiting: bool) -> None:
        """Restore an earlier state of `rest_pa` and `waiting`."""
        self.offset_pa = None if rest_pa is None else rest_pa - self.reference_pa
        self._free, self._collecting = [], waiting

    def learn(
        self,
        raw_pressure_pa: float | None,
        *,
        contact_free: bool,  # by the depth image alone
    ) -> None:
        """Add the measured pressure of a frame, Pa, before correction."""
        if not self._collecting or raw_pressure_pa is None:
            return
        if not contact_free:
            self._free.clear()  # a zero comes from consecutive frames
            self._to_skip = SKIPPED
            return
        self._free.append(raw_pressure_pa)
        if len(self._free) >= ZERO_FRAMES:
            self.take(self._free)

    def take(self, pressures_pa: Sequence[float]) -> None:
        """Compute the zero from the measured pressures of contact-free frames, Pa."""
        self.offset_pa = float(np.median(pressures_pa)) - self.reference_pa
        self.frames = len(pressures_pa)
        self._free, self._collecting = [], False

    @property
    def words(self) -> str:
        """Description in one line."""
        if self.offset_pa is None:
            weather = 1e-3 * HALF_95 * WEATHER_SIGMA_PA
            return (
                f"gas pressure zero: unknown without {MIN_FRAMES} contact-free frames in a row, "
                f"so within ±{weather:.0f} kPa by the weather (95 %)"
            )
        return f"gas pressure zero: {self.offset_pa:+.0f} Pa from {self.frames} contact-free frames"

    def wants_next(self) -> bool:
        """Whether to test the next frame for contact; during contact only every sixth is."""
        self._to_skip = max(self._to_skip - 1, 0)
        return self._collecting and self._to_skip == 0

    def applied(self, frame: Frame) -> Frame:
        """The frame with corrected gas pressure, or with its standard deviation."""
        if frame.gas_pressure_pa is None:
            return frame
        if self.offset_pa is None:
            return replace(frame, gas_sigma_pa=WEATHER_SIGMA_PA)
        return replace(frame, gas_pressure_pa=frame.gas_pressure_pa - self.offset_pa)


def zeroed(frame: Frame, zero: PressureZero, pipeline: Pipeline) -> Frame:
    """The frame with corrected gas pressure, after use for the zero if that is being collected."""
    if frame.gas_pressure_pa is not None and zero.wants_next():
        zero.learn(frame.gas_pressure_pa, contact_free=pipeline.is_untouched(frame))
    return zero.applied(frame)


def zero_of(source: FrameSource, pipeline: Pipeline) -> PressureZero | None:
    """Zero from contact-free frames of a recording; None if it has no gas pressure.

    They are searched at the start, then at positions spread over the recording. The zero is unknown
    if there are none.
    """
    if source[0].gas_pressure_pa is None:
        return None
    zero = PressureZero(pipeline.model.gas.P0)
    longest: list[float] = []
    starts = np.unique(np.linspace(0, len(source) - MIN_FRAMES, _SEARCH_POINTS).astype(int))
    for start in starts[starts >= 0]:
        longest = max(longest, _rest_from(source, int(start), pipeline), key=len)
        if len(longest) == ZERO_FRAMES:
            break
    if len(longest) >= MIN_FRAMES:
        zero.take(longest)
    return zero


def _rest_from(source: FrameSource, start: int, pipeline: Pipeline) -> list[float]:
    """Gas pressures of consecutive contact-free frames from `start` on."""
    rest: list[float] = []
    for index in range(start, min(start + ZERO_FRAMES, len(source))):
        frame = source[index]
        if frame.gas_pressure_pa is None or not pipeline.is_untouched(frame):
            break
        rest.append(frame.gas_pressure_pa)
    return rest


def wrench_bias(source: FrameSource, pipeline: Pipeline) -> Iterator[np.ndarray | None]:
    """Bias of the wrench sensor: median force (3,) of the first contact-free frames, N.

    Yields None after each examined frame, then the bias; NaN if no frames are contact-free.
    """
    rest: list[np.ndarray] = []
    for index in range(len(source)):
        free = _contact_free(source, index, pipeline)
        if free is not None:
            rest.append(force_of(free.wrench))
        elif len(rest) < MIN_FRAMES:
            rest.clear()
        if len(rest) == WRENCH_FRAMES or (rest and free is None):
            break
        yield None
    known = [force for force in rest if np.isfinite(force).all()]
    yield np.median(known, axis=0) if known else np.full(3, np.nan)


def _contact_free(source: FrameSource, index: int, pipeline: Pipeline) -> Frame | None:
    """A frame if it can be read and its depth image shows no contact."""
    try:
        frame = source[index]
        return frame if pipeline.is_untouched(frame) else None
    except InputError:
        return None
