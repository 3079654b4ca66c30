"""Data of a frame by time: measured values are interpolated, the nearest image is taken.

The rules are the same in a recording and live: a recording is a stream that has ended. Live, a
`GrowingSeries` is filled as messages arrive; of a recording `recorded_series` reads only what is
asked for. Implausible stamps are told from a clock that was set by what is known of them: live by
those that came before (`StampClock`), in a recording by all (`Laps`, `plausible_times`).
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
"""Beyond the first and the last value the nearest one counts, within this time."""
SILENT_NS = 10 * NEAREST_NS
"""From a topic that has been silent for so long nothing is expected soon."""
REORDERED_NS = 1_000_000_000
"""A network swaps messages of a second at most; further back the clock was set, or it is a replay
that began again."""
FORWARD_NS = 10_000_000_000
"""A stamp may gain this on the time between two arrivals: a network that stood still and caught up.
Beyond it the clock was set, or the stamp is garbage."""
TRUSTED_AFTER = 3
"""Stamps in a row that must agree with each other to be believed against the ones before."""
GARBAGE_NS = 3_600_000_000_000
"""In a recording a stamp that is further off the others, one hour, is from an unset clock."""
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
        # rising in each lap. Where they do not rise, the messages around the place found count.
        times_ns: Times,
        # what message k holds: of values an array, ValueError when they are not finite
        item: Callable[[int], T],
        *,
        by_arrival: bool = False,  # whether the times are arrivals, as of a topic without stamps
        # (n,) int, lap of each message in a replay that began again
        laps: np.ndarray | None = None,
    ) -> None:
        self.item, self.by_arrival = item, by_arrival
        self._times, self._laps = times_ns, laps

    def __len__(self) -> int:
        return len(self._times)

    def nearest(self, moment: Moment, within_ns: int) -> tuple[int, int] | None:
        """Message nearest to a moment, and by how much it is later, ns; None further off."""
        k, t = self._place(moment)
        offs = {j: int(self._times[j]) - t for j in (k - 1, k) if 0 <= j < len(self)}
        found = min(offs, key=lambda j: abs(offs[j]), default=None)
        return None if found is None or abs(offs[found]) > within_ns else (found, offs[found])

    def at(self: Series[np.ndarray], moment: Moment) -> np.ndarray | None:
        """Values at a moment, interpolated linearly.

        Beyond the first and the last message, also of a lap, the nearest within 0.1 s, else None.
        """
        k, t = self._place(moment)
        if not 0 < k < len(self) or (self._laps is not None and self._laps[k - 1] != self._laps[k]):
            found = self.nearest(moment, NEAREST_NS)
            return None if found is None else _told(self.item(found[0]))
        ta, tb = int(self._times[k - 1]), int(self._times[k])
        if not ta < t < tb:  # at one of them; or the times do not rise
            return _told(self.item(k - 1 if abs(t - ta) <= abs(t - tb) else k))
        weight = (t - ta) / (tb - ta)
        return _told((1.0 - weight) * self.item(k - 1) + weight * self.item(k))

    def _time_of(self, moment: Moment) -> int:
        return moment.arrival_ns if self.by_arrival else moment.stamp_ns

    def _place(self, moment: Moment) -> tuple[int, int]:
        """First message that is not before a moment, and the moment on the clock of this topic."""
        t = self._time_of(moment)
        return bisect_left(self._times, t), t


def _told(values: np.ndarray) -> np.ndarray | None:
    """Values of a message, or of two; None where one could not be read, which is NaN then."""
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
        late = arrival_ns - last.arrival < REORDERED_NS  # else it is a clock that was set back
        if -REORDERED_NS < step < 0 and late:
            return Judged("out_of_order", stamp_ns)
        if stamp_ns > 0 and _follows(stamp_ns, arrival_ns, last):
            return self._accept("ok", stamp_ns, arrival_ns)
        if stamp_ns > 0 and self._trusted(stamp_ns, arrival_ns):
            return self._accept("jump", stamp_ns, arrival_ns)
        return Judged("bad", last.stamp + max(arrival_ns - last.arrival, 0))

    def _accept(self, verdict: Verdict, stamp: int, arrival: int) -> Judged:
        self._last, self._suspect = _Seen(stamp, arrival, 0), None
        return Judged(verdict, stamp)

    def _trusted(self, stamp: int, arrival: int) -> bool:
        before = self._suspect
        follows = before is not None and _follows(stamp, arrival, before)
        count = before.times + 1 if before is not None and follows else 1
        self._suspect = _Seen(stamp, arrival, count)
        return count >= TRUSTED_AFTER


def _follows(stamp: int, arrival: int, before: _Seen) -> bool:
    return 0 < stamp - before.stamp <= max(arrival - before.arrival, 0) + FORWARD_NS


class GrowingSeries(Series[T]):
    """The messages of a live topic that arrived last.

    As in a recording, a topic whose first message has no stamp is timed by arrivals.
    """

    def __init__(
        self,
        kept_ns: int,  # how long before the newest message they are kept
    ) -> None:
        self._stamps, self._items = list[int](), list[T]()
        super().__init__(self._stamps, self._items.__getitem__)
        self._clock, self._kept_ns = StampClock(), kept_ns

    def add(self, stamp_ns: int, arrival_ns: int, item: T) -> Verdict:
        """Keep a message, in place of one of the same time; the verdict on its stamp."""
        if not self._stamps:
            self.by_arrival = stamp_ns == 0
        judged = Judged("ok", arrival_ns)
        if not self.by_arrival:
            judged = self._clock.judge(stamp_ns, arrival_ns)
        if judged.verdict == "jump":
            self._let_go(len(self))
        k = bisect_left(self._stamps, judged.time_ns)
        same = slice(k, k + (self._stamps[k : k + 1] == [judged.time_ns]))
        self._stamps[same], self._items[same] = [judged.time_ns], [item]
        self._let_go(bisect_left(self._stamps, self._stamps[-1] - self._kept_ns))
        return judged.verdict

    def covers(self, moment: Moment) -> bool:
        """Whether a message at least as new as a moment arrived, or none is expected soon."""
        behind = self._time_of(moment) - self._stamps[-1] if self._stamps else 0
        return not 0 < behind <= SILENT_NS

    def snapshot(self, show: Callable[[T], U]) -> Series[U]:
        """What is here now, each message shown by a function, as a series that does not grow."""
        items = tuple(self._items)
        return Series(tuple(self._stamps), lambda k: show(items[k]), by_arrival=self.by_arrival)

    def _let_go(self, count: int) -> None:
        del self._stamps[:count], self._items[:count]


# -- recorded -------------------------------------------------------------------------------------


class Laps:
    """Laps of a replay that began again while it was recorded, so that its stamps come again.

    The stamps tell what belongs together in a lap: messages arrive in bursts, and those of one
    topic later than those of another. The log times only tell where in the recording a lap lies.

    Parameters
    ----------
    stamps_ns, log_ns : (n,) int64 array
        Header stamps and log times of the depth images, in the order of their arrival.
    """

    def __init__(self, stamps_ns: np.ndarray, log_ns: np.ndarray) -> None:
        # (n,) int, lap of each image; all 0 where no replay began again
        self.number = _lap_numbers(stamps_ns)
        self._starts_ns = _start_of_laps(stamps_ns, log_ns, self.number)
        self._apart_ns = int(np.ptp(stamps_ns)) + SILENT_NS

    def __len__(self) -> int:
        return len(self._starts_ns)

    def times_ns(self, stamps_ns: np.ndarray) -> np.ndarray:
        """Times of the images in the recording, one lap after the other, (n,)."""
        steps = np.diff(np.unique(stamps_ns))
        step = int(np.median(steps)) if len(steps) else 1
        times, end = stamps_ns.copy(), -np.inf
        for lap, start in enumerate(self._starts_ns):
            here = self.number == lap
            first = int(stamps_ns[here].min()) + start
            times[here] += start + int(max(end + step - first, 0))
            end = int(times[here].max())
        return times

    def keys(self, stamps_ns: np.ndarray, number: np.ndarray) -> np.ndarray:
        """Stamps (k,), moved so far apart from lap to lap that no two laps are near each other."""
        return stamps_ns + number * self._apart_ns

    def number_of(self, stamps_ns: np.ndarray, log_ns: np.ndarray) -> np.ndarray | None:
        """Lap of each message of another topic, (k,); None where its stamps do not begin again."""
        own = _lap_numbers(stamps_ns)
        starts = _start_of_laps(stamps_ns, log_ns, own)
        if len(starts) == 1:  # of another clock
            return None
        if len(starts) == len(self):
            return own
        nearest = np.abs(starts[:, None] - self._starts_ns).argmin(axis=1)
        return nearest[own]


def _lap_numbers(stamps_ns: np.ndarray) -> np.ndarray:
    """Lap of each message: another begins where stamps go back far, or to one that was there."""
    numbers = np.zeros(len(stamps_ns), np.int64)
    if (np.diff(stamps_ns) >= 0).all():
        return numbers
    highest, seen, lap = int(stamps_ns[0]), set[int](), 0
    for k, stamp in enumerate(stamps_ns.tolist()):
        if highest - stamp > REORDERED_NS or (stamp < highest and stamp in seen):
            highest, seen, lap = stamp, set(), lap + 1
        highest = max(highest, stamp)
        seen.add(stamp)
        numbers[k] = lap
    return numbers


def _start_of_laps(stamps_ns: np.ndarray, log_ns: np.ndarray, number: np.ndarray) -> np.ndarray:
    """Log time of the stamp 0 of each lap, by its least delayed message, (laps,), ns."""
    starts = np.full(number[-1] + 1, np.iinfo(np.int64).max)
    np.minimum.at(starts, number, log_ns - stamps_ns)
    return starts


def plausible_times(stamps_ns: np.ndarray, log_ns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stamps and log times (n,), those replaced that are more than an hour off the others.

    Where stamp and log time disagree by more than an hour, the one nearer to the median of its kind
    is kept: a clock that was lost for a moment, the camera's or the recorder's, would otherwise
    begin the recording in 1970, or end it in 2100. Stamps that are 0, unset, stay so.
    """
    told = stamps_ns > 0
    if not told.any():
        return np.maximum(stamps_ns, 0), log_ns
    ahead = stamps_ns - log_ns
    usual = int(np.median(ahead[told]))
    apart = told & (np.abs(ahead - usual) > GARBAGE_NS)
    off_stamp = np.abs(stamps_ns - int(np.median(stamps_ns[told])))
    off_log = np.abs(log_ns - int(np.median(log_ns)))
    by_log = (stamps_ns == UNREADABLE) | (apart & (off_stamp >= off_log))
    stamps = np.where(by_log, log_ns + usual, stamps_ns)
    return stamps, np.where(apart & ~by_log, stamps_ns - usual, log_ns)


def recorded_series(
    messages: Messages,
    item: Callable[[int], T],  # what message k holds
    *,
    # whether frames are timed by their log times; topics without stamps are in any case
    by_log: bool = False,
    # those of the depth images, where there is more than one: moments then have their keys
    laps: Laps | None = None,
) -> Series[T]:
    """Series of a topic of a recording, not empty, of which only what is asked for is read."""
    item = lru_cache(_VALUES_KEPT)(item)
    if not by_log and messages.stamp_ns(0) != 0:
        if laps is None:
            return Series(_Stamps(messages), item)
        stamps = np.array([messages.stamp_ns(k) for k in range(len(messages))])
        if (number := laps.number_of(stamps, messages.log_ns)) is not None:
            return Series(laps.keys(stamps, number), item, laps=number)
    return Series(messages.log_ns, item, by_arrival=True)


class _Stamps:
    """Header stamps of messages, each read once when asked for."""

    def __init__(self, messages: Messages) -> None:
        self._messages, self._read = messages, dict[int, int]()

    def __len__(self) -> int:
        return len(self._messages)

    def __getitem__(self, k: int, /) -> int:
        if k not in self._read:
            self._read[k] = self._messages.stamp_ns(k)
        return self._read[k]
