"""The work of `bubbleviz export`: frames through the pipeline into files, whole or not at all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from bubbleviz.calibration.pressure_zero import zero_of
from bubbleviz.commands.estimate import parse_frames, patch_options
from bubbleviz.commands.summary import Summary
from bubbleviz.export.export_plan import ExportPlan
from bubbleviz.files.output_files import whole_file
from bubbleviz.frames.frame_source import FrameSource
from bubbleviz.frames.recording import Recording
from bubbleviz.frames.sensor_matching import fitting_sensor
from bubbleviz.inverse.estimator import EstimatorOptions
from bubbleviz.pipeline import FrameOptions, Pipeline, stages
from bubbleviz.progress import Progress, quiet
from bubbleviz.wording import count_of


@dataclass(frozen=True)
class ExportSummary(Summary):
    """Summary of an export.

    Attributes
    ----------
    out : str
    kinds : tuple of str
    frames, files : int
        How many were read, and written.
    stages : dict
        How often each stage of the pipeline ran; a stage that no kind needs is not there.
    warning : str or None
        What is missing of the recording.
    """

    out: str
    kinds: tuple[str, ...]
    frames: int
    files: int
    stages: Mapping[str, int]
    warning: str | None = None

    def to_text(self) -> str:
        """Text for the terminal."""
        ran = ", ".join(name for name in self.stages if name != "total") or "none"
        return (
            f"wrote   {self.out}: {', '.join(self.kinds)} of {count_of(self.frames, 'frame')}, "
            f"{count_of(self.files, 'file')}\nstages  {ran}"
        )


def export_recording(
    recording: str | Path,
    sensor_name: str | Path,
    plan: ExportPlan,
    *,
    frames: str | None = None,
    kappa: float | None = None,
    solver: str | None = None,
    friction: float | None = None,
    progress: Progress = quiet,
) -> ExportSummary:
    """Export frames of a recording; see `export_frames` and, for `frames`, `parse_frames`.

    Raises
    ------
    InputError
        Something given does not exist or does not fit together.
    """
    options = patch_options(kappa)
    with Recording(recording) as source:
        sensor_name, sensor = fitting_sensor(source, sensor_name)
        chosen = parse_frames(frames, len(source), str(source.path))
        pipeline = Pipeline.of(sensor, source.intrinsics, EstimatorOptions.named(solver, friction))
        summary = export_frames(source, chosen, pipeline, options, plan, progress)
        return replace(summary, warning=source.bag.note or None)


def export_frames(
    source: FrameSource,
    chosen: range,
    pipeline: Pipeline,
    options: FrameOptions,
    plan: ExportPlan,
    progress: Progress = quiet,
) -> ExportSummary:
    """Run the stages that the plan's kinds need on some frames, and write the files.

    Parameters
    ----------
    source : FrameSource
    chosen : range
        Indices of the frames.
    pipeline : Pipeline
        For this export alone: it warm-starts from frame to frame.
    options : FrameOptions
    plan : ExportPlan
    progress : Progress
        Told after each frame.

    Raises
    ------
    InputError
        `plan.out` exists or cannot be written, or a frame cannot be read; nothing is left then.
    Cancelled
        By `progress`; nothing is left then.
    """
    with whole_file(plan.out) as temporary:
        if plan.is_folder:
            temporary.mkdir()
        exporters = plan.exporters(pipeline, temporary)
        products = frozenset().union(*(each.products for each in exporters))
        pipeline.prepare(products)  # set-up is not part of the first frame's time
        zero = zero_of(source, pipeline) if "estimate" in stages(products) else None
        for done, index in enumerate(chosen, 1):
            frame = source[index] if zero is None else zero.applied(source[index])
            result = pipeline.process(frame, products, options)
            for each in exporters:
                each.add(result)
            progress("exporting", done / len(chosen))
        for each in exporters:
            each.finish()
        files = len(list(temporary.iterdir())) if plan.is_folder else 1
    return ExportSummary(str(plan.out), plan.kinds, len(chosen), files, dict(pipeline.counts))
