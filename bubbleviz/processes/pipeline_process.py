"""Pipeline in a separate process, to use another core."""

from __future__ import annotations

import os
import time
from dataclasses import replace
from threading import Event, Thread

import numpy as np

from bubbleviz.averaging import StillFrames
from bubbleviz.camera import Intrinsics
from bubbleviz.inverse import EstimatorOptions
from bubbleviz.pipeline import FrameOptions, Pipeline, Product
from bubbleviz.processes.worker_process import Outcome, WorkerProcess
from bubbleviz.recordings import Frame
from bubbleviz.result import Result
from bubbleviz.sensor import Sensor
from bubbleviz.zeros import Zeros

DEPTH_PRODUCTS: frozenset[Product] = frozenset(
    {"estimate", "patch", "pixel_mask", "cloud", "residual"}
)
"""Products that depend on depth image and gas pressure alone."""
TIMEOUT_S = 5.0  # for one frame, before the process is killed; chosen
_NICENESS = 10
"""Lower priority than the window's: with two cameras on two cores, this is blocked for up to 42
instead of 59 ms (99 of 100), at the same rate of solved frames."""

_FOUND = ("images", "mean_noise", "gas_pressure_pa", "gas_sigma_pa")
"""What solving changes in a frame: images averaged, their noise, and an uncertain gas pressure."""


class PipelineProcess:
    """Solves frames of a live source in a worker process, independent of this process's threads.

    Each is averaged there with those before that show the same. The worker starts with the first
    frame. Frames are solved locally until it is ready, whenever a product needs more than depth and
    gas pressure, and permanently once it has died or hung.
    """

    def __init__(
        self,
        pipeline: Pipeline,  # the local one; the worker builds its own, with its own warm start
        still: StillFrames | None = None,  # averages the frames that are solved locally
        timeout_s: float = TIMEOUT_S,  # for one frame, before the worker is killed
    ) -> None:
        self.lost = ""  # reason if the worker ended unexpectedly; else empty
        self._pipeline, self._still = pipeline, still
        self._timeout_s = timeout_s
        self._worker = WorkerProcess()
        self._ready = self._started = False
        self._busy_since_s: float | None = None
        self._hung = False
        self._closed = Event()
        self._watchdog: Thread | None = None

    @property
    def pid(self) -> int | None:
        """Process id of the worker once it is ready; else None."""
        return self._worker.pid if self._ready else None

    def process(
        self, frame: Frame, products: frozenset[Product], options: FrameOptions | None = None
    ) -> Result:
        """As `Pipeline.process`, with the same errors, in the worker or locally."""
        if not self._started and not self._closed.is_set():
            self._start(products)
        if not self._is_ready() or not products <= DEPTH_PRODUCTS:
            return self._process_here(frame, products, options)
        small = replace(frame, intrinsics=None, find_colour=None)
        self._busy_since_s = time.monotonic()
        self._worker.send(_solved, small, products, options)
        outcome = self._worker.outcome()
        self._busy_since_s = None
        if not self._returned(outcome):
            return self._process_here(frame, products, options)  # raises the same exception
        result: Result = outcome.value
        self._pipeline.counts.update(result.times_ms.keys())
        found = {name: getattr(result.frame, name) for name in _FOUND}
        return replace(result, frame=self._pipeline.paired(replace(frame, **found)))

    def _process_here(
        self, frame: Frame, products: frozenset[Product], options: FrameOptions | None
    ) -> Result:
        frame = frame if self._still is None else self._still.applied(frame)
        return self._pipeline.process(frame, products, options)

    def end(self) -> None:
        """Kill the worker, from any thread; later frames are solved locally."""
        self._closed.set()
        self._worker.kill()

    def close(self) -> None:
        """Kill the worker and wait for its end, from the thread that calls `process`."""
        self._ready = False
        self._closed.set()
        self._worker.stop()
        if self._watchdog is not None:
            self._watchdog.join()  # returns at once, as the event is set

    def _start(self, products: frozenset[Product]) -> None:
        self._started = True
        model, options = self._pipeline.model, self._pipeline.options
        intrinsics = self._pipeline.camera.intrinsics
        requested = products & DEPTH_PRODUCTS
        self._worker.send(_prepared, model.sensor, intrinsics, options, requested, keep=True)
        if self._closed.is_set():  # by another thread, before the worker had started
            self._worker.kill()

    def _is_ready(self) -> bool:
        """Whether the worker can solve frames; does not wait."""
        if self._ready or self._closed.is_set() or not self._worker.pipe.poll():
            return self._ready
        if self._returned(self._worker.outcome()):
            self._ready = True
            self._watchdog = Thread(target=self._watch, name="solver watchdog", daemon=True)
            self._watchdog.start()
        return self._ready

    def _returned(self, outcome: Outcome) -> bool:
        """Whether a call returned; closes if the worker died or could not build its pipeline."""
        if outcome.kind == "died" or (outcome.kind == "raised" and not self._ready):
            if not self._closed.is_set():
                self.lost = f"no answer for {self._timeout_s:g} s" if self._hung else outcome.detail
            self.close()
        return outcome.kind == "returned"

    def _watch(self) -> None:
        """Kill a worker that hangs, so that the waiting caller receives its end.

        In a thread, as the caller may also block while it sends a frame.
        """
        while not self._closed.wait(0.2 * self._timeout_s):
            since_s = self._busy_since_s
            if since_s is not None and time.monotonic() - since_s > self._timeout_s:
                self._hung = True
                self._worker.kill()


def _prepared(
    sensor: Sensor, intrinsics: Intrinsics, options: EstimatorOptions, products: frozenset[Product]
) -> tuple[Pipeline, Zeros]:
    os.nice(_NICENESS)
    pipeline = Pipeline.of(sensor, intrinsics, options)
    pipeline.prepare(products)
    return pipeline, Zeros.of_stream(None, pipeline)


def _solved(
    prepared: tuple[Pipeline, Zeros],
    frame: Frame,
    products: frozenset[Product],
    options: FrameOptions | None,
) -> Result:
    """Products of a frame, without its images."""
    pipeline, zeros = prepared
    result = pipeline.process(zeros.applied(frame), products, options)
    depth_m = np.zeros((0, 0), np.float32)
    return replace(result, frame=replace(result.frame, depth_m=depth_m, mean_depth_m=None))
