"""Estimation of live sources: frame by frame, or until they end or ^C."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from tqdm import tqdm

from bubbleviz.api.connecting import sensor_of
from bubbleviz.api.estimator import Estimator, FrameSolver
from bubbleviz.api.frame_warnings import NO_FRAME_FITS
from bubbleviz.api.recording import replacing, stopped_by_signals, zenoh_publisher
from bubbleviz.api.results import FrameResult
from bubbleviz.api.summary import Summary
from bubbleviz.diagnostics import shear_line
from bubbleviz.errors import InputError, check_given
from bubbleviz.live import (
    STOPPED_AFTER_S,
    LatencyMeter,
    LiveStream,
    Recorder,
    ResultSender,
    open_stream,
)
from bubbleviz.recordings import AUTO, LAG, Frame, Message
from bubbleviz.result import Result
from bubbleviz.rigid_object import RigidObject, load_object
from bubbleviz.sensor import Sensor, with_colour_delay
from bubbleviz.wording import counted
from bubbleviz.zeros import ZERO_FRAMES

if TYPE_CHECKING:
    from bubbleviz.shear import PassingTexture

_POLL_S = 0.1  # polling period of the stream; chosen


class Watcher:
    """Repeatedly solves the newest frame of a started stream.

    A `first` frame was taken from the stream already; it is solved unless a newer one has arrived.
    """

    def __init__(self, stream: LiveStream, solver: FrameSolver, first: Frame | None = None) -> None:
        self.stream, self.solver, self._first = stream, solver, first
        self.latency = LatencyMeter()
        self.last: Result | None = None
        self._began, self._max_force_n = time.monotonic(), math.nan
        self.statuses, self._tractions = Counter[str](), Counter[str]()

    @classmethod
    def on(
        cls,
        stream: LiveStream,
        sensor: Sensor,
        *,
        stop: threading.Event | None = None,
        **options: Any,
    ) -> Watcher:
        """Watcher of a started stream; waits for the first frame and its intrinsics.

        `options` as in `Estimator`; `stop` ends the wait. Raises InputError: no depth image, images
        of another camera, or shear without the exact membrane.
        """
        if options.get("shear"):
            stream.follow_colour()

        def waiting() -> None:
            if stop is not None and stop.is_set():
                raise stream.nothing_arrived()

        first = stream.first_frame(waiting=waiting)
        with stream.source.held():
            solver = Estimator(sensor, intrinsics=first.intrinsics, **options).solver
        return cls(stream, solver, first)

    def step(self, timeout_s: float) -> Result | None:
        """Solve the newest frame; None if none arrived in time."""
        frame = self.stream.take_after(self._first, 0.0 if self._first else timeout_s)
        self._first = None
        if frame is None:
            return None
        self.last = result = self.solver.solve(frame)
        self.latency.add(frame, time.time_ns())
        self.statuses[result.solution[0].status] += 1
        if (patch := result.trusted_patch) is not None:
            self._max_force_n = np.fmax(self._max_force_n, np.linalg.norm(patch.force_n))
        if result.traction is not None:
            self._tractions[result.traction.status] += 1
        return result

    def results(self, timeout_s: float | None) -> Iterator[FrameResult]:
        """Results of the newest frames until the source ends."""
        for result in self.stream.each(self.step, timeout_s):
            yield FrameResult(result, self.solver.pipeline.model)

    def summary(self) -> WatchSummary:
        """Summary of the results so far."""
        stream, solver, frames = self.stream, self.solver, self.statuses.total()
        latency, zero, texture = self.latency.report(), solver.zeros.gas, solver.texture
        return WatchSummary(
            frames=frames,
            status=dict(self.statuses),
            rate_hz=frames / (time.monotonic() - self._began),
            max_force_n=None if math.isnan(self._max_force_n) else float(self._max_force_n),
            latency_median_s=None if latency is None else latency.median_s,
            latency_p95_s=None if latency is None else latency.p95_s,
            pressure_offset_pa=None if zero is None else zero.offset_pa,
            traction_status=None if texture is None else dict(self._tractions),
            texture=None if texture is None else texture.words,
            counters=asdict(stream.counters),
            model=None if self.last is None else self.last.solution[0].caveat or None,
            warning="; ".join(filter(None, (*solver.warnings(), stream.frozen))) or None,
        )


@dataclass(frozen=True)
class WatchSummary(Summary):
    """Summary of `watch`; None for unknown values."""

    frames: int  # solved
    status: dict[str, int]  # number of frames by status
    rate_hz: float
    max_force_n: float | None  # over trusted frames
    latency_median_s: float | None  # from stamp (from arrival if clocks differ) to result
    latency_p95_s: float | None
    pressure_offset_pa: float | None  # subtracted from the measured gas pressure
    traction_status: dict[str, int] | None  # number of frames by status; None: no shear requested
    texture: str | None  # reference of the optical flow, or why there is none; likewise
    counters: dict[str, Any]
    model: str | None  # how wrong forces may be due to it; None: the exact membrane
    warning: str | None  # mismatches that did not prevent the estimation

    def to_text(self) -> str:
        """Text for the terminal, with units."""
        lines = [f"frames   {self.frames}: {counted(self.status)}; {self.rate_hz:.1f} Hz"]
        if self.max_force_n is not None:
            lines.append(f"force    {self.max_force_n:.3g} N highest")
        if self.traction_status is not None:
            status = counted(self.traction_status) or "no frame"
            lines.append(f"shear    {status}; force direction not verified on real sensors")
            lines.append(f"         {self.texture}")
        if self.latency_median_s is not None and self.latency_p95_s is not None:
            lines.append(
                f"latency  {1e3 * self.latency_median_s:.1f} ms median, "
                f"{1e3 * self.latency_p95_s:.1f} ms p95"
            )
        if self.pressure_offset_pa is not None:
            lines.append(
                f"zero     {self.pressure_offset_pa:+.1f} Pa subtracted from the gas pressure"
            )
        if self.model is not None:
            lines.append(f"model    {self.model}")
        return "\n".join(lines)


def watch(
    source: str,
    sensor: str | Path | Sensor = AUTO,
    *,
    out: str | Path | None = None,
    overwrite: bool = False,
    listen: str | None = None,
    connect: str | None = None,
    duration_s: float | None = None,
    object: str | Path | RigidObject | None = None,
    unit: Literal["m", "mm"] | None = None,
    solver: str | None = None,
    friction: float | None = None,
    zero_gas: bool = True,
    shear: bool = False,
    colour_delay_s: float | None = None,
    **credentials: str | None,
) -> WatchSummary:
    """Estimate a live source; publish or record the results.

    Runs until the duration is over, the source ends, or ^C. With `shear`, start without contact:
    the first colour images are the reference.

    Parameters
    ----------
    source, sensor
        As in `connect`.
    out : path, optional
        Recording of messages and results.
    overwrite : bool
        Replace existing files.
    listen : str, optional
        Publish results at this endpoint for subscribers that connect, such as tcp/127.0.0.1:7448.
    connect : str, optional
        Publish results through this router, such as tcp/HOST:7447.
    duration_s : float, optional
        Duration from the first frame on, s; by default until ^C or the end of the source.
    object : str, path or RigidObject, optional
        Object to track: preset or mesh file.
    unit : {"m", "mm"}, optional
        As in `track`.
    solver, friction, zero_gas, shear, colour_delay_s
        As in `estimate`; the zero of the gas pressure comes from the first contact-free frames.
    **credentials
        `ca`, `cert`, `key` and `login`, files of the Zenoh session.

    Returns
    -------
    WatchSummary
        For results in Python use `connect`, then `estimate` or `track`.

    Raises
    ------
    InputError
        The source, the file or the endpoint cannot be opened, or no depth image arrived.
    """
    check_given("--duration", duration_s, 1e-3)
    unused = next((name for name, file in credentials.items() if file is not None), None)
    if unused is not None and listen is None and connect is None:
        raise InputError(
            f"--{unused}: for results that are published; give --listen or --connect, too, or "
            f"{unused}= in the source"
        )
    own = with_colour_delay(sensor_of(source, sensor), colour_delay_s)
    obj = None if object is None else load_object(object, unit)
    options: dict[str, Any] = {"solver": solver, "friction": friction, "zero_gas": zero_gas}
    options |= {"object": obj, "shear": shear}
    with ExitStack() as stack:
        stop = stack.enter_context(stopped_by_signals())
        stream = open_stream(source, own)
        recorder = _recorder(stack, stream, out, overwrite=overwrite)
        if shear:
            stream.follow_colour()
        publisher = None
        if listen is not None or connect is not None:
            publisher = stack.enter_context(zenoh_publisher(listen, connect, credentials))
        stack.enter_context(stream)
        watcher = Watcher.on(stream, own, stop=stop, **options)

        def send(message: Message) -> None:
            if publisher is not None:
                publisher.put(message)
            if recorder is not None:
                recorder.push(message._replace(arrival_ns=time.time_ns()))

        def is_wanted(topic: str, kind: str) -> bool:
            subscribed = publisher is not None and publisher.is_subscribed(topic, kind)
            return subscribed or recorder is not None

        return _watch(watcher, ResultSender(stream, send, is_wanted), stop, duration_s)


def _watch(
    watcher: Watcher,
    send: ResultSender,
    stop: threading.Event,
    duration_s: float | None,
) -> WatchSummary:
    stream, silent = watcher.stream, False
    with tqdm(unit=" frames", disable=None, file=sys.stderr) as bar:  # only on a terminal
        for result in _until_over(watcher, stop, duration_s):
            if result is not None:
                send(result, watcher.solver.pipeline)
                bar.update()
                frames = watcher.statuses.total()
                # the first frame for which the noise of the stream may be known
                if watcher.statuses["implausible"] == frames == LAG + ZERO_FRAMES + 1:
                    _warn(f"{stream.name}: {NO_FRAME_FITS}")
            silent = _warn_of_silence(stream, silent)
            if send.diagnose():
                newest = _newest(watcher.last, watcher.solver.texture)
                bar.set_postfix_str(", ".join(filter(None, (*newest, stream.status().text))))
    return watcher.summary()


def _until_over(
    watcher: Watcher, stop: threading.Event, duration_s: float | None
) -> Iterator[Result | None]:
    """Yield the result of each newest frame, or None when no frame arrived within `_POLL_S`.

    Ends with the source, by `stop`, or after `duration_s`.
    """
    began = time.monotonic()
    while not stop.is_set() and (duration_s is None or time.monotonic() - began < duration_s):
        ended = watcher.stream.ended  # read before the step, as a last frame may precede the end
        result = watcher.step(_POLL_S)
        if ended and result is None:
            return
        yield result


def _warn_of_silence(stream: LiveStream, warned: bool) -> bool:
    """Warn once per outage that no depth images arrive; returns whether the outage lasts."""
    silent_s = stream.status().silent_s or 0.0
    if silent_s < STOPPED_AFTER_S or stream.ended:
        return False
    if not warned:
        _warn(f"{stream.silence()}; waiting for the next image")
    return True


def _warn(text: str) -> None:
    tqdm.write(f"bubbleviz: warning: {text}", file=sys.stderr)


def _newest(result: Result | None, texture: PassingTexture | None) -> Iterator[str]:
    """Force or status of the newest frame, and its shear if requested."""
    if result is None or result.estimate is None:
        return
    patch = result.trusted_patch
    yield result.estimate.status if patch is None else f"{np.linalg.norm(patch.force_n):.2f} N"
    if texture is not None:
        yield from (shear_line(result), texture.words)


def _recorder(
    stack: ExitStack, stream: LiveStream, out: str | Path | None, *, overwrite: bool
) -> Recorder | None:
    if out is None:
        return None
    replaces = stack.enter_context(replacing(out, stream.source, overwrite=overwrite))
    recorder = Recorder()
    recorder.start(out, replaces=replaces)

    def finish() -> None:
        status = recorder.stop()
        if status.problem:
            raise InputError(status.problem)

    stack.callback(finish)
    recorder.listen_to(stream)
    return recorder
