"""Export of frames to files; runs in a thread. No Qt."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bubbleviz.api.exporting import export_frames
from bubbleviz.api.frames import Frames
from bubbleviz.inverse import EstimatorOptions
from bubbleviz.output import ExportPlan
from bubbleviz.pipeline import FLOW_PRODUCTS, FrameOptions, Pipeline
from bubbleviz.wording import count_of
from bubbleviz_ui.engine.shear_reference import ShearReference
from bubbleviz_ui.model.demand import Demand

if TYPE_CHECKING:
    from bubbleviz.progress import Progress
    from bubbleviz.recordings import FrameSource
    from bubbleviz.sensor import Sensor
    from bubbleviz.zeros import Zeros


def export_to_files(
    open_source: Callable[[Sensor], FrameSource],
    sensor: Sensor,
    frames: range,
    out: Path,
    # For a folder: key of `bubbleviz.output.export_plan.KINDS`; empty: from the suffix of `out`
    what: str,
    demand: Demand,  # Of the window: rule of the patch, and whether forces use colour images
    estimator: EstimatorOptions,
    zeros: Zeros | None,  # Of the window's recording; None for other sources
    poses: dict[int, dict[str, Any]],  # Pose columns by frame, see `bubbleviz.output.pose_writer`
    progress: Progress,
) -> str:
    """Export frames of a source, which is opened separately from the window's.

    Returns str: Summary, one sentence.

    Raises InputError: A file exists or cannot be written, or a frame cannot be read; Cancelled: By
    `progress`; unfinished files are removed.
    """
    plan = ExportPlan.of(out, [what] if what else [], poses)
    progress("opening", 0.0)
    source = open_source(sensor)
    try:
        pipeline = Pipeline.of(sensor, source[frames[0]].intrinsics, estimator)
        besides = ShearReference().products(source, pipeline, demand) & FLOW_PRODUCTS
        if zeros is not None:
            zeros = zeros.of_copy(source, pipeline)
        how = FrameOptions(*demand.patch_rule), plan, progress, besides, zeros
        done = export_frames(Frames(source, frames), pipeline, *how)
        by_colour = pipeline.optical_flow is not None
    finally:
        source.close()
    forces = f", forces by depth{' and colour' * by_colour}" if demand.flow else ""
    files = "" if not plan.is_folder else f", {count_of(done.files, 'file')}"
    return f"Exported {count_of(done.frames, 'frame')} to {done.out}{files}{forces}"
