"""Estimation of contact and tracking of objects, in one frame, in recordings, and live."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from types import EllipsisType
from typing import TYPE_CHECKING, Any, Literal, TypedDict, Unpack, overload

import numpy as np

import bubbleviz
from bubbleviz.api.estimator import (
    FrameSolver,
    given_pose,
    patch_options,
    refuse_frictionless_shear,
    solved,
)
from bubbleviz.api.frame_warnings import NO_FRAME_FITS
from bubbleviz.api.frames import Frames, open
from bubbleviz.api.results import FrameResult, OneBlasThread, Run
from bubbleviz.camera import Intrinsics
from bubbleviz.errors import InputError, check_given, given_path
from bubbleviz.files import pose_numbers, refuse_existing, refuse_input
from bubbleviz.inverse import EstimatorOptions
from bubbleviz.pipeline import SHEAR, Pipeline, Product
from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import (
    AUTO,
    EqualImages,
    Frame,
    HeldFrames,
    Recording,
    find_contact_free,
    fitting_sensor,
    has_returns,
    shown_name,
)
from bubbleviz.result import TRUSTED, Estimate, Pose, PoseStatus, Result
from bubbleviz.rigid_object import RigidObject, load_object
from bubbleviz.sensor import Sensor, load_sensor, sensor_to_toml, with_colour_delay
from bubbleviz.wording import count_of
from bubbleviz.zeros import SEARCH_POINTS, Zeros, wrench_bias, zeros_of

if TYPE_CHECKING:
    from bubbleviz.live import LiveStream

SensorName = str | Path | Sensor
Recorded = Sequence[Frame] | str | Path
"""Frames, or the path of a recording."""
_PRODUCTS: frozenset[Product] = frozenset({"estimate", "patch"})
"""Pixels of the patch are computed on first use, or for a file."""


class Solving(TypedDict, total=False):
    """Options of both `estimate` and `track`."""

    solver: str | None
    friction: float | None
    zero_gas: bool
    out: str | Path | None
    overwrite: bool
    timeout_s: float | EllipsisType | None
    progress: Progress


class Estimating(Solving, total=False):
    """Options of `estimate`."""

    kappa: float | None
    shear: bool
    colour_delay_s: float | None
    csv: str | Path | None


class Tracking(Solving, total=False):
    """Options of `track`."""

    init: str | np.ndarray | None
    unit: Literal["m", "mm"] | None
    object_patch: bool


@overload
def estimate(
    frames: Frame, sensor: SensorName = AUTO, **options: Unpack[Estimating]
) -> FrameResult: ...
@overload
def estimate(frames: Recorded, sensor: SensorName = AUTO, **options: Unpack[Estimating]) -> Run: ...
@overload
def estimate(
    frames: LiveStream, sensor: SensorName = AUTO, **options: Unpack[Estimating]
) -> Iterator[FrameResult]: ...
def estimate(
    frames: Frame | Recorded | LiveStream,
    sensor: SensorName = AUTO,
    *,
    kappa: float | None = None,
    solver: str | None = None,
    friction: float | None = None,
    zero_gas: bool = True,
    shear: bool = False,
    colour_delay_s: float | None = None,
    out: str | Path | None = None,
    csv: str | Path | None = None,
    overwrite: bool = False,
    timeout_s: float | EllipsisType | None = ...,
    progress: Progress = quiet,
) -> FrameResult | Run | Iterator[FrameResult]:
    """Estimate contact pressure, patch and force in every frame.

    Solves Eq. 23, or the exact membrane. Each frame starts from the solution of the previous one.

    Parameters
    ----------
    frames : Frame, sequence of Frame, path or LiveStream
        Returned by `open`, `simulate` or `connect`, a slice of it, or the path of a recording. A
        `Frame` is estimated by itself; the slice `frames[k : k + 1]` also by the images around it
        and the zeros of its recording. For arrays use `Estimator`.
    sensor : str, path or Sensor
        Sensor file or preset; `auto`: the preset whose camera has the images' size, or the
        stream's sensor.
    kappa : float, optional
        Threshold of the patch as a multiple of the mean contact pressure (section V-C of the
        paper); automatic by default.
    solver : str, optional
        `rubber`: exact membrane, default if the sensor has a pre-stretch; `linear`: constant
        tension, default otherwise; `fast`: linear on a coarse mesh; `paper`: the paper's QP by
        OSQP; `rubber-base`, `linear-base`: without the finer mesh at the contact.
    friction : float, optional
        Expected coefficient of friction on the exact membrane, 1 by default; 0 for no friction.
    zero_gas : bool
        Shift the measured gas pressure so that contact-free frames agree with the sensor file.
        Without such frames the interval of the force includes ±2 kPa of weather, or ±10 kPa if the
        file has the standard atmosphere. If off, the gas pressure is used as measured.
    shear : bool
        Estimate force, with friction at every node, and slip from depth and colour images together.
    colour_delay_s : float, optional
        Stamp of a colour image minus that of the depth image of the same scene, s; negative if
        colour leads depth, at most ±0.5 s. By default the sensor file's, else 0.
    out : path, optional
        Results of all frames, RESULT.npz, written frame by frame and then not kept in memory.
    csv : path, optional
        Table with one row per frame, RESULT.csv, also written frame by frame.
    overwrite : bool
        Replace existing files.
    timeout_s : float, optional
        Longest time without a frame of a stream, s; by default that of `connect`, None: no limit.
    progress : Progress

    Returns
    -------
    FrameResult, Run or iterator of FrameResult
        For a frame, for frames, and for a stream (its newest frame each time).

    Raises
    ------
    InputError
        Sensor and frames do not match, no frame has data, or a file exists.
    StreamStoppedError
        No frame of a stream arrived within `timeout_s` (an `InputError`, too).

    Examples
    --------
    >>> run = bv.estimate("press.mcap")
    >>> run = bv.estimate(bv.open("press.mcap")[60:90])
    >>> run.force_n.shape
    (30, 3)
    """
    options = patch_options(kappa)
    solving: dict[str, Any] = {"solver": solver, "friction": friction, "zero_gas": zero_gas}
    if not isinstance(frames, Frame | Sequence | Path):
        solving |= {"kappa": kappa, "shear": shear, "colour_delay_s": colour_delay_s}
        return _watched(frames, sensor, timeout_s, out, csv, **solving)
    if csv is not None and out is None:
        raise InputError(f"{csv}: a CSV is written only with a RESULT.npz; set out as well")
    _check_outputs(frames, (out, ".npz"), (csv, ".csv"), overwrite=overwrite)
    with as_frames(frames) as chosen, OneBlasThread():
        name, pipeline = pipeline_for(chosen, sensor, solver, friction, colour_delay_s)
        for path in (out, csv):
            refuse_input(path, *pipeline.model.sensor.files)
        texture, products = None, _PRODUCTS
        if shear:
            texture, products = watch_texture(chosen, pipeline), products | SHEAR
        zeros, run = _new_run(chosen, name, pipeline, solver, zero_gas, out)
        run.context |= {
            "solver": run.provenance["solver"],
            "kappa": kappa,
            "texture": texture,
            "gas_zero": None if zeros.gas is None else zeros.gas.words,
        }
        any_depth, equal = False, EqualImages()
        if out is not None:
            products |= {"pixel_mask"}
        with run.files(out, csv, overwrite=overwrite, frames=len(chosen)) as write:
            frame_solver = FrameSolver(pipeline, products, options, zeros)
            for result in _results(chosen, frame_solver, progress):
                equal.take(result.frame.depth_m)
                any_depth = any_depth or has_returns(result.frame.depth_m)
                write(result)
                run.add(result, keep=out is None)
            _check_any_data(run, any_depth)
        run.warn(chosen.note, *frame_solver.warnings(), equal.warning)
    return FrameResult(result, pipeline.model) if isinstance(frames, Frame) else run


def register(
    frame: Frame,
    object: str | Path | RigidObject,
    sensor: SensorName = AUTO,
    **options: Unpack[Tracking],
) -> FrameResult:
    """Find the pose of a known object in one frame, by dual-stage registration.

    Parameters
    ----------
    frame : Frame
    object, sensor
        As in `track`.
    **options
        `init`, `unit`, `solver`, `friction` and `object_patch` of `track`. `init` must be right to
        about 5 mm and 10°; by default it is searched.

    Returns
    -------
    FrameResult
        With `T_B_O` (4, 4), and `pose` with covariance and undetermined motions.

    Raises
    ------
    InputError
        An input does not exist or does not match the others, or no pose was found.
    """
    return track([frame], object, sensor, **options)[0]


@overload
def track(
    frames: Recorded,
    object: str | Path | RigidObject,
    sensor: SensorName = AUTO,
    **options: Unpack[Tracking],
) -> Run: ...
@overload
def track(
    frames: LiveStream,
    object: str | Path | RigidObject,
    sensor: SensorName = AUTO,
    **options: Unpack[Tracking],
) -> Iterator[FrameResult]: ...
def track(
    frames: Recorded | LiveStream,
    object: str | Path | RigidObject,
    sensor: SensorName = AUTO,
    *,
    init: str | np.ndarray | None = None,
    unit: Literal["m", "mm"] | None = None,
    solver: str | None = None,
    friction: float | None = None,
    zero_gas: bool = True,
    object_patch: bool = False,
    out: str | Path | None = None,
    overwrite: bool = False,
    timeout_s: float | EllipsisType | None = ...,
    progress: Progress = quiet,
) -> Run | Iterator[FrameResult]:
    """Find the pose of a known object in every frame.

    Parameters
    ----------
    frames : sequence of Frame, path or LiveStream
    object : str, path or RigidObject
        Mesh file or preset.
    sensor, solver, friction, zero_gas, timeout_s, progress
        As in `estimate`.
    init : str or (4, 4) array, optional
        T_B_O in the first frame, "x y z qx qy qz qw"; by default it is searched.
    unit : {"m", "mm"}, optional
        Unit of the object's mesh file; by default mm if its name ends in `_mm`, else m.
    object_patch : bool
        Also compute the patch from the object's surface; adds columns of both areas.
    out : path, optional
        Poses, POSES.csv; other results are then not kept in memory.
    overwrite : bool
        Replace an existing file.

    Returns
    -------
    Run or iterator of FrameResult
        With `T_B_O`, `poses` and columns `pose_…`; a pose that is `lost` is the last good one.

    Raises
    ------
    InputError
        An input does not exist or does not match the others, or no frame has a pose.
    """
    from bubbleviz.api.pose_search import with_poses  # estimates alone do not load it

    initial_pose = given_pose(init)
    obj = load_object(object, unit)
    solving: dict[str, Any] = {"solver": solver, "friction": friction, "zero_gas": zero_gas}
    if not isinstance(frames, Sequence | Path):
        return _watched(frames, sensor, timeout_s, out, object=obj, init=initial_pose, **solving)
    _check_outputs(frames, (out, ".csv"), overwrite=overwrite)
    with as_frames(frames) as chosen, OneBlasThread():
        name, pipeline = pipeline_for(chosen, sensor, solver, friction)
        refuse_input(out, *pipeline.model.sensor.files)
        pipeline.track(obj, initial_pose, thorough=True)
        zeros, run = _new_run(chosen, name, pipeline, solver, zero_gas, out)
        run.context["object"] = obj.name if isinstance(object, RigidObject) else str(object)
        frame_solver = FrameSolver(pipeline, frozenset({"patch"}), zeros=zeros)
        ambiguous: list[tuple[int, Pose]] = []
        contradicted: list[tuple[float, float]] = []
        for result in with_poses(_results(chosen, frame_solver, progress), pipeline, progress):
            if object_patch:
                result = pipeline.extended(result, "object_patch")
            run.add(result, keep=out is None)
            pose = result.pose
            if pose is not None and pose.status == "ok" and len(pose.others):
                ambiguous.append((result.frame.index, pose))
            if pose is not None and pose.status == "ok" and pose.contradicted:
                contradicted.append((pose.distance_rms_m, pose.distance_limit_m))
        told = (*frame_solver.warnings(), _other_poses(ambiguous), _other_object(contradicted))
        run.warn(chosen.note, *told)
        _check_any_pose(run)
    if out is not None:
        run.save_poses(out, overwrite=overwrite)
    return run


def as_frames(frames: Frame | Recorded) -> AbstractContextManager[Frames]:
    """Frames as a `Frames` object; a path is opened, and closed after the block.

    Raises InputError: no frames.
    """
    if isinstance(frames, str | Path):
        return open(frames)
    several = [frames] if isinstance(frames, Frame) else frames
    if isinstance(several, Frames) and len(several):
        return nullcontext(several)
    if not isinstance(several, Sequence):
        raise _no_frames(several)
    if not len(several):
        raise InputError("no frames were given; choose at least one")
    for other in several:
        if not isinstance(other, Frame):
            raise _no_frames(other)
    return Frames(HeldFrames(several))


def _no_frames(given: object) -> InputError:
    return InputError(
        f"frames: a recording's path, Frames, a list of Frame, or a stream is expected, not a "
        f"{type(given).__name__}; use bv.Estimator for arrays"
    )


def pipeline_for(
    frames: Frames,
    sensor: SensorName,
    solver: str | None,
    friction: float | None,
    colour_delay_s: float | None = None,
) -> tuple[str, Pipeline]:
    """Name of the sensor that fits some frames, and a new pipeline for them."""
    options = EstimatorOptions.named(solver, friction)
    name, own, intrinsics = sensor_for(frames, sensor)
    return name, Pipeline.of(with_colour_delay(own, colour_delay_s), intrinsics, options)


def sensor_for(frames: Frames, sensor: SensorName) -> tuple[str, Sensor, Intrinsics | None]:
    """Name of the sensor that fits some frames, the sensor, and the intrinsics of the frames."""
    source = frames.source
    intrinsics = source.intrinsics if isinstance(source, Recording) else frames[0].intrinsics
    return *fitting_sensor(source, sensor), intrinsics


def watch_texture(frames: Frames, pipeline: Pipeline) -> str:
    """Use a recording's colour images for shear; returns a text about their reference."""
    from bubbleviz.shear import watch_recorded_texture  # needs OpenCV

    if not isinstance(frames.source, Recording):
        raise InputError(
            f"{frames.name}: shear needs the colour images of a ROS recording; open one (save a "
            "simulation first), or leave out shear"
        )
    refuse_frictionless_shear(pipeline)
    source = frames.source
    return watch_recorded_texture(pipeline, source, lambda: find_contact_free(source).frames)


def path_of(frames: object) -> str | Path | None:
    """Path of frames that are given by it, or come from a file; else None."""
    return frames if isinstance(frames, str | Path) else getattr(frames, "path", None)


def _check_outputs(
    frames: object, *outputs: tuple[str | Path | None, str], overwrite: bool
) -> None:
    """Check the paths, with the suffixes of their kinds, that results are to be written to."""
    given = [(given_path("output", path), suffix) for path, suffix in outputs if path is not None]
    if len({path.absolute() for path, _ in given}) < len(given):
        raise InputError(f"{given[0][0]}: given for both --out and --csv; choose two names")
    for path, suffix in given:
        refuse_input(path, path_of(frames))
        refuse_existing(path, suffix, overwrite=overwrite)


def _watched(
    stream: LiveStream,
    sensor: SensorName,
    timeout_s: float | EllipsisType | None,
    *files: str | Path | None,
    **options: Any,
) -> Iterator[FrameResult]:
    """Results of a stream's newest frames; `options` as in `Estimator`."""
    from bubbleviz.api.watching import Watcher  # loads network and camera libraries
    from bubbleviz.live import LiveStream

    if not isinstance(stream, LiveStream):
        raise _no_frames(stream)
    for path in filter(None, files):
        raise InputError(
            f"{path}: estimate and track write no files for a live stream; record it with "
            "bv.record(SOURCE, REC), then estimate REC"
        )
    own = stream.sensor if str(sensor) == AUTO else load_sensor(sensor)
    patience_s = stream.timeout_s if isinstance(timeout_s, EllipsisType) else timeout_s
    check_given("timeout_s", patience_s, 0.0)
    return Watcher.on(stream, own, **options).results(patience_s)


def _new_run(
    frames: Frames,
    sensor_name: str,
    pipeline: Pipeline,
    solver: str | None,
    zero_gas: bool,
    out: str | Path | None,
) -> tuple[Zeros, Run]:
    """Zeros of the recording, and a run with context and provenance but no frames yet."""
    zeros = zeros_of(frames.source, pipeline)
    if not zero_gas:
        zeros = zeros._replace(gas=None)
    provenance = {
        "sensor_toml": sensor_to_toml(pipeline.model.sensor),
        "version": bubbleviz.__version__,
        "solver": solver or pipeline.estimator.solver_name,
    }
    if zeros.gas is not None and zeros.gas.offset_pa is not None:
        provenance["gas_pressure_offset_pa"] = f"{zeros.gas.offset_pa}"
    if (bias_n := wrench_bias(frames.source, pipeline)) is not None:
        provenance["wrench_bias_n"] = " ".join(map(str, bias_n))
    context = {
        "recording": shown_name(frames.source),
        "sensor": sensor_name,
        "out": None if out is None else str(out),
    }
    return zeros, Run(pipeline.model, context, provenance)


def _results(frames: Frames, solver: FrameSolver, progress: Progress) -> Iterator[Result]:
    """Results of frames in order.

    A frame that does not fit the sensor file may take seconds. If the first one does not, frames
    spread over all of them are tried before the next.

    Raises InputError: none of them fits either, or a frame cannot be read.
    """
    spread = np.unique(np.linspace(0, len(frames) - 1, SEARCH_POINTS).astype(int))
    for count, result in enumerate(solved(frames, solver, progress)):
        if not count and len(spread) < len(frames) and _is_implausible(result.estimate):
            others = (solver.zeros.applied(frames[k]) for k in spread[1:])
            if all(_is_implausible(solver.pipeline.estimate_once(each)) for each in others):
                tried = f"{len(spread)} of {len(frames):,} frames were tried"
                raise InputError(
                    f"{shown_name(frames.source)}: {NO_FRAME_FITS} ({tried}; --frames chooses "
                    "others)"
                )
        yield result


def _is_implausible(estimate: Estimate | None) -> bool:
    return estimate is not None and estimate.status == "implausible"


_NO_ESTIMATE = {
    "implausible": NO_FRAME_FITS,
    "not_converged": "no frame could be solved; try another --solver, and check tension and "
    "prestretch in the sensor file",
    "no_depth": "no valid depth in any frame; uncover or restart the camera, and record again",
    "no_data": "too few depth pixels lie on the membrane in every frame; uncover the camera, or "
    "choose the sensor file of this camera",
}
"""Why no frame has a trusted estimate, the most important reason first."""


def _check_any_data(run: Run, any_depth: bool) -> None:
    """Raise InputError if no frame has a trusted estimate; `any_depth`: some have depth."""
    statuses = set(run.status.tolist()) | (set() if any_depth else {"no_depth"})
    if not statuses & set(TRUSTED):
        why = next(text for status, text in _NO_ESTIMATE.items() if status in statuses)
        raise InputError(f"{run.context['recording']}: {why}")


_REASONS: dict[PoseStatus, str] = {
    "no_contact": "nothing touches the membrane; choose frames with contact",
    "few_points": "the contact patch has fewer points than a pose needs; press deeper",
    "no_data": "no trusted estimate of the membrane; check the sensor file, the gas pressure and "
    "the unit of depth, and uncover the camera",
    "lost": "the object does not fit the contact; check --object, --unit and --init",
}


def _other_object(contradicted: list[tuple[float, float]]) -> str:
    """What to do where the contact is farther from the object than errors explain; else empty.

    `contradicted`: `Pose.distance_rms_m` and `Pose.distance_limit_m` of these frames.
    """
    if not contradicted:
        return ""
    rms_m, limit_m = max(contradicted, key=lambda each: each[0] / each[1])
    return (
        f"in {count_of(len(contradicted), 'frame')} the contact is up to {1e3 * rms_m:.2f} mm "
        f"(rms) off the object, more than errors explain ({1e3 * limit_m:.2f} mm):"
        " the pose may be wrong, or the object another one, or narrower than the sensor resolves. "
        "Check the object and its unit (--object, --unit), or give a pose (--init)"
    )


def _other_poses(ambiguous: list[tuple[int, Pose]]) -> str:
    """What to do where other poses are as likely as the one found; empty if that is nowhere."""
    if not ambiguous:
        return ""
    last, pose = ambiguous[-1]
    numbers = (" ".join(f"{each:.4f}" for each in pose_numbers(other)) for other in pose.others)
    return (
        f"in {count_of(len(ambiguous), 'frame')} other poses fit as well, last in frame {last}: if "
        "the object is turned there, start in that frame from one of these (--frames, --init): "
        f"{', '.join(map(repr, numbers))}"
    )


def _check_any_pose(run: Run) -> None:
    statuses: Counter[Any] = Counter(row["status"] for row in run.poses)
    if "ok" not in statuses:
        touched = Counter({each: n for each, n in statuses.items() if each != "no_contact"})
        why = _REASONS[(touched or statuses).most_common(1)[0][0]]
        raise InputError(
            f"{run.context['recording']}: no pose in any frame; most frequent reason: {why}"
        )
