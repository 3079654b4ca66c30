"""Opens sources and makes the products of their frames, in the solver thread. No Qt in here."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field, is_dataclass, replace
from pathlib import Path
from threading import Event
from typing import Literal

import numpy as np

from bubbleviz.camera import DepthCamera
from bubbleviz.diagnostics import Inspection, Numbers, numbers_of, patch_numbers
from bubbleviz.errors import InputError
from bubbleviz.inverse import EstimatorOptions
from bubbleviz.membrane import MembraneMesh
from bubbleviz.output import Measured, SideBySide
from bubbleviz.pipeline import LOOKS, FrameOptions, Pipeline, Product
from bubbleviz.pressure_zero import PressureZero, zero_of, zeroed
from bubbleviz.processes import PipelineProcess
from bubbleviz.progress import Cancelled
from bubbleviz.recordings import (
    Frame,
    FrameSource,
    Gap,
    HeldFrames,
    Recording,
    check_fits,
    fitting_sensor,
    gas_warning,
    image_size,
    open_recording,
)
from bubbleviz.result import Estimate, Result
from bubbleviz.rigid_object import RigidObject, load_object
from bubbleviz.sensor import Sensor
from bubbleviz.simulation import KnownRecording, NoisyLoop, Truth, known_beside, truth_of
from bubbleviz_ui.engine.worker import Deferred
from bubbleviz_ui.live.live_frames import LiveFrames
from bubbleviz_ui.model.demand import Demand
from bubbleviz_ui.model.source_facts import NOTHING_OPEN, SourceFacts
from bubbleviz_ui.shear.shear_reference import SHEAR, ShearReference

ComparedOptions = tuple[EstimatorOptions, FrameOptions]
"""What makes the estimate and the patch of a setting."""


@dataclass(frozen=True)
class OpenRequest:
    """A source to open with a sensor."""

    what: str  # What to call it in a message
    # open_source, open_sensor: Make the source and the sensor; called in the solver thread
    open_source: Callable[[Sensor], FrameSource]
    open_sensor: Callable[[], Sensor]
    frame: int  # Frame to show first; proof that the source can be used with the sensor
    demand: Demand  # Of that frame
    options: EstimatorOptions = field(default_factory=EstimatorOptions)
    playing: bool = False  # playing, live: Play once it is open; it is a live source
    live: bool = False
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


# How the window opens what it can show; called in the solver thread.


RECORDINGS = "Recordings (*.mcap *.db3 *.bag *.yaml);;All files (*)"
"""As file dialogs offer them."""
LIVE_FINER = 2
"""Nodes of the live simulation's mesh for one of the estimator's: frames are made in 15 ms."""


@dataclass(frozen=True, eq=False)
class RecordingOpener:
    """Opens a recording for a sensor; two are never equal, as each stands for one opening."""

    path: Path
    truth: Path | None = None

    def __call__(self, sensor: Sensor) -> FrameSource:
        """Open it, with the truth behind it where it is of a simulation and that is known.

        Raises InputError: It cannot be opened, does not fit the sensor, or the truth is not its
        own.
        """
        opened = open_recording(self.path)
        try:
            check_fits(opened, sensor, sensor.name)
            if self.truth is not None and isinstance(opened, Recording):
                return KnownRecording(opened, self.truth)
            return known_beside(opened)
        except InputError:
            opened.close()
            raise


def recording(path: Path, truth: Path | None = None) -> Callable[[Sensor], FrameSource]:
    """Opener of a recording, and of its TRUTH.npz where that is not beside it under its name."""
    return RecordingOpener(path, truth)


def sensor_for(path: Path, present: Sensor) -> Sensor:
    """Sensor to open a recording with: the present one if it fits, else the preset that does."""
    with closing(open_recording(path)) as opened:
        if image_size(opened) == (present.camera.width, present.camera.height):
            return present
        return fitting_sensor(opened, None)[1]


def synthetic(sensor: Sensor) -> FrameSource:
    """Open the built-in synthetic press, which the window loops as a live sensor.

    All its frames are made now, within seconds: a live sensor does not stutter in its first round.
    Only the noise is new in every round.
    """
    # a recording is opened without the simulator
    from bubbleviz.simulation import SyntheticSource, default_press

    press, nodes = default_press(sensor), LIVE_FINER * sensor.membrane.nodes
    source = CachedSource(
        SyntheticSource(sensor, press.obj, press.poses, times_s=press.times_s, nodes=nodes)
    )
    for index in range(len(source)):
        _ = source[index]
    return NoisyLoop(source, press.camera, press.noise)


class NothingOpen:
    """What is there while nothing is open: one image in which no pixel has a return."""

    def __init__(self, sensor: Sensor) -> None:
        self.name, self.times_s = NOTHING_OPEN, np.zeros(1)
        self._size = sensor.camera.height, sensor.camera.width

    def __len__(self) -> int:
        return 1

    def __getitem__(self, index: int) -> Frame:
        return Frame(index, 0.0, np.full(self._size, np.nan, np.float32))

    def close(self) -> None:
        """Nothing is held."""


class CachedSource:
    """Keeps the frames of a short source that computes them, so a loop costs them once."""

    def __init__(self, source: FrameSource) -> None:
        self._source = source
        self._frames: dict[int, Frame] = {}
        self.name = source.name
        self.times_s = source.times_s

    def __len__(self) -> int:
        return len(self._source)

    def __getitem__(self, index: int) -> Frame:
        if index not in self._frames:
            self._frames[index] = self._source[index]
        return self._frames[index]

    def truth(self, index: int) -> Truth | None:
        """What is true of a frame."""
        return truth_of(self._source, index)

    def close(self) -> None:
        """Close the source."""
        self._source.close()


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

    source: FrameSource
    pipeline: Pipeline
    side_by_side: SideBySide
    shear: ShearReference
    kept: KeptEstimates = field(default_factory=KeptEstimates)
    beside: PipelineProcess | None = None
    zero: PressureZero | None = None

    def frame(self, index: int) -> Frame:
        """Frame of the source; a recorded one's gas pressure is zeroed."""
        frame = self.source[index]
        return frame if self.zero is None else self.zero.applied(frame)

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
            return replace(solved, remark=_misfit(session.source, session.pipeline))
        return solved

    def newest(
        self, demand: Demand, called_off: Callable[[], bool], *, of_colour: bool = False
    ) -> Solved | None:
        """Products of the newest frame of a live source; None if none comes.

        `called_off`: Whether to stop waiting for a frame; `Deferred` is raised then.
        `of_colour`: Have colour images sent, also for diagnostics that not every frame gets.
        """
        session, end = self._open, time.perf_counter() + WAIT_S
        source, beside = session.source, session.beside
        if not isinstance(source, LiveFrames):
            return None
        source.follow_colour(of_colour)
        while (frame := source.newest(LOOK_S)) is None:
            if called_off():
                raise Deferred
            if source.ended or time.perf_counter() > end:
                return None
        known = "" if beside is None else beside.lost
        solved = self._solved(session, demand, frame, beside=beside)
        source.tell(solved.result, session.pipeline.mesh)
        remark = "" if beside is None or beside.lost == known else _lost(session, beside)
        return replace(solved, outages=source.outages, remark=remark)

    def follow(
        self, object_name: str | None, unit: Literal["m", "mm"] | None, start: np.ndarray | None
    ) -> RigidObject | None:
        """Look for another object from now on, or for none.

        `object_name`: Preset or mesh file.
        `unit`: Of the file; None: by its name.
        `start`: (4, 4) array or None: T_B_O to begin at; None to search.
        """
        obj = None if object_name is None else load_object(object_name, unit)
        self._open.pipeline.follow(obj, start)
        return obj

    def patch(self, result: Result, demand: Demand) -> tuple[Result, Numbers]:
        """Threshold the estimate of a result anew at another κ, without solving."""
        session, estimate = self._open, result.estimate
        if estimate is None:
            raise ValueError("no estimate to threshold")
        masked = "pixel_mask" in demand.products
        patch = session.pipeline.patch(estimate, demand.options, pixel_mask=masked)
        result = _look(session, replace(result, patch=patch), demand)
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
    ) -> tuple[Measured | str, ...]:
        """Measure settings on a frame; a text where one is impossible.

        No settings: let go of what was built for that.
        """
        session = self._open
        bench, measured = session.side_by_side, list[Measured | str]()
        bench.keep([options for options, _ in settings])
        if not settings:
            return ()
        frame, truth = session.frame(index), truth_of(session.source, index)
        if isinstance(session.source, LiveFrames):
            frame = session.source.zero.applied(frame)
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
        of = session.source, session.pipeline, session.shear
        result = _process(*of, frame, demand, beside=beside, settled=settled)
        result = _look(session, result, demand)
        return Solved(demand, result, _kept_numbers(session, result), time.perf_counter())

    def open(self, request: OpenRequest) -> Opened:
        """Open a source in place of the present one.

        Raises InputError: It cannot be opened; the present one stays; Cancelled.
        """
        if request.cancelled.is_set():
            raise Cancelled
        sensor = request.open_sensor()
        source = request.open_source(sensor)
        try:
            if len(source) == 0:
                raise InputError(f"{source.name}: has no frames; choose another recording")
            index = min(max(request.frame, 0), len(source) - 1)
            frame = source[index]
            pipeline = Pipeline.of(sensor, frame.intrinsics, request.options)
            if isinstance(source, LiveFrames):
                source.zero.refer_to(pipeline.model.gas.P0)
            shear = ShearReference()
            products = shear.products(source, pipeline, frame.index, request.demand)
            pipeline.prepare(products)  # apart: says nothing about a frame
            zero = zero_of(source, pipeline) if isinstance(source, Recording) else None
            measured_pa = frame.gas_pressure_pa
            if zero is not None:
                frame, measured_pa = zero.applied(frame), zero.rest_pa or measured_pa
            result = _process(source, pipeline, shear, frame, request.demand)
            if request.cancelled.is_set():
                raise Cancelled
        except BaseException:
            source.close()
            if request.cancelled.is_set():
                raise Cancelled from None
            raise
        self.close()
        settings = SideBySide(sensor, pipeline.camera.intrinsics)
        beside = _beside(source, pipeline)
        session = Session(source, pipeline, settings, shear, beside=beside, zero=zero)
        self.session = session
        grows = isinstance(source, LiveFrames)
        remarks = [str(getattr(source, "remark", ""))]  # recordings have one
        if not grows:  # else its zero tells, once it is known
            remarks.append(gas_warning(measured_pa, pipeline.model.gas.P0))
            remarks.append(_told(zero))
        remark = " ".join(f"{text}." for text in remarks if text)
        marks = source.marks() if isinstance(source, Recording) else ()
        opener = request.open_source
        path = str(opener.path.resolve()) if isinstance(opener, RecordingOpener) else ""
        # a live source that does not grow is the press that the window loops
        simulated = source.simulated if isinstance(source, LiveFrames) else request.live
        facts = SourceFacts(
            source.name, sensor.name, source.times_s, request.live, grows, remark, marks, simulated,
            outages=source.outages if isinstance(source, LiveFrames) else (),
            path=path,
            gas_zero="" if zero is None else zero.words,
        )  # fmt: skip
        numbers = _kept_numbers(session, result)
        result = _look(session, result, request.demand)
        camera, mesh = pipeline.camera, pipeline.mesh
        return Opened(request, facts, sensor, camera, mesh, index, result, numbers)


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
        result = _process(session.source, pipeline, session.shear, frame, demand)
    except InputError:
        return Numbers()  # it says so when somebody looks at it
    return _kept_numbers(session, result)


def _kept_numbers(session: Session, result: Result) -> Numbers:
    """Numbers of a result; its estimate is kept, unless it is of a live source, which goes on."""
    numbers = numbers_of(result, session.pipeline.model.gas)
    if result.estimate is not None and not isinstance(session.source, LiveFrames):
        session.kept.keep(result.frame.index, numbers, result.estimate)
    return numbers


def _look(session: Session, result: Result, demand: Demand) -> Result:
    """The result looked at closer, beside the truth where the source knows it."""
    truth = None
    if isinstance(session.source, NothingOpen):
        return result
    if "kappa_curve" in demand.looks:
        truth = truth_of(session.source, result.frame.index)
    mask = truth.patch_mask if truth is not None else None
    result = session.pipeline.look(result, demand.products, demand.options, mask)
    seen = replace(result.inspection or Inspection(), reference=session.shear.words)
    return replace(result, inspection=seen)


def _process(
    source: FrameSource,
    pipeline: Pipeline,
    shear: ShearReference,
    frame: Frame,
    demand: Demand,
    *,
    beside: PipelineProcess | None = None,
    settled: bool = False,
) -> Result:
    """Products of a frame; a live one's gas pressure is zeroed. `NothingOpen` has none."""
    if isinstance(source, NothingOpen):
        return Result(frame)
    if isinstance(source, LiveFrames):
        frame = zeroed(frame, source.zero, pipeline)
    products = shear.products(source, pipeline, frame.index, demand) - LOOKS.keys()
    if settled:
        pipeline.settle(frame)
    result = (beside or pipeline).process(frame, products, demand.options)
    if products & SHEAR:
        shear.collect(result)
    return result


def _beside(source: FrameSource, pipeline: Pipeline) -> PipelineProcess | None:
    """A process for the frames of one of two cameras: one alone leaves a core to its solver thread.

    A simulation has no images to hurry for.
    """
    if not isinstance(source, LiveFrames) or source.simulated or not source.paired:
        return None
    beside = PipelineProcess(pipeline)
    source.at_end(beside.end)
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


def _misfit(source: FrameSource, pipeline: Pipeline) -> str:
    """What the first frames of a recording say against the sensor file; nothing where touched."""
    if not isinstance(source, Recording):
        return ""
    # what the window starts without
    from bubbleviz.calibration import check_sensor
    from bubbleviz.pressure_zero import ENOUGH
    from bubbleviz.recordings import find_contact_free

    first = HeldFrames([source[k] for k in range(min(ENOUGH, len(source)))], source.name)
    try:
        free = find_contact_free(first).frames
        found = check_sensor(pipeline.model, [first[k] for k in free], quick=True)
    except InputError:
        return ""
    if found.verdict == "drifted" and pipeline.model.pixels is None:
        off = f"{1e3 * found.bias_m:+.2f} mm"
        return f"the sensor file was never calibrated, and depth is {off} off: identify the sensor"
    return "" if found.verdict == "fits" else f"compared with the sensor file: {found.reason}"
