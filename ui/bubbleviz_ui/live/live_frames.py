"""The frames of a live stream that were looked at, as a source that grows. No Qt in here."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from bubbleviz.errors import InputError
from bubbleviz.live import LiveStream
from bubbleviz.membrane import MembraneMesh
from bubbleviz.pressure_zero import PressureZero
from bubbleviz.recordings import Frame, Gap, usual_step
from bubbleviz.result import Result
from bubbleviz_ui.model.frame_history import grown

KEPT_S = 10.0  # s of frames to look back at
KEPT_BYTES = 128 << 20
"""Frames one can go back to: of the last seconds, and no more memory than this."""
SHOWN = 3
"""Frames that are kept however old: the one in the picture, and those solved or taken meanwhile."""
RECENT = 100
"""Frames that tell the usual time from one to the next."""

Listener = Callable[[Result, MembraneMesh], None]


class LiveFrames:
    """A `FrameSource` made of the frames that were taken from a stream, the newest of each moment.

    Frames are counted as they are taken, and timed by their arrival, which unlike their stamps
    never goes back.
    """

    def __init__(
        self,
        name: str,
        stream: LiveStream,  # Started; whoever started it stops it
        zero: PressureZero,
        *,
        simulated: bool = False,  # Of a simulation
        paired: bool = False,  # Another sensor's frames come at the same time
    ) -> None:
        self.name, self.stream, self.zero = name, stream, zero
        self.simulated, self.paired = simulated, paired
        self._epoch_ns = 0
        self._kept: deque[Frame] = deque()
        self._bytes = 0
        self._times_s = np.zeros(0)
        self._lock = threading.Lock()
        self._listeners: tuple[Listener, ...] = ()
        self._let_go_of_colour: Callable[[], None] | None = None
        self._at_end: Callable[[], None] | None = None
        self._over = False
        self.outages: tuple[Gap, ...] = ()  # Where the stream sent nothing

    @property
    def times_s(self) -> np.ndarray:
        """Arrival of each frame, s since the first of the session."""
        with self._lock:
            return self._times_s.copy()

    def __len__(self) -> int:
        """Count the frames taken so far."""
        with self._lock:
            return len(self._times_s)

    def __getitem__(self, index: int) -> Frame:
        """A frame that is still kept; InputError for an older one."""
        with self._lock:
            oldest = len(self._times_s) - len(self._kept)
            if index >= oldest:
                return self._kept[index - oldest]
        raise InputError(
            f"{self.name}: frame {index} is gone, as only the last {KEPT_S:g} s of a live source "
            "are kept; record to keep all"
        )

    def close(self) -> None:
        """Nothing: the stream goes on for the recorder, and for another sensor file."""

    def at_end(self, callback: Callable[[], None]) -> None:
        """Have this called, in place of what was to be, once no more frames will come."""
        self._at_end = callback
        if self._over:
            callback()

    def end(self) -> None:
        """Say that no more frames will come."""
        self._over = True
        if self._at_end is not None:
            self._at_end()

    def begin(self, epoch_ns: int, first: Frame) -> None:
        """Begin with the first frame; time began at `epoch_ns` for all sensors of a session."""
        self._epoch_ns = epoch_ns
        self._take(first)

    def set_colour(self, on: bool) -> None:
        """Have the frames from now on with colour images, or without: only who asks gets them."""
        let_go = self._let_go_of_colour
        if on and let_go is None:
            self._let_go_of_colour = self.stream.follow_colour()
        elif not on and let_go is not None:
            self._let_go_of_colour = None
            let_go()

    def newest(self, timeout_s: float) -> Frame | None:
        """The newest frame nobody has seen, waiting for one; None when none came."""
        frame = self.stream.take(timeout_s)
        return None if frame is None else self._take(frame)

    @property
    def ended(self) -> bool:
        """Whether no frame is to be waited for."""
        return self.stream.ended

    def at(self, time_s: float) -> int:
        """The kept frame nearest to a time."""
        with self._lock:
            oldest = len(self._times_s) - len(self._kept)
            return oldest + int(np.abs(self._times_s[oldest:] - time_s).argmin())

    def arrival_ns(self, index: int) -> int:
        """When a frame arrived, ns since 1970."""
        with self._lock:
            return self._epoch_ns + round(float(self._times_s[index]) * 1e9)

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Have new results passed on, in the solver thread; undo by calling."""
        self._listeners = (*self._listeners, listener)

        def forget() -> None:
            self._listeners = tuple(k for k in self._listeners if k is not listener)

        return forget

    def publish(self, result: Result, mesh: MembraneMesh) -> None:
        """Pass a new result on."""
        for listener in self._listeners:
            listener(result, mesh)

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
            while len(self._kept) > SHOWN and (
                self._bytes > KEPT_BYTES or self._kept[0].time_s < time_s - KEPT_S
            ):
                self._bytes -= self._kept.popleft().depth_m.nbytes
        return frame

    def _note_outages(self, last: int, arrival_ns: int) -> None:
        """Take those since frame `last`; in what a busy solver left out there may be none."""
        since_ns = self._kept[-1].arrival_ns
        for before_ns, after_ns in self.stream.outages:
            if since_ns < after_ns <= arrival_ns:
                silent_s = (after_ns - before_ns) * 1e-9
                usual_s = usual_step(np.diff(self._times_s[-RECENT:])) or silent_s
                missing = max(round(silent_s / usual_s) - 1, 1)
                self.outages = (*self.outages, Gap(last, missing, silent_s))
