"""Plausibility of the time stamps of a live stream."""

from __future__ import annotations

from typing import Literal, NamedTuple

from bubbleviz.frames.time_series import REORDERED_NS

Verdict = Literal["ok", "jump", "duplicate", "out_of_order", "bad"]

FORWARD_NS = 10_000_000_000
"""A stamp may gain this on the time between two arrivals: a network that stood still and caught up.
Beyond it the clock was set, or the stamp is garbage."""
TRUSTED_AFTER = 3
"""Stamps in a row that must agree with each other to be believed against the ones before."""


class Judged(NamedTuple):
    """A verdict, and the time on the publisher's clock to use, ns."""

    verdict: Verdict
    time_ns: int


class _Seen(NamedTuple):
    stamp: int
    arrival: int
    times: int


class StampClock:
    """Follows the stamps of one topic and tells the few that are garbage from a clock that was set.

    A single stamp from 1970 or 2100 is `bad` and changes nothing. Three in a row that follow each
    other are the publisher's new clock.
    """

    def __init__(self) -> None:
        self._last: _Seen | None = None
        self._suspect: _Seen | None = None

    def judge(self, stamp_ns: int, arrival_ns: int) -> Judged:
        """Verdict on the next message; `bad` ones are timed by their arrival."""
        last = self._last
        if last is None:
            if stamp_ns <= 0:
                return Judged("bad", arrival_ns)
            return self._accept("ok", stamp_ns, arrival_ns)
        step = stamp_ns - last.stamp
        if step == 0:
            return Judged("duplicate", stamp_ns)
        if -REORDERED_NS < step < 0:
            return Judged("out_of_order", stamp_ns)
        elapsed = max(arrival_ns - last.arrival, 0)
        if stamp_ns > 0 and 0 < step <= elapsed + FORWARD_NS:
            return self._accept("ok", stamp_ns, arrival_ns)
        if stamp_ns > 0 and self._trusted(stamp_ns, arrival_ns):
            return self._accept("jump", stamp_ns, arrival_ns)
        return Judged("bad", last.stamp + elapsed)

    def _accept(self, verdict: Verdict, stamp: int, arrival: int) -> Judged:
        self._last, self._suspect = _Seen(stamp, arrival, 0), None
        return Judged(verdict, stamp)

    def _trusted(self, stamp: int, arrival: int) -> bool:
        before, count = self._suspect, 1
        if before is not None:
            elapsed = max(arrival - before.arrival, 0)
            if 0 < stamp - before.stamp <= elapsed + FORWARD_NS:
                count = before.times + 1
        self._suspect = _Seen(stamp, arrival, count)
        return count >= TRUSTED_AFTER
