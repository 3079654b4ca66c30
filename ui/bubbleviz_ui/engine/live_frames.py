"""Frames taken from a live stream, as a growing frame source. No Qt."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from bubbleviz.errors import InputError
from bubbleviz.live import LiveStream
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import Frame, Gap, usual_step
from bubbleviz.result import Result
from bubbleviz.zeros import PressureZero
from bubbleviz_ui.model.frame_history import grown

FRAMES_KEPT_S = 10.0
FRAMES_BYTES = 128 << 20
"""Frames of the last seconds are kept, up to this memory."""
MIN_KEPT = 3
"""Frames kept regardless of age: the one shown, and those solved or taken meanwhile."""
STEP_FRAMES = 100
"""Frames from which the typical frame interval is computed."""

Listener = Callable[[Result, Pipeline], None]


class LiveFrames:
    """A `FrameSource` of the frames taken from a stream, which keeps those of the last seconds.

    Frames are numbered as they are taken, and timed by their arrival, which unlike their stamps is
    monotonic.
    """

    def __init__(
        self,
        name: str,
        stream: LiveStream,  # Started and stopped by the caller
        zero: PressureZero,
        *,
        simulated: bool = False,
        paired: bool = False,  # One of two sensors
    ) -> None:
        self.name, self.stream, self.zero = name, stream, zero
        self.simulated, self.paired = simulated, paired
        self._epoch_ns = 0
        self._kept: deque[Frame] = deque()
        self._bytes = 0
        self._times_s = np.zeros(0)
        self._lock = threading.Lock()
        self._listeners: tuple[Listener, ...] = ()
        self._unsubscribe_colour: Callable[[], None] | None = None
        self._at_end: Callable[[], None] | None = None
        self._ended = False
        self.outages: tuple[Gap, ...] = ()  # Intervals in which the stream sent nothing

    @property
    def times_s(self) -> np.ndarray:
        """Arrival times, s since the first frame of the session."""
        with self._lock:
            return self._times_s.copy()

    def __len__(self) -> int:
        """Number of frames taken so far."""
        with self._lock:
            return len(self._times_s)

    def __getitem__(self, index: int) -> Frame:
        """A frame still in memory; InputError for an older one."""
        with self._lock:
            oldest = len(self._times_s) - len(self._kept)
            if index >= oldest:
                return self._kept[index - oldest]
        raise InputError(
            f"{self.name}: frame {index} is no longer in memory, which holds at most the last "
            f"{FRAMES_KEPT_S:g} s of a live source; record (Ctrl+R) to keep all frames"
        )

    def close(self) -> None:
        """Do nothing: the stream continues for the recorder, and for another sensor file."""

    def at_end(self, callback: Callable[[], None]) -> None:
        """Set the function to call when the stream has ended, replacing the previous one."""
        self._at_end = callback
        if self._ended:
            callback()

    def end(self) -> None:
        self._ended = True
        if self._at_end is not None:
            self._at_end()

    def begin(self, epoch_ns: int, first: Frame) -> None:
        """Start with the first frame; `epoch_ns`: time zero of all sensors of the session."""
        self._epoch_ns = epoch_ns
        self._take(first)

    def set_colour(self, on: bool) -> None:
        """Subscribe to colour images, or unsubscribe."""
        unsubscribe = self._unsubscribe_colour
        if on and unsubscribe is None:
            self._unsubscribe_colour = self.stream.follow_colour()
        elif not on and unsubscribe is not None:
            self._unsubscribe_colour = None
            unsubscribe()

    def newest(self, timeout_s: float) -> Frame | None:
        """Wait for the newest frame not taken yet; None after the timeout."""
        frame = self.stream.take(timeout_s)
        return None if frame is None else self._take(frame)

    @property
    def ended(self) -> bool:
        return self.stream.ended

    def at(self, time_s: float) -> int:
        """The frame in memory nearest to a time."""
        with self._lock:
            oldest = len(self._times_s) - len(self._kept)
            return oldest + int(np.abs(self._times_s[oldest:] - time_s).argmin())

    def arrival_ns(self, index: int) -> int:
        """Arrival time of a frame, ns since 1970."""
        with self._lock:
            return self._epoch_ns + round(float(self._times_s[index]) * 1e9)

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Pass new results to a listener, in the solver thread; returns a function to stop that."""
        self._listeners = (*self._listeners, listener)

        def unsubscribe() -> None:
            self._listeners = tuple(k for k in self._listeners if k is not listener)

        return unsubscribe

    def publish(self, result: Result, pipeline: Pipeline) -> None:
        """Pass a new result to all listeners, with the pipeline that made it."""
        for listener in self._listeners:
            listener(result, pipeline)

    def _take(self, frame: Frame) -> Frame:
        with self._lock:
            index, time_s = len(self._times_s), (frame.arrival_ns - self._epoch_ns) * 1e-9
            if index:
                self._note_outages(index - 1, frame.arrival_ns)
            frame = replace(frame, index=index, time_s=time_s)
            self._times_s = grown(self._times_s, index + 1, np.nan)
            self._times_s[-1] = time_s
            self._kept.append(frame)
            self._bytes += frame.depth_m.nbytes
            while len(self._kept) > MIN_KEPT and (
                self._bytes > FRAMES_BYTES or self._kept[0].time_s < time_s - FRAMES_KEPT_S
            ):
                self._bytes -= self._kept.popleft().depth_m.nbytes
        return frame

    def _note_outages(self, last: int, arrival_ns: int) -> None:
        """Record the outages since frame `last`, even between frames dropped by a busy solver."""
        since_ns = self._kept[-1].arrival_ns
        for before_ns, after_ns in self.stream.outages:
            if since_ns < after_ns <= arrival_ns:
                silent_s = (after_ns - before_ns) * 1e-9
                usual_s = usual_step(np.diff(self._times_s[-STEP_FRAMES:])) or silent_s
                missing = max(round(silent_s / usual_s) - 1, 1)
                self.outages = (*self.outages, Gap(last, missing, silent_s))
