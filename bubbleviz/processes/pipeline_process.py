"""Pipeline in a separate process, on another core."""

from __future__ import annotations

import time
from dataclasses import replace
from threading import Event, Thread

import numpy as np

from bubbleviz.camera import Intrinsics
from bubbleviz.inverse import EstimatorOptions
from bubbleviz.pipeline import FrameOptions, Pipeline, Product
from bubbleviz.processes.worker_process import Outcome, WorkerProcess
from bubbleviz.recordings import Frame
from bubbleviz.result import Result
from bubbleviz.sensor import Sensor

OF_DEPTH: frozenset[Product] = frozenset({"estimate", "patch", "pixel_mask", "cloud", "residual"})
"""Products that depth image and gas pressure are enough for."""
PATIENCE_S = 5.0  # a frame takes longer than this only in a process that hangs; chosen


class PipelineProcess:
    """Solves frames of a live source in another process, independent of this one's threads.

    The process is started with the first frame. Frames are solved here until it is built, whenever
    something is asked for that depth alone does not tell, and for good once it has died or hung.
    """

    def __init__(
        self,
        # the one here; the other is built alike, and each keeps a warm start of its own
        pipeline: Pipeline,
        patience_s: float = PATIENCE_S,  # how long a frame may take before the process is ended
    ) -> None:
        self.lost = ""  # how the process ended unexpectedly; else empty
        self._pipeline = pipeline
        self._patience_s = patience_s
        self._worker = WorkerProcess()
        self._built = self._started = False
        self._busy_since_s: float | None = None
        self._hung = False
        self._over = Event()
        self._watcher: Thread | None = None

    @property
    def pid(self) -> int | None:
        """Process id once frames are solved there; else None."""
        return self._worker.pid if self._built else None

    def process(
        self, frame: Frame, products: frozenset[Product], options: FrameOptions | None = None
    ) -> Result:
        """Do what `Pipeline.process` does, there or here; errors as there."""
        if not self._started and not self._over.is_set():
            self._start(products)
        if not self._is_built() or not products <= OF_DEPTH:
            return self._pipeline.process(frame, products, options)
        seen = Frame(frame.index, frame.time_s, frame.depth_m, None, frame.gas_pressure_pa)
        outcome = self._call(seen, products, options)
        if outcome.kind != "returned":
            return self._pipeline.process(frame, products, options)  # raises what was raised there
        result: Result = outcome.value
        self._pipeline.counts.update(result.times_ms.keys())
        return replace(result, frame=self._pipeline.paired(frame))

    def end(self) -> None:
        """End the process, whatever it does, from any thread; what comes is solved here."""
        self._over.set()
        self._worker.kill()

    def close(self) -> None:
        """End the process and wait until it is gone; from the thread that has frames solved."""
        self._built = False
        self._over.set()
        self._worker.stop()
        if self._watcher is not None:
            self._watcher.join()  # it sees that it is over at once

    def _start(self, products: frozenset[Product]) -> None:
        self._started = True
        model, options = self._pipeline.model, self._pipeline.options
        intrinsics = self._pipeline.camera.intrinsics
        asked = products & OF_DEPTH
        self._worker.send(_prepared, model.sensor, intrinsics, options, asked, keep=True)
        if self._over.is_set():  # meanwhile, when there was nothing to end yet
            self._worker.kill()

    def _is_built(self) -> bool:
        """Whether the process is ready to solve; does not wait."""
        if self._built or self._over.is_set() or not self._worker.pipe.poll():
            return self._built
        if self._returned(self._worker.outcome()):
            self._built = True
            self._watcher = Thread(target=self._watch, name="solver watch", daemon=True)
            self._watcher.start()
        return self._built

    def _call(self, *args: object) -> Outcome:
        self._busy_since_s = time.monotonic()
        self._worker.send(_solved, *args)
        outcome = self._worker.outcome()
        self._busy_since_s = None
        self._returned(outcome)
        return outcome

    def _returned(self, outcome: Outcome) -> bool:
        """Whether a call went well; without its process, or its pipeline, it is over."""
        if outcome.kind == "died" or (outcome.kind == "raised" and not self._built):
            if not self._over.is_set():
                self.lost = (
                    f"no answer for {self._patience_s:g} s" if self._hung else outcome.detail
                )
            self.close()
        return outcome.kind == "returned"

    def _watch(self) -> None:
        """End a process that hangs, so that the waiting caller learns that it died.

        A thread of its own: a frame may also wait for the process while it is sent.
        """
        while not self._over.wait(0.2 * self._patience_s):
            since_s = self._busy_since_s
            if since_s is not None and time.monotonic() - since_s > self._patience_s:
                self._hung = True
                self._worker.kill()


def _prepared(
    sensor: Sensor, intrinsics: Intrinsics, options: EstimatorOptions, products: frozenset[Product]
) -> Pipeline:
    pipeline = Pipeline.of(sensor, intrinsics, options)
    pipeline.prepare(products)
    return pipeline


def _solved(
    pipeline: Pipeline, frame: Frame, products: frozenset[Product], options: FrameOptions | None
) -> Result:
    """Products of a frame; its image is not sent back."""
    result = pipeline.process(frame, products, options)
    return replace(result, frame=replace(frame, depth_m=np.zeros((0, 0), np.float32)))
