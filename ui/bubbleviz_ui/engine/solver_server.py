"""Serves requests with bubbleviz, in the solver thread. No Qt in here."""

from __future__ import annotations

import time
import traceback
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field, is_dataclass, replace
from pathlib import Path

import numpy as np

from bubbleviz.calibration import PressureZero, zero_of, zeroed
from bubbleviz.diagnostics import Inspection, Numbers, numbers_of, patch_numbers
from bubbleviz.errors import InputError
from bubbleviz.output import Measured, SideBySide
from bubbleviz.pipeline import LOOKS, Pipeline, Product
from bubbleviz.processes import PipelineProcess
from bubbleviz.recordings import (
    Frame,
    FrameSource,
    Recording,
    check_fits,
    gas_warning,
    preset_of_size,
)
from bubbleviz.result import Estimate, Result
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor import Sensor, load_sensor
from bubbleviz.simulation import KnownRecording, NoisyLoop, Truth, known_beside, truth_of
from bubbleviz_ui.engine.requests import (
    Analysed,
    AnalyseRequest,
    Answer,
    CollectRequest,
    Compared,
    CompareRequest,
    Failed,
    Followed,
    FollowRequest,
    FrameRequest,
    NewestRequest,
    Opened,
    OpenRequest,
    PatchRequest,
    Request,
    SettleRequest,
    Solved,
    Thresholded,
    Waited,
)
from bubbleviz_ui.live.live_frames import LiveFrames
from bubbleviz_ui.model.demand import Demand
from bubbleviz_ui.model.source_facts import NOTHING_OPEN, SourceFacts
from bubbleviz_ui.shear.shear_reference import SHEAR, ShearReference

# Estimates of frames, kept so that another κ needs no solving. No Qt in here.


MOST_BYTES = 256 * 2**20
"""Some 6,000 frames of 1,000 nodes; chosen."""


class KeptEstimates:
    """The estimates that were computed last, as many as fit.

    Parameters
    ----------
    most_bytes : int, optional
    """

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

        Raises
        ------
        InputError
            It cannot be opened, does not fit the sensor, or the truth is not its own.
        """
        opened = Recording(self.path)
        try:
            check_fits(opened, sensor, sensor.name)
            if self.truth is not None:
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
    with Recording(path) as opened:
        if opened.size == (present.camera.width, present.camera.height):
            return present
        return load_sensor(preset_of_size(opened.size, str(opened.path)))


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


WAIT_S = 0.05
"""How long the newest frame is waited for before other requests are looked at."""
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

    number: int
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


class Server:
    """Keeps the open source and its pipeline; a request that fails changes nothing.

    Attributes
    ----------
    session : Session or None
    """

    def __init__(self) -> None:
        self.session: Session | None = None
        self._checked: Session | None = None  # whose sensor file was compared with its frames
        self._called_off = False

    @property
    def counts(self) -> dict[str, int]:
        """How often each stage has run for the open source."""
        return dict(self.session.pipeline.counts) if self.session is not None else {}

    def serve(self, request: Request) -> Answer | None:
        """Answer one request; None when it belongs to a session that is gone."""
        try:
            if isinstance(request, OpenRequest):
                return self._open(request)
            session = self.session
            if session is None or session.number != request.session:
                return None
            if isinstance(request, CompareRequest):
                return self._compare(session, request)
            if isinstance(request, FollowRequest):
                return self._follow(session, request)
            if isinstance(request, PatchRequest):
                return self._threshold(session, request)
            if isinstance(request, AnalyseRequest):
                return self._analyse(session, request)
            if isinstance(request, NewestRequest):
                return self._newest(session, request)
            return self._solve(session, request)
        except InputError as error:
            return Failed(request, str(error), "")
        except Exception as error:
            return Failed(request, _in_words(error), traceback.format_exc())

    def wait_no_longer(self) -> None:
        """Have a frame that has not come yet waited for no longer; from another thread."""
        session = self.session
        if session is not None and isinstance(session.source, LiveFrames):
            self._called_off = True
            session.source.wake()

    def close(self) -> None:
        """Let go of the open source."""
        if self.session is not None:
            self.session.close()
            self.session = self._checked = None

    def _solve(self, session: Session, request: FrameRequest) -> Solved:
        frame = session.frame(request.index)
        if isinstance(request, CollectRequest):
            session.shear.forget()
        return self._solved(session, request, frame)

    def _newest(self, session: Session, request: NewestRequest) -> Solved | Waited:
        source = session.source
        if not isinstance(source, LiveFrames):
            return Waited(request, paused=True)
        source.follow_colour(request.of_colour)
        frame = source.newest(WAIT_S)
        if frame is not None:
            return self._solved(session, request, frame)
        called_off, self._called_off = self._called_off, False
        return Waited(request, paused=not called_off)

    def _solved(
        self, session: Session, request: FrameRequest | NewestRequest, frame: Frame
    ) -> Solved:
        settled = isinstance(request, SettleRequest)
        of = session.source, session.pipeline, session.shear
        beside = session.beside if isinstance(request, NewestRequest) else None
        known = "" if beside is None else beside.lost
        result = _process(*of, frame, request.demand, beside=beside, settled=settled)
        if isinstance(session.source, LiveFrames) and isinstance(request, NewestRequest):
            session.source.tell(result, session.pipeline.mesh)
        result = _look(session, result, request.demand)
        numbers, done_s = _kept_numbers(session, result), time.perf_counter()
        outages = session.source.outages if isinstance(session.source, LiveFrames) else ()
        remark = "" if beside is None or beside.lost == known else _lost(session, beside)
        if settled and self._checked is not session:  # in spare time: opening does not wait for it
            self._checked = session
            remark = _misfit(session.source, session.pipeline)
        return Solved(request, result, numbers, done_s, outages, remark)

    def _follow(self, session: Session, request: FollowRequest) -> Followed:
        obj = None
        if request.object_name is not None:
            obj = load_object(request.object_name, request.unit)
        session.pipeline.follow(obj, request.start)
        solved = self._solve(session, request.fit) if request.fit is not None else None
        return Followed(request, obj, solved)

    def _threshold(self, session: Session, request: PatchRequest) -> Thresholded:
        estimate = request.result.estimate
        if estimate is None:
            raise ValueError("no estimate to threshold")
        demand = request.demand
        masked = "pixel_mask" in demand.products
        patch = session.pipeline.patch(estimate, demand.options, pixel_mask=masked)
        result = _look(session, replace(request.result, patch=patch), demand)
        numbers = numbers_of(result, session.pipeline.model.gas)
        return Thresholded(request, result, numbers)

    def _analyse(self, session: Session, request: AnalyseRequest) -> Analysed:
        """As many frames as there is time for, and one at least."""
        end, numbers = time.perf_counter() + SLICE_S, list[Numbers | None]()
        for index in request.frames:
            numbers.append(_numbers(session, request, index))
            if time.perf_counter() > end:
                break
        return Analysed(request, tuple(numbers))

    def _compare(self, session: Session, request: CompareRequest) -> Compared | None:
        session.side_by_side.keep([options for options, _ in request.settings])
        if not request.settings:
            return None
        frame, truth = session.frame(request.index), truth_of(session.source, request.index)
        if isinstance(session.source, LiveFrames):
            frame = session.source.zero.applied(frame)
        bench, settled, measured = session.side_by_side, request.settled, list[Measured | str]()
        for options, rule in request.settings:
            try:
                measured.append(bench.measure(options, frame, rule, truth, settled=settled))
            except InputError as error:
                measured.append(str(error))
        return Compared(request, (measured[0], measured[1]))

    def _open(self, request: OpenRequest) -> Opened | None:
        if request.cancelled.is_set():
            return None
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
        except BaseException:
            source.close()
            if request.cancelled.is_set():
                return None
            raise
        if request.cancelled.is_set():
            source.close()
            return None
        self.close()
        settings = SideBySide(sensor, pipeline.camera.intrinsics)
        beside = _beside(source, pipeline)
        session = Session(
            request.session, source, pipeline, settings, shear, beside=beside, zero=zero
        )
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


def _numbers(session: Session, request: AnalyseRequest, index: int) -> Numbers | None:
    """Numbers of a frame, the patch alone found anew where its estimate is kept."""
    demand, pipeline = request.demand, session.pipeline
    kept = session.kept.get(index)
    if kept is not None and demand.products <= PATCHED:
        known, estimate = kept
        patch = pipeline.patch(estimate, demand.options)
        return replace(known, **patch_numbers(patch, trusted=estimate.trusted))
    if request.kept_only:
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
        f"{session.source.name}: the process that solved its frames has ended ({beside.lost}); "
        "they are solved in the window's own from now on, which may be slower"
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
    from bubbleviz.calibration import ENOUGH, CollectedFrames, check_sensor, find_contact_free

    first = CollectedFrames(source.name, [source[k] for k in range(min(ENOUGH, len(source)))])
    try:
        free = find_contact_free(first).frames
        found = check_sensor(pipeline.model, [first[k] for k in free], quick=True)
    except InputError:
        return ""
    if found.verdict == "drifted" and pipeline.model.pixels is None:
        off = f"{1e3 * found.bias_m:+.2f} mm"
        return f"the sensor file was never calibrated, and depth is {off} off: identify the sensor"
    return "" if found.verdict == "fits" else f"compared with the sensor file: {found.reason}"


def _in_words(error: Exception) -> str:
    return f"{type(error).__name__}: {error}".splitlines()[0][:300]
