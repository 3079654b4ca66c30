"""Export of frames to files, as a job for a thread. No Qt in here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bubbleviz.commands.export import export_frames
from bubbleviz.export.export_plan import ExportPlan
from bubbleviz.inverse.estimator import EstimatorOptions
from bubbleviz.pipeline import FrameOptions, Pipeline
from bubbleviz.wording import count_of

if TYPE_CHECKING:
    from bubbleviz.frames.frame_source import FrameSource
    from bubbleviz.progress import Progress
    from bubbleviz.sensor import Sensor


@dataclass(frozen=True)
class FileExport:
    """Exports frames of a source that it opens anew, so that the window's is left alone.

    Attributes
    ----------
    open_source : callable
    sensor : Sensor
    frames : range
    out : Path
    what : str
        Of `bubbleviz.export.export_plan.KINDS` for a folder; empty: the suffix of `out` says it.
    kappa, least_area_m2
        As in `Choices`.
    estimator : EstimatorOptions
    poses : dict
        Pose columns by frame, see `bubbleviz.export.pose_columns`.
    """

    open_source: Callable[[Sensor], FrameSource]
    sensor: Sensor
    frames: range
    out: Path
    what: str
    kappa: float | None
    least_area_m2: float
    estimator: EstimatorOptions
    poses: dict[int, dict[str, Any]]

    def __call__(self, progress: Progress) -> str:
        """Export; returns what was done, in a sentence.

        Raises
        ------
        InputError
            A file exists or cannot be written, or a frame cannot be read.
        Cancelled
            By `progress`; nothing is left then.
        """
        plan = ExportPlan.of(self.out, [self.what] if self.what else [], self.poses)
        progress("opening", 0.0)
        source = self.open_source(self.sensor)
        try:
            intrinsics = source[self.frames[0]].intrinsics
            pipeline = Pipeline.of(self.sensor, intrinsics, self.estimator)
            options = FrameOptions(self.kappa, self.least_area_m2)
            done = export_frames(source, self.frames, pipeline, options, plan, progress)
        finally:
            source.close()
        files = "" if not plan.is_folder else f", {count_of(done.files, 'file')}"
        return f"Exported {count_of(done.frames, 'frame')} to {done.out}{files}"
