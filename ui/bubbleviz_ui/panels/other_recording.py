"""Another recording, or the same with another sensor file, on the time axis of the open one.

No Qt in here.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from bubbleviz.api.comparing import Alignment, Comparison, compare
from bubbleviz.api.estimator import PRODUCTS, FrameSolver, solved
from bubbleviz.api.frames import Frames
from bubbleviz.api.results import OneBlasThread, Run
from bubbleviz.diagnostics import numbers_of
from bubbleviz.inverse import EstimatorOptions
from bubbleviz.pipeline import FrameOptions, Pipeline
from bubbleviz.progress import Progress
from bubbleviz.sensor import Sensor
from bubbleviz.zeros import zeros_of
from bubbleviz_ui.engine.source import Source
from bubbleviz_ui.model.frame_history import FrameHistory


def solve(
    source: Source,
    open_sensor: Callable[[], Sensor],
    options: EstimatorOptions,
    rule: FrameOptions,
    progress: Progress,
    *,
    keep: bool,  # Keep the results for drawing the membrane: about 100 kB a frame
) -> Run:
    """Solve all frames of a source, opened separately; in a thread."""
    sensor = open_sensor()
    with closing(source.open(sensor)) as opened, OneBlasThread():
        frames = Frames(opened)
        pipeline = Pipeline.of(sensor, frames[0].intrinsics, options)
        zeros = zeros_of(opened, pipeline)
        run = Run(pipeline.model, {"recording": source.title}, {})
        step = partial(_titled, progress, source.title)
        for result in solved(frames, FrameSolver(pipeline, PRODUCTS, rule, zeros), step):
            run.add(result, keep=keep)
    return run


def _titled(progress: Progress, title: str, _: str, done: float) -> None:
    progress(title, done)


@dataclass(frozen=True)
class AlignedRun:
    """The other run, at the times of the open recording."""

    found: Comparison
    facts: dict[str, Any]  # Of the comparison
    run: Run
    times_s: np.ndarray  # (F,) of its frames
    history: FrameHistory

    @classmethod
    def of(cls, first: Run, other: Run, align: Alignment) -> AlignedRun:
        """Align two runs. Raises InputError: No common time, or no contact to align by."""
        found, history = compare(first, other, align=align), FrameHistory(len(other))
        for k, each in enumerate(other):
            history.record(k, numbers_of(each.result, other.model.gas), patch=True)
        return cls(found, found.facts(), other, other.times_s - found.shift_s, history)
