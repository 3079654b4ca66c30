"""Zeroing the gas pressure: removes ambient drift and sensor offset."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import Frame, FrameSource
from bubbleviz.result import HALF_95
from bubbleviz.sensor import WEATHER_SIGMA_PA

ENOUGH = 15  # contact-free frames whose median is a zero: half a second at 30 Hz
FEWEST = 3
"""Contact-free frames in a row that a recording's zero is taken from where it has no more: one by
itself may be a failed image."""
PLACES = 20  # where a recording is looked at for a rest
PASSED = 6  # live frames after one with contact that are not asked about


class PressureZero:
    """Shifts the measured gas pressure so that its contact-free level is the sensor file's.

    The sensor file has the gauge pressure and the atmospheric pressure of the day it was made.
    Another day's weather (±2 kPa) and the offset of a pressure sensor would be read as contact.
    What is constant without contact says nothing, hence it is taken away. Until it is known, frames
    have the weather's standard deviation in `gas_sigma_pa`.

    """

    def __init__(
        self,
        reference_pa: float,  # absolute pressure of the inflated, untouched bubble in the file, Pa
    ) -> None:
        self.reference_pa = reference_pa
        # taken from every measured pressure, Pa; None until it is known, and nothing is shifted
        self.offset_pa: float | None = None
        self.frames = 0  # contact-free ones that it was taken from
        self._free: list[float] = []
        self._asked = True
        self._passing = 0

    @property
    def waiting(self) -> bool:
        """Whether contact-free frames are still being collected."""
        return self._asked

    def refer_to(self, reference_pa: float) -> None:
        """Take the gas pressure of another sensor file, Pa.

        What was measured at rest stays, so the offset moves with the reference at once. It is asked
        for anew, as the other file may see contact where this one saw none.
        """
        if reference_pa == self.reference_pa:
            return
        if self.offset_pa is not None:
            self.offset_pa += self.reference_pa - reference_pa
        self.reference_pa = reference_pa
        self.zero_now()

    def zero_now(self) -> None:
        """Begin anew with the contact-free frames that come; the present offset stays till then."""
        self._free, self._asked = [], True

    @property
    def rest_pa(self) -> float | None:
        """Measured without contact, Pa; None until it is known."""
        return None if self.offset_pa is None else self.offset_pa + self.reference_pa

    def restore(self, rest_pa: float | None, *, waiting: bool) -> None:
        """Return to an earlier `rest_pa`, and to having waited for another or not."""
        self.offset_pa = None if rest_pa is None else rest_pa - self.reference_pa
        self._free, self._asked = [], waiting

    def learn(
        self,
        raw_pressure_pa: float | None,
        *,
        contact_free: bool,  # whether its depth image alone says that nothing touches
    ) -> None:
        """Take note of a frame's measured pressure, Pa, as it was before `applied`."""
        if not self._asked or raw_pressure_pa is None:
            return
        if not contact_free:
            self._free.clear()  # a zero is learned in one rest, not from scraps of many
            self._passing = PASSED
            return
        self._free.append(raw_pressure_pa)
        if len(self._free) >= ENOUGH:
            self.take(self._free)

    def take(self, pressures_pa: Sequence[float]) -> None:
        """Take the zero from the measured pressures of contact-free frames, Pa."""
        self.offset_pa = float(np.median(pressures_pa)) - self.reference_pa
        self.frames = len(pressures_pa)
        self._free, self._asked = [], False

    @property
    def words(self) -> str:
        """What was done, in one line."""
        if self.offset_pa is None:
            weather = 1e-3 * HALF_95 * WEATHER_SIGMA_PA
            return (
                "gas pressure zero: unknown without contact-free frames, within the weather's"
                f" ±{weather:.0f} kPa (95 %)"
            )
        return f"gas pressure zero: {self.offset_pa:+.0f} Pa from {self.frames} contact-free frames"

    def wants_next(self) -> bool:
        """Whether the next frame should be tested for contact; in one only every few are."""
        self._passing = max(self._passing - 1, 0)
        return self._asked and self._passing == 0

    def applied(self, frame: Frame) -> Frame:
        """The frame with its gas pressure shifted, or with how far it may be off."""
        if frame.gas_pressure_pa is None:
            return frame
        if self.offset_pa is None:
            return replace(frame, gas_sigma_pa=WEATHER_SIGMA_PA)
        return replace(frame, gas_pressure_pa=frame.gas_pressure_pa - self.offset_pa)


def zeroed(frame: Frame, zero: PressureZero, pipeline: Pipeline) -> Frame:
    """The frame with its gas pressure shifted; learned from where the zero is still waited for."""
    if frame.gas_pressure_pa is not None and zero.wants_next():
        zero.learn(frame.gas_pressure_pa, contact_free=pipeline.is_untouched(frame))
    return zero.applied(frame)


def zero_of(source: FrameSource, pipeline: Pipeline) -> PressureZero | None:
    """Zero of a recording, from a rest of it; None where it has no gas pressure.

    The start is looked at first, then places spread over it: solving contact takes time. Without a
    rest the zero stays unknown.
    """
    if source[0].gas_pressure_pa is None:
        return None
    zero = PressureZero(pipeline.model.gas.P0)
    longest: list[float] = []
    places = np.unique(np.linspace(0, len(source) - FEWEST, PLACES).astype(int))
    for place in places[places >= 0]:
        longest = max(longest, _rest_from(source, int(place), pipeline), key=len)
        if len(longest) == ENOUGH:
            break
    if len(longest) >= FEWEST:
        zero.take(longest)
    return zero


def _rest_from(source: FrameSource, start: int, pipeline: Pipeline) -> list[float]:
    """Gas pressures of the contact-free frames in a row from one on."""
    rest: list[float] = []
    for index in range(start, min(start + ENOUGH, len(source))):
        frame = source[index]
        if frame.gas_pressure_pa is None or not pipeline.is_untouched(frame):
            break
        rest.append(frame.gas_pressure_pa)
    return rest
