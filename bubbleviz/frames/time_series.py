"""Laps of a replay in a recording, and measured values at the time of a frame."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from typing import Any

import numpy as np

from bubbleviz.frames.bags import Messages

NEAREST_NS = 100_000_000
"""Beyond the first and the last value the nearest one counts, within this time."""

REORDERED_NS = 1_000_000_000
"""A network swaps messages of a second at most; further back the clock was set, or it is a replay
that began again."""


class Laps:
    """Laps of a replay that began again while it was recorded, so that its stamps come again.

    The stamps tell what belongs together in a lap: messages arrive in bursts, and those of one
    topic later than those of another. The log times only tell where in the recording a lap lies.

    Parameters
    ----------
    stamps_ns, log_ns : (n,) int64 array
        Header stamps and log times of the depth images, in the order of their arrival.

    Attributes
    ----------
    number : (n,) int array
        Lap of each image; all 0 where no replay began again.
    """

    def __init__(self, stamps_ns: np.ndarray, log_ns: np.ndarray) -> None:
        self.number = _lap_numbers(stamps_ns)
        self._starts_ns = _start_of_laps(stamps_ns, log_ns, self.number)
        self._apart_ns = int(np.ptp(stamps_ns)) + 10 * NEAREST_NS

    def __len__(self) -> int:
        """Count the laps."""
        return len(self._starts_ns)

    def times_ns(self, stamps_ns: np.ndarray) -> np.ndarray:
        """Times of the images in the recording, one lap after the other, (n,)."""
        times, step = stamps_ns.copy(), _usual_step(stamps_ns)
        end: int | None = None
        for lap, start in enumerate(self._starts_ns):
            here = self.number == lap
            first = int(stamps_ns[here].min()) + start
            shift = start if end is None else start + max(end + step - first, 0)
            times[here] += shift
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


def _usual_step(stamps_ns: np.ndarray) -> int:
    steps = np.diff(np.unique(stamps_ns))
    return int(np.median(steps)) if len(steps) else 1


class Timeline:
    """Times of the messages of a topic, read only where asked.

    They are header stamps, or log times when `by_log` or where the topic has no stamps. Stamps are
    taken to rise in each lap.

    Parameters
    ----------
    messages : Messages
        Not empty.
    by_log : bool
        Whether frames are timed by their log times.
    laps : Laps, optional
        Those of the depth images, where there is more than one.
    """

    def __init__(
        self, messages: Messages, *, by_log: bool = False, laps: Laps | None = None
    ) -> None:
        self._messages = messages
        self.by_log = by_log or messages.stamp_ns(0) == 0
        self._lap: np.ndarray | None = None
        self._stamps: dict[int, int] = {}
        if laps is not None and not self.by_log:
            stamps = np.array([messages.stamp_ns(k) for k in range(len(messages))])
            self._lap = laps.number_of(stamps, messages.log_ns)
            self.by_log = self._lap is None
            if self._lap is not None:
                self._stamps = dict(enumerate(laps.keys(stamps, self._lap).tolist()))

    def __len__(self) -> int:
        """Count the messages."""
        return len(self._messages)

    def time_ns(self, k: int) -> int:
        """Time of message `k`."""
        if self.by_log:
            return int(self._messages.log_ns[k])
        if k not in self._stamps:
            self._stamps[k] = self._messages.stamp_ns(k)
        return self._stamps[k]

    def place(self, stamp_ns: int, log_ns: int) -> tuple[int, int]:
        """First message that is not before a frame, and the frame's time on this clock.

        Parameters
        ----------
        stamp_ns, log_ns : int
            A frame's stamp (with laps: its key) and log time, of which the one counts that applies.
        """
        t = log_ns if self.by_log else stamp_ns
        return bisect_left(range(len(self)), t, key=self.time_ns), t

    def nearest(self, stamp_ns: int, log_ns: int) -> tuple[int, int]:
        """Message nearest to a frame, and by how much it is later, ns."""
        k, t = self.place(stamp_ns, log_ns)
        beside = range(max(k - 1, 0), min(k + 1, len(self)))
        found = min(beside, key=lambda j: abs(self.time_ns(j) - t))
        return found, self.time_ns(found) - t

    def goes_on(self, k: int) -> bool:
        """Whether message `k` follows the one before it in the same lap."""
        return 0 < k < len(self) and (self._lap is None or self._lap[k - 1] == self._lap[k])


class Series:
    """Values of a topic, interpolated linearly in time; read only where asked.

    Where its stamps do not rise, the values around the place found count.

    Parameters
    ----------
    messages : Messages
        Not empty.
    value : callable
        Array of the values in a message; ValueError when they are not finite.
    by_log : bool
        Whether frames are timed by their log times.
    laps : Laps, optional
        Those of the depth images, where there is more than one.
    """

    def __init__(
        self,
        messages: Messages,
        value: Callable[[Any], np.ndarray],
        *,
        by_log: bool = False,
        laps: Laps | None = None,
    ) -> None:
        self._messages, self._value = messages, value
        self._timeline = Timeline(messages, by_log=by_log, laps=laps)
        self._values: dict[int, np.ndarray] = {}

    def __len__(self) -> int:
        """Count the messages."""
        return len(self._messages)

    def at(self, stamp_ns: int, log_ns: int) -> np.ndarray | None:
        """Values at a frame's stamp (with laps: its key) or log time, whichever applies.

        Beyond the first and the last message, also of a lap, the nearest within 0.1 s, else None.
        """
        k, t = self._timeline.place(stamp_ns, log_ns)
        if self._timeline.goes_on(k):
            return self._between(k - 1, k, t)
        nearest, off_ns = self._timeline.nearest(stamp_ns, log_ns)
        return self.values(nearest) if abs(off_ns) <= NEAREST_NS else None

    def values(self, k: int) -> np.ndarray:
        """Values of message `k`."""
        if k not in self._values:
            if len(self._values) > 10_000:
                self._values.clear()
            self._values[k] = self._value(self._messages.message(k))
        return self._values[k]

    def _between(self, a: int, b: int, t: int) -> np.ndarray:
        ta, tb = self._timeline.time_ns(a), self._timeline.time_ns(b)
        if not ta <= t <= tb or ta == tb:
            return self.values(a if abs(t - ta) <= abs(t - tb) else b)
        weight = (t - ta) / (tb - ta)
        if weight in (0.0, 1.0):  # do not read what counts nothing
            return self.values(b if weight else a)
        return (1.0 - weight) * self.values(a) + weight * self.values(b)
