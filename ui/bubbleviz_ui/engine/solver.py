"""Opens sources and makes the products of their frames, in the solver thread. No Qt in here."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field, is_dataclass, replace
from threading import Event
from typing import Literal

import numpy as np

from bubbleviz.camera import DepthCamera
from bubbleviz.diagnostics import Inspection, Numbers, numbers_of, patch_numbers
from bubbleviz.errors import InputError
from bubbleviz.inverse import EstimatorOptions
from bubbleviz.membrane import MembraneMesh
from bubbleviz.output import ComparedResult, SettingsComparison
from bubbleviz.pipeline import DIAGNOSTICS, FrameOptions, Pipeline, Product
from bubbleviz.pressure_zero import PressureZero, zero_of, zeroed
from bubbleviz.processes import PipelineProcess
from bubbleviz.progress import Cancelled
from bubbleviz.recordings import (
    Frame,
    FrameSource,
    Gap,
    HeldFrames,
    Recording,
    gas_warning,
)
from bubbleviz.result import Estimate, Result
from bubbleviz.rigid_object import RigidObject, load_object
from bubbleviz.sensor import Sensor, contradiction
from bubbleviz.simulation import truth_of
from bubbleviz_ui.engine.source import NO_SOURCE, Source
from bubbleviz_ui.engine.worker import Deferred
from bubbleviz_ui.live.live_frames import LiveFrames
from bubbleviz_ui.model.demand import Demand
from bubbleviz_ui.model.source_facts import SourceFacts
from bubbleviz_ui.shear.shear_reference import SHEAR, ShearReference

ComparedOptions = tuple[EstimatorOptions, FrameOptions]
"""What makes the estimate and the patch of a setting."""


@dataclass(frozen=True)
class OpenRequest:
    """A source to open with a sensor."""

    source: Source
    open_sensor: Callable[[], Sensor]  # Called in the solver thread
    frame: int  # Frame to show first; proof that the source can be used with the sensor
    demand: Demand  # Of that frame
    options: EstimatorOptions = field(default_factory=EstimatorOptions)
    playing: bool = False  # Play once it is open
    # Set: nobody waits for it any more
    cancelled: Event = field(default_factory=Event, compare=False)


@dataclass(frozen=True)
class Opened:
    """A source that is open, with its first frame."""

    request: OpenRequest
    facts: SourceFacts
    sensor: Sensor
    camera: DepthCamera
    mesh: MembraneMesh
    frame: int
    result: Result
    numbers: Numbers


@dataclass(frozen=True)
class Solved:
    """A frame's products, its numbers, and when that was done.

    `outages` are those of a live source so far; `remark` is what the user has to be told of how it
    was solved, or of the sensor file.
    """

    demand: Demand
    result: Result
    numbers: Numbers
    done_s: float = float("nan")
    outages: tuple[Gap, ...] = ()
    remark: str = ""


# Estimates of frames, kept so that another κ needs no solving. No Qt in here.


MOST_BYTES = 256 * 2**20
"""Some 6,000 frames of 1,000 nodes; chosen."""


class KeptEstimates:
    """The estimates that were computed last, as many as fit."""

    def __init__(self, most_bytes: int = MOST_BYTES) -> None:
        self._kept: OrderedDict[int, tuple[Numbers, Estimate]] = OrderedDict()
        self._sizes: dict[int, int] = {}
        self._most = most_bytes

    def get(self, frame: int) -> tuple[Numbers, Estimate] | None:
        """Numbers and estimate of a frame; None where they are not kept."""
        return self._kept.get(frame)

    def keep(self, frame: int, numbers: Numbers, estimate: Estimate) -> None:
        """Keep a frame's in place of what was kept of it, and let go of the oldest."""
        self._kept.pop(frame, None)
        self._kept[frame] = numbers, estimate
        self._sizes[frame] = _bytes(estimate)
        while sum(self._sizes.values()) > self._most:
            oldest, _ = self._kept.popitem(last=False)
            del self._sizes[oldest]


def _bytes(held: object) -> int:
    """Memory of the arrays in something, and in what that holds."""
    if isinstance(held, np.ndarray):
        return held.nbytes
    return sum(map(_bytes, vars(held).values())) if is_dataclass(held) else 0


WAIT_S, LOOK_S = 0.05, 0.005
"""How long a frame of a live source is waited for before it counts as paused, and how often the
worker looks meanwhile whether something more urgent waits."""
SLICE_S = 0.03
"""How long frames nobody looks at may keep the one somebody asks for waiting."""
TOLD_PA = 50.0
"""Zero of a recording's gas pressure below which nothing is said: 1 % of a usual gauge pressure."""
PATCHED: frozenset[Product] = frozenset({"estimate", "patch"})
"""What a kept estimate tells at another κ."""


@dataclass(frozen=True)
class Session:
    """An open source and what is made of its frames; only the solver thread changes it.

    `beside` solves the newest frames of one of two cameras on another core; `zero` is that of a
    recording's gas pressure.
    """

    opened: Source
    source: FrameSource
    pipeline: Pipeline
    side_by_side: SettingsComparison
    shear: ShearReference = field(default_factory=ShearReference)
    kept: KeptEstimates = field(default_factory=KeptEstimates)
    beside: PipelineProcess | None = None
    zero: PressureZero | None = None

    @property
    def recording(self) -> Recording | None:
        """The source, where it is a recording of a sensor."""
        return self.source if isinstance(self.source, Recording) else None

    def frame(self, index: int) -> Frame:
        """Frame of the source; a recorded one's gas pressure is zeroed."""
        frame = self.source[index]
        return frame if self.zero is None else self.zero.applied(frame)

    def process(
        self,
        frame: Frame,
        demand: Demand,
        *,
        beside: PipelineProcess | None = None,
        settled: bool = False,
    ) -> Result:
        """Products of a frame; a live one's gas pressure is zeroed. `NO_SOURCE` has none."""
        pipeline, stream = self.pipeline, self.opened.stream
        if self.opened is NO_SOURCE:
            return Result(frame)
        if stream is not None:
            frame = zeroed(frame, stream.zero, pipeline)
        products = (
            self.shear.products(self.source, pipeline, frame.index, demand) - DIAGNOSTICS.keys()
        )
        if settled:
            pipeline.converge(frame)
        result = (beside or pipeline).process(frame, products, demand.options)
        if products & SHEAR:
            self.shear.collect(result)
        return result

    def look(self, result: Result, demand: Demand) -> Result:
        """The result looked at closer, beside the truth where the source knows it."""
        if self.opened is NO_SOURCE:
            return result
        wanted = "kappa_curve" in demand.diagnostics
        truth = truth_of(self.source, result.frame.index) if wanted else None
        mask = truth.patch_mask if truth is not None else None
        result = self.pipeline.diagnose(result, demand.products, demand.options, mask)
        seen = replace(result.inspection or Inspection(), reference=self.shear.words)
        return replace(result, inspection=seen)

    def numbers(self, result: Result) -> Numbers:
        """Numbers of a result; its estimate is kept, unless it is of a live source that goes on."""
        numbers = numbers_of(result, self.pipeline.model.gas)
        if result.estimate is not None and self.opened.stream is None:
            self.kept.keep(result.frame.index, numbers, result.estimate)
        return numbers

    def close(self) -> None:
        """Let go of the source, and end the process beside."""
        self.source.close()
        if self.beside is not None:
            self.beside.close()


class Solver:
    """Keeps the open source and its pipeline; what fails changes nothing."""

    def __init__(self) -> None:
        self.session: Session | None = None
        self._checked: Session | None = None  # whose sensor file was compared with its frames

    @property
    def counts(self) -> dict[str, int]:
        """How often each stage has run for the open source."""
        return dict(self.session.pipeline.counts) if self.session is not None else {}

    @property
    def _open(self) -> Session:
        if self.session is None:
            raise RuntimeError("nothing is open yet")
        return self.session

    def close(self) -> None:
        """Let go of the open source."""
        if self.session is not None:
            self.session.close()
            self.session = self._checked = None

    def frame(
        self, index: int, demand: Demand, *, settled: bool = False, anew: bool = False
    ) -> Solved:
        """Products of a frame.

        `settled`: Solve it without the state of the frames before, so that it is always the same.
        `anew`: Find the contact-free colour images anew.
        """
        session = self._open
        frame = session.frame(index)
        if anew:
            session.shear.forget()
        solved = self._solved(session, demand, frame, settled=settled)
        if settled and self._checked is not session:  # in spare time: opening does not wait for it
            self._checked = session
            return replace(solved, remark=_misfit(session))
        return solved

    def newest(
        self, demand: Demand, called_off: Callable[[], bool], *, needs_colour: bool = False
    ) -> Solved | None:
        """Products of the newest frame of a live source; None if none comes.

        `called_off`: Whether to stop waiting for a frame; `Deferred` is raised then.
        `needs_colour`: Have colour images sent, also for diagnostics that not every frame gets.
        """
        session, end = self._open, time.perf_counter() + WAIT_S
        stream, beside = session.opened.stream, session.beside
        if stream is None:
            return None
        stream.follow_colour(needs_colour)
        while (frame := stream.newest(LOOK_S)) is None:
            if called_off():
                raise Deferred
            if stream.ended or time.perf_counter() > end:
                return None
        known = "" if beside is None else beside.lost
        solved = self._solved(session, demand, frame, beside=beside)
        stream.tell(solved.result, session.pipeline.mesh)
        remark = "" if beside is None or beside.lost == known else _lost(session, beside)
        return replace(solved, outages=stream.outages, remark=remark)

    def follow(
        self, object_name: str | None, unit: Literal["m", "mm"] | None, start: np.ndarray | None
    ) -> RigidObject | None:
        """Look for another object from now on, or for none.

        `object_name`: Preset or mesh file.
        `unit`: Of the file; None: by its name.
        `start`: (4, 4) array or None: T_B_O to begin at; None to search.
        """
        obj = None if object_name is None else load_object(object_name, unit)
        self._open.pipeline.track(obj, start)
        return obj

    def patch(self, result: Result, demand: Demand) -> tuple[Result, Numbers]:
        """Threshold the estimate of a result anew at another κ, without solving."""
        session, estimate = self._open, result.estimate
        if estimate is None:
            raise ValueError("no estimate to threshold")
        masked = "pixel_mask" in demand.products
        patch = session.pipeline.patch(estimate, demand.options, pixel_mask=masked)
        result = session.look(replace(result, patch=patch), demand)
        return result, numbers_of(result, session.pipeline.model.gas)

    def analyse(
        self, frames: tuple[int, ...], demand: Demand, *, kept_only: bool
    ) -> list[Numbers | None]:
        """Numbers of as many frames as there is time for, and of one at least.

        With `kept_only` None for a frame whose estimate is not kept.
        """
        session = self._open
        end, numbers = time.perf_counter() + SLICE_S, list[Numbers | None]()
        for index in frames:
            numbers.append(_numbers(session, demand, index, kept_only=kept_only))
            if time.perf_counter() > end:
                break
        return numbers

    def compare(
        self, index: int, settings: tuple[ComparedOptions, ...], *, settled: bool
    ) -> tuple[ComparedResult | str, ...]:
        """Measure settings on a frame; a text where one is impossible.

        No settings: let go of what was built for that.
        """
        session = self._open
        bench, measured = session.side_by_side, list[ComparedResult | str]()
        bench.keep([options for options, _ in settings])
        if not settings:
            return ()
        frame, truth = session.frame(index), truth_of(session.source, index)
        if session.opened.stream is not None:
            frame = session.opened.stream.zero.applied(frame)
        for options, rule in settings:
            try:
                measured.append(bench.measure(options, frame, rule, truth, settled=settled))
            except InputError as error:
                measured.append(str(error))
        return tuple(measured)

    def _solved(
        self,
        session: Session,
        demand: Demand,
        frame: Frame,
        *,
        beside: PipelineProcess | None = None,
        settled: bool = False,
    ) -> Solved:
        result = session.process(frame, demand, beside=beside, settled=settled)
        result = session.look(result, demand)
        return Solved(demand, result, session.numbers(result), time.perf_counter())

    def open(self, request: OpenRequest) -> Opened:
        """Open a source in place of the present one.

        Raises InputError: It cannot be opened; the present one stays; Cancelled.
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
                stream.zero.refer_to(pipeline.model.gas.P0)
            settings = SettingsComparison(sensor, pipeline.camera.intrinsics)
            session = Session(request.source, source, pipeline, settings)
            products = session.shear.products(source, pipeline, frame.index, request.demand)
            pipeline.prepare(products)  # apart: says nothing about a frame
            measured_pa = frame.gas_pressure_pa
            if session.recording is not None:
                session = replace(session, zero=zero_of(session.recording, pipeline))
            if session.zero is not None:
                frame = session.zero.applied(frame)
                measured_pa = session.zero.rest_pa or measured_pa
            result = session.process(frame, request.demand)
            if request.cancelled.is_set():
                raise Cancelled
        except BaseException:
            source.close()
            if request.cancelled.is_set():
                raise Cancelled from None
            raise
        self.close()
        self.session = session = replace(session, beside=_beside(stream, pipeline))
        numbers, result = session.numbers(result), session.look(result, request.demand)
        facts, camera, mesh = _facts(session, sensor, measured_pa), pipeline.camera, pipeline.mesh
        return Opened(request, facts, sensor, camera, mesh, index, result, numbers)


def _facts(session: Session, sensor: Sensor, measured_pa: float | None) -> SourceFacts:
    """What the window says about a source that was opened."""
    opened, source, zero = session.opened, session.source, session.zero
    stream, recording = opened.stream, session.recording
    # recordings have a remark
    remarks = [str(getattr(source, "remark", "")), contradiction(sensor)]
    if stream is None:  # else its zero tells, once it is known
        remarks.append(gas_warning(measured_pa, session.pipeline.model.gas.P0))
        remarks.append(_told(zero))
    return SourceFacts(
        source.name,
        sensor.name,
        source.times_s,
        live=opened.live,
        grows=stream is not None,
        remark=" ".join(f"{text}." for text in remarks if text),
        marks=() if recording is None else recording.marks(),
        # a live source that does not grow is the press that the window loops
        simulated=opened.live if stream is None else stream.simulated,
        outages=() if stream is None else stream.outages,
        path="" if opened.path is None else str(opened.path.resolve()),
        gas_zero="" if zero is None else zero.words,
    )


def _numbers(session: Session, demand: Demand, index: int, *, kept_only: bool) -> Numbers | None:
    """Numbers of a frame, the patch alone found anew where its estimate is kept."""
    pipeline = session.pipeline
    kept = session.kept.get(index)
    if kept is not None and demand.products <= PATCHED:
        known, estimate = kept
        patch = pipeline.patch(estimate, demand.options)
        return replace(known, **patch_numbers(patch, trusted=estimate.trusted))
    if kept_only:
        return None
    try:
        frame = session.frame(index)
        result = session.process(frame, demand)
    except InputError:
        return Numbers()  # it says so when somebody looks at it
    return session.numbers(result)


def _beside(stream: LiveFrames | None, pipeline: Pipeline) -> PipelineProcess | None:
    """A process for the frames of one of two cameras: one alone leaves a core to its solver thread.

    A simulation has no images to hurry for.
    """
    if stream is None or stream.simulated or not stream.paired:
        return None
    beside = PipelineProcess(pipeline)
    stream.at_end(beside.end)
    return beside


def _lost(session: Session, beside: PipelineProcess) -> str:
    return (
        f"{session.source.name}: its solver process has ended ({beside.lost}); its frames are now "
        "solved in the window's process, which may be slower"
    )


def _told(zero: PressureZero | None) -> str:
    """What to say of a recording's zero; nothing of one that the sensor's noise would explain."""
    if zero is None or (zero.offset_pa is not None and abs(zero.offset_pa) < TOLD_PA):
        return ""
    return zero.words


def _misfit(session: Session) -> str:
    """What the first frames of a recording say against the sensor file; nothing where touched."""
    source, model = session.recording, session.pipeline.model
    if source is None:
        return ""
    # what the window starts without
    from bubbleviz.calibration import check_sensor
    from bubbleviz.pressure_zero import ZERO_FRAMES
    from bubbleviz.recordings import find_contact_free

    first = HeldFrames([source[k] for k in range(min(ZERO_FRAMES, len(source)))], source.name)
    try:
        free = find_contact_free(first).frames
        found = check_sensor(model, [first[k] for k in free], quick=True)
    except InputError:
        return ""
    if found.verdict == "drifted" and model.pixels is None:
        off = f"{1e3 * found.bias_m:+.2f} mm"
        return f"the sensor file was never calibrated, and depth is {off} off: identify the sensor"
    return "" if found.verdict == "fits" else f"compared with the sensor file: {found.reason}"
