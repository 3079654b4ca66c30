"""Data of a frame by time: measured values are interpolated, the nearest image is taken.

The rules are the same in a recording and live. A live `GrowingSeries` is filled as messages arrive;
a `recorded_series` reads on demand. Invalid stamps are distinguished from a clock that was set by
comparison with the previous stamps (live: `StampClock`) or with all (recorded: `begins_again`,
`plausible_times`).
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, Generic, Literal, NamedTuple, Protocol, TypeVar

import numpy as np

from bubbleviz.recordings.bag import UNREADABLE, Messages
from bubbleviz.recordings.depth_topics import PRESSURE, WRENCH
from bubbleviz.recordings.message_decoding import pressure_of, wrench_of

NEAREST_NS = 100_000_000
"""Before the first and after the last value the nearest one is used, up to this distance."""
SILENT_NS = 10 * NEAREST_NS
"""Frames do not wait for a topic without messages for this time."""
REORDERED_NS = 1_000_000_000
"""A network reorders messages by at most a second; a larger step back means that the clock was set
or a replay restarted."""
FORWARD_NS = 10_000_000_000
"""Stamps may advance by this much more than arrivals, after a network delay. Beyond it the clock
was set, or the stamp is invalid."""
TRUSTED_AFTER = 3
"""Consistent stamps in a row after which the publisher's clock was set."""
GARBAGE_NS = 3_600_000_000_000
"""A recorded stamp more than one hour off the others is from an unset clock."""
_VALUES_KEPT = 10_000

T = TypeVar("T")
U = TypeVar("U")


class Moment(NamedTuple):
    """A moment by stamps and by arrivals (in a recording: log times), ns."""

    stamp_ns: int
    arrival_ns: int

    def later(self, by_ns: int) -> Moment:
        """The moment some time after this."""
        return Moment(self.stamp_ns + by_ns, self.arrival_ns + by_ns)


class Times(Protocol):
    """Times in ns by position."""

    def __len__(self) -> int: ...
    def __getitem__(self, k: int, /) -> int: ...


class Series(Generic[T]):
    """Messages of a topic by time."""

    def __init__(
        self,
        times_ns: Times,  # increasing; elsewhere the neighbours that bisection finds are used
        # content of message k; of values an array, ValueError if they are not finite
        item: Callable[[int], T],
        *,
        by_arrival: bool = False,  # whether the times are arrivals, as of a topic without stamps
    ) -> None:
        self.item, self.by_arrival, self._times = item, by_arrival, times_ns

    def __len__(self) -> int:
        return len(self._times)

    def nearest(self, moment: Moment, within_ns: int) -> tuple[int, int] | None:
        """Message nearest to a moment, and its delay, ns; None if all are further off."""
        k, t = self._place(moment)
        offs = {j: int(self._times[j]) - t for j in (k - 1, k) if 0 <= j < len(self)}
        found = min(offs, key=lambda j: abs(offs[j]), default=None)
        return None if found is None or abs(offs[found]) > within_ns else (found, offs[found])

    def at(self: Series[np.ndarray], moment: Moment) -> np.ndarray | None:
        """Values at a moment, interpolated linearly.

        Outside the messages the nearest within 0.1 s, else None.
        """
        k, t = self._place(moment)
        if not 0 < k < len(self):
            found = self.nearest(moment, NEAREST_NS)
            return None if found is None else _finite(self.item(found[0]))
        ta, tb = int(self._times[k - 1]), int(self._times[k])
        if not ta < t < tb:  # equal to one of them, or times not increasing
            return _finite(self.item(k - 1 if abs(t - ta) <= abs(t - tb) else k))
        weight = (t - ta) / (tb - ta)
        return _finite((1.0 - weight) * self.item(k - 1) + weight * self.item(k))

    def _time_of(self, moment: Moment) -> int:
        return moment.arrival_ns if self.by_arrival else moment.stamp_ns

    def _place(self, moment: Moment) -> tuple[int, int]:
        """First message at or after a moment, and the moment on the clock of this topic."""
        t = self._time_of(moment)
        return bisect_left(self._times, t), t


def _finite(values: np.ndarray) -> np.ndarray | None:
    """Values; None if any is NaN, as of an unreadable message."""
    return values if np.isfinite(values).all() else None


VALUES: dict[str, Callable[[Any], np.ndarray]] = {PRESSURE: pressure_of, WRENCH: wrench_of}
"""Values measured along with the images, by message type."""


def values_at(series: Mapping[str, Series[np.ndarray]], moment: Moment) -> dict[str, Any]:
    """Gas pressure and wrench of a frame, as `Frame` has them, from series by message type."""
    found = {kind: each.at(moment) for kind, each in series.items()}
    pressure = found.get(PRESSURE)
    return {
        "gas_pressure_pa": None if pressure is None else float(pressure[0]),
        "wrench": found.get(WRENCH),
    }


# -- live -----------------------------------------------------------------------------------------

Verdict = Literal["ok", "jump", "duplicate", "out_of_order", "bad"]


class CheckedStamp(NamedTuple):
    """A verdict, and the time to use on the publisher's clock, ns."""

    verdict: Verdict
    time_ns: int


class _Stamped(NamedTuple):
    stamp: int
    arrival: int
    in_a_row: int  # number of consistent stamps


class StampClock:
    """Checks the stamps of one topic: distinguishes invalid ones from a clock that was set.

    A single stamp from 1970 or 2100 is `bad` and changes nothing. Three consistent ones in a row
    are the publisher's new clock.
    """

    def __init__(self) -> None:
        self._last: _Stamped | None = None
        self._suspect: _Stamped | None = None

    def check(self, stamp_ns: int, arrival_ns: int) -> CheckedStamp:
        """Verdict on the next message; `bad` ones are timed by their arrival."""
        last = self._last
        if last is None:
            if stamp_ns <= 0:
                return CheckedStamp("bad", arrival_ns)
            return self._accept("ok", stamp_ns, arrival_ns)
        step = stamp_ns - last.stamp
        if step == 0:
            return CheckedStamp("duplicate", stamp_ns)
        late = arrival_ns - last.arrival < REORDERED_NS  # else it is a clock that was set back
        if -REORDERED_NS < step < 0 and late:
            return CheckedStamp("out_of_order", stamp_ns)
        if stamp_ns > 0 and _follows(stamp_ns, arrival_ns, last):
            return self._accept("ok", stamp_ns, arrival_ns)
        if stamp_ns > 0 and self._trusted(stamp_ns, arrival_ns):
            return self._accept("jump", stamp_ns, arrival_ns)
        return CheckedStamp("bad", last.stamp + max(arrival_ns - last.arrival, 0))

    def _accept(self, verdict: Verdict, stamp: int, arrival: int) -> CheckedStamp:
        self._last, self._suspect = _Stamped(stamp, arrival, 0), None
        return CheckedStamp(verdict, stamp)

    def _trusted(self, stamp: int, arrival: int) -> bool:
        before = self._suspect
        follows = before is not None and _follows(stamp, arrival, before)
        count = before.in_a_row + 1 if before is not None and follows else 1
        self._suspect = _Stamped(stamp, arrival, count)
        return count >= TRUSTED_AFTER


def _follows(stamp: int, arrival: int, before: _Stamped) -> bool:
    return 0 < stamp - before.stamp <= max(arrival - before.arrival, 0) + FORWARD_NS


class GrowingSeries(Series[T]):
    """The latest messages of a live topic.

    As in a recording, a topic whose first message has no stamp is timed by arrivals.
    """

    def __init__(
        self,
        kept_ns: int,  # age relative to the newest message up to which they are kept
    ) -> None:
        self._stamps, self._items = list[int](), list[T]()
        super().__init__(self._stamps, self._items.__getitem__)
        self._clock, self._kept_ns = StampClock(), kept_ns

    def add(self, stamp_ns: int, arrival_ns: int, item: T) -> Verdict:
        """Add a message, or replace one of the same time; returns the verdict on its stamp."""
        if not self._stamps:
            self.by_arrival = stamp_ns == 0
        checked = CheckedStamp("ok", arrival_ns)
        if not self.by_arrival:
            checked = self._clock.check(stamp_ns, arrival_ns)
        if checked.verdict == "jump":
            self._drop(len(self))
        k = bisect_left(self._stamps, checked.time_ns)
        same = slice(k, k + (self._stamps[k : k + 1] == [checked.time_ns]))
        self._stamps[same], self._items[same] = [checked.time_ns], [item]
        self._drop(bisect_left(self._stamps, self._stamps[-1] - self._kept_ns))
        return checked.verdict

    def covers(self, moment: Moment) -> bool:
        """Whether a message at least as new as a moment arrived, or none is expected soon."""
        behind = self._time_of(moment) - self._stamps[-1] if self._stamps else 0
        return not 0 < behind <= SILENT_NS

    def snapshot(self, show: Callable[[T], U]) -> Series[U]:
        """Immutable copy of the current series, each message mapped by a function."""
        items = tuple(self._items)
        return Series(tuple(self._stamps), lambda k: show(items[k]), by_arrival=self.by_arrival)

    def _drop(self, count: int) -> None:
        del self._stamps[:count], self._items[:count]


# -- recorded -------------------------------------------------------------------------------------


def begins_again(stamps_ns: np.ndarray) -> bool:
    """Whether stamps (n,) in order of arrival go back far, or to earlier ones, as in a loop.

    Or never advance.
    """
    if len(stamps_ns) > 1 and not np.ptp(stamps_ns):
        return True
    behind = np.maximum.accumulate(stamps_ns) - stamps_ns
    repeated = np.ones(len(stamps_ns), bool)
    repeated[np.unique(stamps_ns, return_index=True)[1]] = False
    return bool(((behind > REORDERED_NS) | (repeated & (behind > 0))).any())


def plausible_times(stamps_ns: np.ndarray, log_ns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stamps and log times (n,), with those replaced that are more than an hour off the others.

    Where stamp and log time disagree by more than an hour, the one nearer to the median of its kind
    is kept: else a temporary fault of the camera's or the recorder's clock would start the
    recording in 1970 or end it in 2100. Unset stamps (0) stay so.
    """
    stamped = stamps_ns > 0
    if not stamped.any():
        return np.maximum(stamps_ns, 0), log_ns
    ahead = stamps_ns - log_ns
    usual = int(np.median(ahead[stamped]))
    apart = stamped & (np.abs(ahead - usual) > GARBAGE_NS)
    off_stamp = np.abs(stamps_ns - int(np.median(stamps_ns[stamped])))
    off_log = np.abs(log_ns - int(np.median(log_ns)))
    by_log = (stamps_ns == UNREADABLE) | (apart & (off_stamp >= off_log))
    stamps = np.where(by_log, log_ns + usual, stamps_ns)
    return stamps, np.where(apart & ~by_log, stamps_ns - usual, log_ns)


def recorded_series(
    messages: Messages,
    item: Callable[[int], T],  # content of message k
    *,
    # whether frames are timed by their log times; topics without stamps are in any case
    by_log: bool = False,
) -> Series[T]:
    """Series of a topic of a recording, not empty, read on demand."""
    item = lru_cache(_VALUES_KEPT)(item)
    if not by_log and messages.stamp_ns(0) != 0:
        return Series(_Stamps(messages), item)
    return Series(messages.log_ns, item, by_arrival=True)


class _Stamps:
    """Header stamps of messages, read on demand and cached."""

    def __init__(self, messages: Messages) -> None:
        self._messages, self._read = messages, dict[int, int]()

    def __len__(self) -> int:
        return len(self._messages)

    def __getitem__(self, k: int, /) -> int:
        if k not in self._read:
            self._read[k] = self._messages.stamp_ns(k)
        return self._read[k]
