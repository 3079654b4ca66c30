"""The work of `bubbleviz pose`: a recording through the pipeline into POSES.csv, no window."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from tqdm import tqdm

from bubbleviz.calibration.pressure_zero import PressureZero, zero_of
from bubbleviz.commands.estimate import parse_frames
from bubbleviz.commands.summary import Summary
from bubbleviz.errors import InputError
from bubbleviz.files.output_files import refuse_existing, whole_file
from bubbleviz.files.pose_reader import parse_pose
from bubbleviz.files.pose_writer import PoseRow
from bubbleviz.files.tables import write_rows
from bubbleviz.frames.frame_source import FrameSource, shown_name
from bubbleviz.frames.recording import Recording
from bubbleviz.frames.sensor_matching import fitting_sensor
from bubbleviz.inverse.estimator import EstimatorOptions
from bubbleviz.pipeline import OF_OBJECT, Pipeline, Product
from bubbleviz.result import PoseStatus, Result
from bubbleviz.rigid_object import load_object

PRODUCTS: frozenset[Product] = frozenset({"pose"})


@dataclass(frozen=True)
class PoseSummary(Summary):
    """Summary of `pose`; None for statistics without frames.

    Attributes
    ----------
    recording, sensor, object, out : str
    frames : int
    status : dict
        Number of frames by status.
    median_fitness, median_rmse_m : float or None
        Over the frames with a pose.
    median_total_ms, p95_total_ms : float or None
        Depth image in → pose out over the frames after the first with a pose, ms.
    median_patch_area_m2, median_object_patch_area_m2 : float or None
        By the contact pressure and by the object, over the frames that have both.
    warning : str or None
        What is missing of the recording.
    """

    recording: str
    sensor: str
    object: str
    out: str
    frames: int
    status: dict[str, int]
    median_fitness: float | None
    median_rmse_m: float | None
    median_total_ms: float | None
    p95_total_ms: float | None
    median_patch_area_m2: float | None
    median_object_patch_area_m2: float | None
    warning: str | None

    def to_text(self) -> str:
        """Text for the terminal, with units."""
        status = ", ".join(f"{count} {name}" for name, count in self.status.items())
        lines = [f"wrote   {self.out}", f"frames  {self.frames}: {status}"]
        if self.median_fitness is not None and self.median_rmse_m is not None:
            lines.append(
                f"fit     {100 * self.median_fitness:.0f} % of the patch on the object, "
                f"rmse {1e3 * self.median_rmse_m:.2f} mm (medians)"
            )
        if self.median_total_ms is not None:
            lines.append(
                f"time    depth image in → pose out while tracking: {self.median_total_ms:.1f} ms "
                f"median, {self.p95_total_ms:.1f} ms p95"
            )
        if self.median_patch_area_m2 is not None and self.median_object_patch_area_m2 is not None:
            lines.append(
                f"patch   {1e6 * self.median_patch_area_m2:.0f} mm² by the contact pressure, "
                f"{1e6 * self.median_object_patch_area_m2:.0f} mm² by the object (medians)"
            )
        return "\n".join(lines)


def pose_recording(
    recording: str | Path,
    sensor_name: str | Path,
    object_name: str | Path,
    out: Path,
    *,
    init: str | None = None,
    unit: Literal["m", "mm"] | None = None,
    solver: str | None = None,
    friction: float | None = None,
    frames: str | None = None,
    object_patch: bool = False,
) -> PoseSummary:
    """Follow an object through the frames of a recording and write POSES.csv.

    Parameters
    ----------
    recording, sensor_name, object_name : str or path
    out : Path
        May not exist.
    init : str, optional
        T_B_O in the first frame as `parse_pose` reads it; searched for by default.
    unit : {"m", "mm"}, optional
        Unit of the object's file.
    solver : str, optional
        Of the inverse problem.
    friction : float, optional
        Coefficient of friction to expect of contacts.
    frames : str, optional
        As in `parse_frames`.
    object_patch : bool, optional
        Find the patch by the object, too; its area and that of the patch become columns.

    Raises
    ------
    InputError
        Something given does not exist or does not fit together, or no frame has a pose.
    """
    refuse_existing(out)
    start = None if init is None else parse_pose(init)
    obj = load_object(object_name, unit)
    with Recording(recording) as source:
        sensor_name, sensor = fitting_sensor(source, sensor_name)
        chosen = parse_frames(frames, len(source), str(source.path))
        pipeline = Pipeline.of(sensor, source.intrinsics, EstimatorOptions.named(solver, friction))
        pipeline.follow(obj, start)
        rows = _follow(source, chosen, pipeline, out, object_patch=object_patch)
        warning = source.bag.note or None
    return PoseSummary(
        recording=str(recording),
        sensor=str(sensor_name),
        object=str(object_name),
        out=str(out),
        frames=len(rows),
        status=dict(Counter(row.status for row in rows)),
        warning=warning,
        **_statistics([row for row in rows if row.status == "ok"]),
    )


def _follow(
    source: Recording, chosen: range, pipeline: Pipeline, out: Path, *, object_patch: bool
) -> list[PoseRow]:
    products = OF_OBJECT if object_patch else PRODUCTS
    zero = zero_of(source, pipeline)
    with whole_file(out) as temporary:
        shown = tqdm(chosen, unit="frame", disable=None)  # only on a terminal
        rows = [PoseRow.of(each) for each in followed(source, shown, pipeline, products, zero)]
        write_rows(temporary, [row.columns(areas=object_patch) for row in rows])
    return rows


def followed(
    source: FrameSource,
    chosen: Iterable[int],
    pipeline: Pipeline,
    products: frozenset[Product] = PRODUCTS,
    zero: PressureZero | None = None,
) -> Iterator[Result]:
    """Results of frames with the pose of the object that a pipeline follows.

    A zero is taken from the measured gas pressures.

    Raises
    ------
    InputError
        A frame cannot be read or, after the last one, none of them had a pose.
    """
    statuses: Counter[PoseStatus] = Counter()
    for index in chosen:
        frame = source[index] if zero is None else zero.applied(source[index])
        result = pipeline.process(frame, products)
        if result.pose is not None:
            statuses[result.pose.status] += 1
        yield result
    if "ok" not in statuses:
        why = statuses.most_common(1)[0][0]
        raise InputError(f"{shown_name(source)}: no pose in any frame asked for: {_REASONS[why]}")


_REASONS: dict[PoseStatus, str] = {
    "no_contact": "nothing touches the membrane; choose frames with contact",
    "few_points": "the contact patch has fewer points than a pose needs; press deeper",
    "no_data": "no estimate of the membrane to trust; try bubbleviz estimate first",
    "lost": "the object does not fit the contact; check the object, its unit and --init",
}


def _statistics(good: list[PoseRow]) -> dict[str, float | None]:
    """Medians over the frames with a pose."""
    times = [row.total_ms for row in good[1:]]
    areas = [(row.patch_area_m2, row.object_patch_area_m2) for row in good]
    both = [pair for pair in areas if np.isfinite(pair).all()]
    patch, by_object = np.median(both, axis=0).tolist() if both else (None, None)
    return {
        "median_fitness": float(np.median([row.fitness for row in good])),
        "median_rmse_m": float(np.median([row.rmse_m for row in good])),
        "median_total_ms": float(np.median(times)) if times else None,
        "p95_total_ms": float(np.percentile(times, 95.0)) if times else None,
        "median_patch_area_m2": patch,
        "median_object_patch_area_m2": by_object,
    }
