"""Work of the solver thread: opens sources and computes products of their frames. No Qt."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, is_dataclass, replace
from functools import partial
from threading import Event
from typing import Literal, NamedTuple, TypeVar

import numpy as np

from bubbleviz.api.frame_warnings import FrameWarnings
from bubbleviz.averaging import StillFrames
from bubbleviz.camera import DepthCamera
from bubbleviz.diagnostics import Inspection, Numbers, numbers_of, patch_numbers
from bubbleviz.errors import InputError
from bubbleviz.inverse import EstimatorOptions, Start
from bubbleviz.membrane import MembraneMesh
from bubbleviz.output import ComparedResult, SettingsComparison
from bubbleviz.pipeline import DIAGNOSTICS, FLOW_PRODUCTS, FrameOptions, Pipeline, Product
from bubbleviz.processes import PipelineProcess
from bubbleviz.progress import Cancelled
from bubbleviz.recordings import Frame, FrameSource, Gap, HeldFrames, Recording
from bubbleviz.result import Estimate, Result
from bubbleviz.rigid_object import RigidObject, load_object
from bubbleviz.sensor import Sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation import truth_of
from bubbleviz.zeros import ImageZero, Zeros, search_wrench_bias, zeros_of
from bubbleviz_ui.engine.live_frames import LiveFrames
from bubbleviz_ui.engine.shear_reference import ShearReference
from bubbleviz_ui.engine.source import NO_SOURCE, PlacedSensor, Source
from bubbleviz_ui.engine.worker import Deferred
from bubbleviz_ui.model.demand import Demand
from bubbleviz_ui.model.source_facts import SourceFacts

N = TypeVar("N")
ComparedOptions = tuple[EstimatorOptions, FrameOptions]
"""Options of estimate and patch of a compared setting."""


@dataclass(frozen=True)
class OpenRequest:
    """A source to open with a sensor."""

    source: Source
    open_sensor: Callable[[], Sensor]  # Called in the solver thread
    frame: int  # First frame to show; solving it checks that source and sensor match
    demand: Demand  # Of that frame
    options: EstimatorOptions = field(default_factory=EstimatorOptions)
    playing: bool = False  # Play once it is open
    group: tuple[PlacedSensor, ...] = ()  # Sensors opened together; empty: one alone
    cancelled: Event = field(default_factory=Event, compare=False)


@dataclass(frozen=True)
class Opened:
    """An opened source with its first result."""

    request: OpenRequest
    facts: SourceFacts
    sensor: Sensor
    camera: DepthCamera
    mesh: MembraneMesh
    result: Result
    numbers: Numbers
    zeros: Zeros | None = None  # Of a recording


@dataclass(frozen=True)
class Solved:
    """A frame's products, its numbers, and when they were completed.

    `outages` are those of a live source so far; `remark` is a message for the user about solver or
    sensor file, or empty. `final`: it does not depend on the frames before.
    """

    demand: Demand
    result: Result
    numbers: Numbers
    done_s: float = float("nan")
    final: bool = False
    outages: tuple[Gap, ...] = ()
    remark: str = ""


# Estimates of frames, cached so that another κ needs no solving.

CACHE_BYTES = 256 * 2**20
"""About 6,000 frames of 1,000 nodes."""


class Kept(NamedTuple):
    """Estimate of a frame.

    `start` is the warm start for frames nearby, None without contact; `final`: it was solved from
    rest by depth alone, and does not depend on the frames before.
    """

    numbers: Numbers
    estimate: Estimate
    start: Start | None = None
    final: bool = False


class EstimateCache:
    """Cache of the most recently computed estimates, limited by memory."""

    def __init__(self, most_bytes: int = CACHE_BYTES) -> None:
        self._kept: OrderedDict[int, Kept] = OrderedDict()
        self._sizes: dict[int, int] = {}
        self._flow = False
        self._most = most_bytes

    def get(self, frame: int) -> Kept | None:
        """Estimate of a frame; None if not cached."""
        return self._kept.get(frame)

    def final(self, frame: int) -> Estimate | None:
        """The final estimate of a frame; None if not cached."""
        kept = self._kept.get(frame)
        return kept.estimate if kept is not None and kept.final else None

    def keep(self, frame: int, kept: Kept) -> None:
        """Cache that of a frame, and drop the oldest if memory is exceeded."""
        self._kept.pop(frame, None)
        self._kept[frame] = kept
        self._sizes[frame] = _bytes(kept.estimate) + _bytes(kept.start)
        while sum(self._sizes.values()) > self._most:
            oldest, _ = self._kept.popitem(last=False)
            del self._sizes[oldest]

    def use(self, *, flow: bool) -> bool:
        """Drop all if forces begin or cease to use colour images; whether that is so."""
        changed, self._flow = flow != self._flow, flow
        if changed:
            self._kept.clear()
            self._sizes.clear()
        return changed

    def restart(self, pipeline: Pipeline, frame: int) -> None:
        """Restart a pipeline for a frame from the nearest one solved, unless it was the last."""
        distance = abs(next(reversed(self._kept), frame) - frame)
        if distance <= 1:
            return
        nearest = min(self._kept, key=lambda known: abs(known - frame))
        if abs(nearest - frame) < distance:
            pipeline.restart(self._kept[nearest].start)


def _bytes(value: object) -> int:
    """Memory of all arrays in a nested dataclass."""
    if isinstance(value, np.ndarray):
        return value.nbytes
    return sum(map(_bytes, vars(value).values())) if is_dataclass(value) else 0


LIVE_TIMEOUT_S, POLL_S = 0.05, 0.005
"""Waiting time after which a live source counts as paused, and the period at which a more urgent
request is checked for meanwhile."""
ANALYSIS_SLICE_S = 0.03
"""How long the analysis of all frames may delay a requested frame."""
REPORTED_ZERO_PA = 50.0
"""Smallest reported gas pressure offset of a recording: 1 % of a typical gauge pressure."""
MISFITS = frozenset({"depth", "fit", "unconfirmed"})
"""Subjects of warnings that the sensor file does not fit."""
PATCHED: frozenset[Product] = frozenset({"estimate", "patch"})
"""Products that follow from a cached estimate at another κ."""


@dataclass(frozen=True)
class OpenSource:
    """An open source and its pipeline; used only in the solver thread.

    `wrench_bias` searches the bias of the wrench sensor; `solver_process` solves the newest frames
    of one of two cameras on another core; `zeros` are of gas pressure and depth image.
    """

    opened: Source
    source: FrameSource
    pipeline: Pipeline
    side_by_side: SettingsComparison
    wrench_bias: Iterator[np.ndarray | None]
    zeros: Zeros
    counted: FrameWarnings
    shear: ShearReference = field(default_factory=ShearReference)
    estimates: EstimateCache = field(default_factory=EstimateCache)
    solver_process: PipelineProcess | None = None

    @property
    def recording(self) -> Recording | None:
        """The source if it is a recording of a sensor, else None."""
        return self.source if isinstance(self.source, Recording) else None

    @property
    def has_colour(self) -> bool:
        """Whether its frames may have colour images."""
        return self.recording is None or self.recording.colour is not None

    def frame(self, index: int) -> Frame:
        """Frame of the source; that of a recording with its zeros."""
        frame = self.source[index]
        return frame if self.recording is None else self.zeros.applied(frame)

    def process(
        self,
        frame: Frame,
        demand: Demand,
        *,
        solver_process: PipelineProcess | None = None,
        cold: bool = False,
    ) -> Result:
        """Products of a frame; of a live one with its zeros, which follow it."""
        pipeline, stream, measured = self.pipeline, self.opened.stream, frame
        if self.opened is NO_SOURCE:
            return Result(frame)
        if stream is not None:
            # the solver process averages its frames itself
            zeros = self.zeros if solver_process is None else self.zeros._replace(still=None)
            frame = zeros.zeroed(frame, pipeline)
        products = self.shear.products(self.source, pipeline, demand)
        products -= DIAGNOSTICS.keys()
        if self.has_colour and self.estimates.use(flow=demand.flow):
            self.counted.restart()
        estimate = None if products & FLOW_PRODUCTS else self.estimates.final(frame.index)
        if cold and estimate is None:
            pipeline.restart()
        elif estimate is None:
            self.estimates.restart(pipeline, frame.index)
        if solver_process is None:
            result = pipeline.process(frame, products, demand.options, estimate)
        else:
            result = solver_process.process(frame, products, demand.options)
        if stream is not None:
            self.zeros.follow(measured, result, pipeline)
        self.counted.take(measured.index, measured, result)
        if products & FLOW_PRODUCTS:
            self.shear.add_frame(result)
        return result

    def diagnose(self, result: Result, demand: Demand) -> Result:
        """The result with its diagnostics, which use the ground truth if the source has it."""
        if self.opened is NO_SOURCE:
            return result
        wanted = "kappa_curve" in demand.products
        truth = truth_of(self.source, result.frame.index) if wanted else None
        mask = truth.patch_mask if truth is not None else None
        result = self.pipeline.diagnose(result, demand.products, demand.options, mask)
        seen = replace(result.inspection or Inspection(), reference=self.shear.message)
        return replace(result, inspection=seen)

    def numbers(self, result: Result, *, cold: bool = False) -> Numbers:
        """Numbers of a result; its estimate is cached, except of a live source."""
        numbers = numbers_of(result, self.pipeline.model.gas)
        estimate, index = result.estimate, result.frame.index
        kept = self.estimates.get(index)
        if estimate is None or self.opened.stream is not None:
            return numbers
        if kept is None or kept.estimate is not estimate:
            final = cold and result.flow is None
            self.estimates.keep(index, Kept(numbers, estimate, self.pipeline.start, final))
        return numbers

    def close(self) -> None:
        """Close the source and end the solver process."""
        self.source.close()
        if self.solver_process is not None:
            self.solver_process.close()


class Solver:
    """Holds the open source and its pipeline; a failed call leaves them unchanged."""

    def __init__(self) -> None:
        self.current: OpenSource | None = None
        self._checked: OpenSource | None = None  # its sensor file was compared with its frames

    @property
    def counts(self) -> dict[str, int]:
        """How often each stage has run for the open source."""
        return dict(self.current.pipeline.counts) if self.current is not None else {}

    @property
    def _open(self) -> OpenSource:
        if self.current is None:
            raise RuntimeError("internal error: nothing is open")
        return self.current

    def close(self) -> None:
        if self.current is not None:
            self.current.close()
            self.current = self._checked = None

    def frame(
        self, index: int, demand: Demand, *, cold: bool = False, new_reference: bool = False
    ) -> Solved:
        """Products of a frame.

        `cold`: Solve from rest, independent of the frames before.
        `new_reference`: Search the contact-free colour images again.
        """
        current = self._open
        frame = current.frame(index)
        if new_reference:
            current.shear.reset()
        return self._solved(current, demand, frame, cold=cold)

    def newest(
        self, demand: Demand, cancelled: Callable[[], bool], *, needs_colour: bool = False
    ) -> Solved | None:
        """Products of the newest frame of a live source; None if none arrives.

        `cancelled`: Whether to stop waiting for a frame; `Deferred` is raised then.
        `needs_colour`: Subscribe to colour images, also for diagnostics that not every frame gets.
        """
        current, end = self._open, time.perf_counter() + LIVE_TIMEOUT_S
        stream, process = current.opened.stream, current.solver_process
        if stream is None:
            return None
        stream.set_colour(needs_colour)
        while (frame := stream.newest(POLL_S)) is None:
            if cancelled():
                raise Deferred
            if stream.ended or time.perf_counter() > end:
                return None
        lost_before = "" if process is None else process.lost
        solved = self._solved(current, demand, frame, solver_process=process)
        stream.publish(solved.result, current.pipeline)
        lost = "" if process is None else process.lost
        ended = ""
        if lost != lost_before:
            ended = (
                f"{current.source.name}: its solver process has ended ({lost}); its frames are now "
                "solved in the window's process, which may be slower"
            )
        remark = "; ".join(filter(None, (ended, solved.remark)))
        return replace(solved, outages=stream.outages, remark=remark)

    def set_object(
        self, object_name: str | None, unit: Literal["m", "mm"] | None, start: np.ndarray | None
    ) -> RigidObject | None:
        """Register another object from now on, or none.

        `object_name`: Preset or mesh file.
        `unit`: Of the file; None: from its name.
        `start`: (4, 4) initial pose T_B_O; None: global search.
        """
        obj = None if object_name is None else load_object(object_name, unit)
        self._open.pipeline.track(obj, start)
        return obj

    def patch(self, result: Result, demand: Demand) -> tuple[Result, Numbers]:
        """Patch of a result at another κ, without solving."""
        current, estimate = self._open, result.estimate
        if estimate is None:
            raise ValueError("internal error: the result has no estimate")
        masked = "pixel_mask" in demand.products
        patch = current.pipeline.patch(estimate, demand.options, pixel_mask=masked)
        result = current.diagnose(replace(result, patch=patch), demand)
        return result, numbers_of(result, current.pipeline.model.gas)

    def analyse(
        self, frames: tuple[int, ...], demand: Demand, *, cached_only: bool
    ) -> list[Numbers | None]:
        """Numbers of at least one frame, and of more within `ANALYSIS_SLICE_S`.

        With `cached_only` None for a frame whose estimate is not cached.
        """
        find = partial(_numbers, self._open, demand, cached_only=cached_only)
        return _within_slice(find, frames)

    def preview(self, frames: tuple[int, ...], options: FrameOptions) -> list[Numbers]:
        """Approximate numbers, as many as by `analyse`; later ones do not depend on it."""
        return _within_slice(partial(_previewed, self._open, options), frames)

    def wrench_bias(self, interrupted: Callable[[], bool]) -> np.ndarray:
        """Bias (3,) of a recording's wrench sensor, N; NaN if no frames are contact-free.

        `interrupted`: Whether to continue later; `Deferred` is raised then.
        """
        for bias in self._open.wrench_bias:
            if bias is not None:
                return bias
            if interrupted():
                raise Deferred
        return np.full(3, np.nan)

    def compare(
        self, index: int, settings: tuple[ComparedOptions, ...], *, cold: bool
    ) -> tuple[ComparedResult | str, ...]:
        """Measure settings on a frame; an error text for one that is impossible.

        Without settings, the estimators built for the comparison are released.
        """
        current = self._open
        bench, measured = current.side_by_side, list[ComparedResult | str]()
        bench.keep([options for options, _ in settings])
        if not settings:
            return ()
        frame, truth = current.frame(index), truth_of(current.source, index)
        if current.opened.stream is not None:
            frame = current.zeros.applied(frame)
        for options, rule in settings:
            try:
                measured.append(bench.measure(options, frame, rule, truth, alone=cold))
            except InputError as error:
                measured.append(str(error))
        return tuple(measured)

    def _solved(
        self,
        current: OpenSource,
        demand: Demand,
        frame: Frame,
        *,
        solver_process: PipelineProcess | None = None,
        cold: bool = False,
    ) -> Solved:
        result = current.process(frame, demand, solver_process=solver_process, cold=cold)
        result = current.diagnose(result, demand)
        numbers, done_s = current.numbers(result, cold=cold), time.perf_counter()
        known = current.estimates.final(frame.index)
        final = known is not None and known is result.estimate
        remark = self._sensor_file_remark(current) if cold else ""
        return Solved(demand, result, numbers, done_s, final, remark=remark)

    def _sensor_file_remark(self, current: OpenSource) -> str:
        """Warning, once, if the first contact-free frames of a recording contradict its sensor.

        Not while playing, as it takes seconds, nor if the frames solved so far tell it.
        """
        recording = current.recording
        if (
            recording is None
            or self._checked is current
            or MISFITS & current.counted.texts().keys()
        ):
            return ""
        self._checked = current
        return _checked_remark(recording, current.pipeline.model)

    def warnings(self) -> dict[str, str]:
        """Warnings about the frames solved so far, by subject."""
        return self._open.counted.texts()

    def open(self, request: OpenRequest) -> Opened:
        """Open a source in place of the current one.

        Raises InputError: It cannot be opened, and the current one stays; Cancelled.
        """
        if request.cancelled.is_set():
            raise Cancelled
        sensor = request.open_sensor()
        source, stream = request.source.open(sensor), request.source.stream
        try:
            if len(source) == 0:
                raise InputError(f"{source.name}: has no frames; choose another recording")
            index = min(max(request.frame, 0), len(source) - 1)
            frame = source[index]
            pipeline = Pipeline.of(sensor, frame.intrinsics, request.options)
            if stream is not None:
                stream.zero.refer_to(sensor.pneumatics)
            settings = SettingsComparison(sensor, pipeline.camera.intrinsics)
            bias = search_wrench_bias(source, pipeline)
            zeros = _zeros(source, request.source, pipeline)
            counted = FrameWarnings(pipeline, zeros)
            current = OpenSource(request.source, source, pipeline, settings, bias, zeros, counted)
            products = current.shear.products(source, pipeline, request.demand)
            pipeline.prepare(products)  # not part of the frame's run time
            if current.recording is not None:
                frame = zeros.applied(frame)
            result = current.process(frame, request.demand)
            if request.cancelled.is_set():
                raise Cancelled
        except BaseException:
            source.close()
            if request.cancelled.is_set():
                raise Cancelled from None
            raise
        before, self._checked = self.current, None
        process = _solver_process(stream, pipeline, current.zeros.still)
        self.current = current = replace(current, solver_process=process)
        if before is not None:
            before.close()
        numbers, result = current.numbers(result), current.diagnose(result, request.demand)
        facts, camera, mesh = _facts(current, sensor), pipeline.camera, pipeline.mesh
        of_recording = None if current.recording is None else zeros
        return Opened(request, facts, sensor, camera, mesh, result, numbers, of_recording)


def _zeros(source: FrameSource, opened: Source, pipeline: Pipeline) -> Zeros:
    if opened.stream is not None:
        return Zeros.of_stream(opened.stream.zero, pipeline, opened.stream)
    if isinstance(source, Recording):
        return zeros_of(source, pipeline)
    return Zeros(None, ImageZero(), rest_frames=None if opened.live else 0)


def _facts(current: OpenSource, sensor: Sensor) -> SourceFacts:
    """Properties of an opened source."""
    opened, source, stream = current.opened, current.source, current.opened.stream
    recording = current.recording
    zero = current.zeros.gas if stream is None else None  # a live source reports its zero later
    # recordings have a note
    remarks = [str(getattr(source, "note", ""))]
    # an offset within the sensor's noise is no remark; `FrameWarnings` tells of a repeated value
    offset_pa = None if zero is None else zero.offset_pa
    small = offset_pa is not None and abs(offset_pa) < REPORTED_ZERO_PA
    if zero is not None and not (zero.frozen or small):
        remarks.append(zero.words)
    return SourceFacts(
        source.name,
        sensor.name,
        source.times_s,
        live=opened.live,
        grows=stream is not None,
        remark=" ".join(f"{text}." for text in remarks if text),
        marks=() if recording is None else recording.marks(),
        # a live source that does not grow is the looped synthetic press
        simulated=opened.live if stream is None else stream.simulated,
        outages=() if stream is None else stream.outages,
        colour=current.has_colour,
        path="" if opened.path is None else str(opened.path.resolve()),
        depth_topic="" if recording is None else recording.depth_topic.name,
        depth_topics=() if recording is None else tuple(recording.depth_topics),
        gas_zero="" if zero is None else zero.words,
    )


def _within_slice(find: Callable[[int], N], frames: tuple[int, ...]) -> list[N]:
    """Numbers of the first frame, and of more frames within `ANALYSIS_SLICE_S`."""
    end, found = time.perf_counter() + ANALYSIS_SLICE_S, list[N]()
    for index in frames:
        found.append(find(index))
        if time.perf_counter() > end:
            break
    return found


def _previewed(current: OpenSource, options: FrameOptions, index: int) -> Numbers:
    pipeline = current.pipeline
    try:
        frame = current.frame(index)
        estimate = pipeline.estimate_once(frame)
    except InputError:
        return Numbers()  # the error is reported when the frame is shown
    patch = pipeline.patch(estimate, options)
    return numbers_of(Result(frame, estimate=estimate, patch=patch), pipeline.model.gas)


def _numbers(
    current: OpenSource, demand: Demand, index: int, *, cached_only: bool
) -> Numbers | None:
    """Numbers of a frame; of a cached estimate only the patch is recomputed."""
    pipeline = current.pipeline
    kept = current.estimates.get(index)
    if kept is not None and demand.products <= PATCHED:
        known, estimate, *_ = kept
        patch = pipeline.patch(estimate, demand.options)
        return replace(known, **patch_numbers(patch, trusted=estimate.trusted))
    if cached_only:
        return None
    try:
        frame = current.frame(index)
        result = current.process(frame, demand)
    except InputError:
        return Numbers()  # the error is reported when the frame is shown
    return current.numbers(result)


def _solver_process(
    stream: LiveFrames | None, pipeline: Pipeline, still: StillFrames | None
) -> PipelineProcess | None:
    """A process for the frames of one of two cameras; a single one can use the solver thread.

    A simulation needs none, as it has no real-time images.
    """
    if stream is None or stream.simulated or not stream.paired:
        return None
    process = PipelineProcess(pipeline, still)
    stream.at_end(process.end)
    return process


def _checked_remark(source: Recording, model: SensorModel) -> str:
    """Warning if the first contact-free frames of a recording contradict the sensor file."""
    # not at start
    from bubbleviz.calibration import check_sensor
    from bubbleviz.recordings import find_contact_free
    from bubbleviz.zeros import ZERO_FRAMES

    first = HeldFrames([source[k] for k in range(min(ZERO_FRAMES, len(source)))], source.name)
    try:
        free = find_contact_free(first).frames
        found = check_sensor(model, [first[k] for k in free], quick=True)
    except InputError:
        return ""
    if found.verdict == "drifted" and model.pixels is None:
        return (
            "the sensor file has no calibrated pixels, and does not fit the depth without contact; "
            "identify the sensor in the Calibration panel"
        )
    contradicts = "frames without contact contradict the sensor file"
    return "" if found.verdict == "fits" else f"{contradicts}; {found.reason}"
