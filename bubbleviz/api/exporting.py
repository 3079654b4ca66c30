"""Export of frames as files for other programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from bubbleviz.api.estimating import (
    Recorded,
    SensorName,
    as_frames,
    path_of,
    pipeline_for,
    watch_texture,
)
from bubbleviz.api.estimator import FrameSolver, patch_options, solved
from bubbleviz.api.frames import Frames
from bubbleviz.api.results import OneBlasThread
from bubbleviz.api.summary import Summary
from bubbleviz.errors import check_type
from bubbleviz.files import refuse_input, whole_file
from bubbleviz.output import ExportPlan, read_poses
from bubbleviz.pipeline import SHEAR, FrameOptions, Pipeline, Product, stages
from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import AUTO
from bubbleviz.wording import count_of
from bubbleviz.zeros import Zeros, wrench_bias, zeros_of


@dataclass(frozen=True)
class ExportSummary(Summary):
    """Summary of an export."""

    out: str
    kinds: tuple[str, ...]
    frames: int
    files: int
    stages: Mapping[str, int]  # number of runs of each stage, without stages that did not run
    warning: str | None = None  # missing parts of the recording

    def to_text(self) -> str:
        """Text for the terminal."""
        ran = ", ".join(name for name in self.stages if name != "total") or "none"
        return f"wrote   {self._written}\nstages  {ran}"

    @property
    def _written(self) -> str:
        frames, files = count_of(self.frames, "frame"), count_of(self.files, "file")
        return f"{self.out}: {', '.join(self.kinds)} of {frames}, {files}"

    def __repr__(self) -> str:
        return f"<{self._written}>"


def export(
    frames: Recorded,
    out: str | Path,
    sensor: SensorName = AUTO,
    *,
    what: str | Sequence[str] = "",
    poses: str | Path | None = None,
    kappa: float | None = None,
    solver: str | None = None,
    friction: float | None = None,
    shear: bool = False,
    colour_delay_s: float | None = None,
    overwrite: bool = False,
    progress: Progress = quiet,
) -> ExportSummary:
    """Write tables, plots, meshes, points or pictures of a recording.

    Only products that the chosen files need are computed; depth pictures need no solve.

    Parameters
    ----------
    frames : sequence of Frame or path
    out : path
        TABLE.csv, TABLE.parquet, PLOTS.png (or .svg, .pdf), or a new folder for `what`.
    sensor, kappa, solver, friction, shear, colour_delay_s, progress
        As in `estimate`; with `shear`, tables and the LeRobot dataset have slip.
    what : str or sequence of str
        Files for the folder, separated by commas: table, parquet, plots, lerobot (dataset
        of one episode, v3.0), vtk (ParaView), ply, patch (points with pressure), depth, pressure
        (pictures; png for both).
    poses : path, optional
        POSES.csv of `track`, to join to the table.
    overwrite : bool
        Replace a file, or a folder of such files.

    Raises
    ------
    InputError
        An input does not exist or does not match the others, or `out` exists; then nothing is
        written.
    """
    check_type("what", what, str, Sequence)
    texts = [what] if isinstance(what, str) else what
    kinds = [word.strip() for text in texts for word in text.split(",") if word.strip()]
    joined = None if poses is None else read_poses(poses)
    plan = ExportPlan.of(out, kinds, joined, overwrite=overwrite)
    refuse_input(out, poses, path_of(frames))
    options = patch_options(kappa)
    with as_frames(frames) as chosen, OneBlasThread():
        _, pipeline = pipeline_for(chosen, sensor, solver, friction, colour_delay_s)
        refuse_input(out, *pipeline.model.sensor.files)
        if shear:
            watch_texture(chosen, pipeline)
        besides = SHEAR if shear else frozenset()
        summary = export_frames(chosen, pipeline, options, plan, progress, besides)
    return replace(summary, warning=chosen.note or None)


def export_frames(
    frames: Frames,
    pipeline: Pipeline,
    options: FrameOptions,
    plan: ExportPlan,
    progress: Progress = quiet,
    besides: frozenset[Product] = frozenset(),
    zeros: Zeros | None = None,
) -> ExportSummary:
    """Compute what the plan's files need, and the products `besides`, and write the files.

    Give a pipeline of its own, as it is warm-started from frame to frame. Zeros that are not given
    are searched. Nothing is written if an InputError or `Cancelled` is raised.
    """
    with whole_file(plan.out, overwrite=plan.overwrite) as temporary:
        if plan.is_folder:
            temporary.mkdir()
        bias_n = wrench_bias(frames.source, pipeline) if plan.has_table else None
        exporters = plan.exporters(pipeline, temporary, bias_n)
        products = besides.union(*(each.products for each in exporters))
        if zeros is None and "estimate" in stages(products):
            zeros = zeros_of(frames.source, pipeline)
        for result in solved(frames, FrameSolver(pipeline, products, options, zeros), progress):
            for each in exporters:
                each.add(result)
        for each in exporters:
            each.finish()
        files = sum(path.is_file() for path in temporary.rglob("*")) if plan.is_folder else 1
    return ExportSummary(str(plan.out), plan.kinds, len(frames), files, dict(pipeline.counts))
