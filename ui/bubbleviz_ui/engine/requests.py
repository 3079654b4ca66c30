"""What the window asks of the solver thread, and what comes back: values, never live objects."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Condition, Event
from typing import Literal

import numpy as np

from bubbleviz.camera import DepthCamera
from bubbleviz.diagnostics import Numbers
from bubbleviz.inverse import EstimatorOptions
from bubbleviz.membrane import MembraneMesh
from bubbleviz.output import Measured
from bubbleviz.pipeline import FrameOptions
from bubbleviz.recordings import FrameSource, Gap
from bubbleviz.result import Result
from bubbleviz.rigid_object import RigidObject
from bubbleviz.sensor import Sensor
from bubbleviz_ui.model.demand import Demand
from bubbleviz_ui.model.source_facts import SourceFacts

ComparedOptions = tuple[EstimatorOptions, FrameOptions]
"""What makes the estimate and the patch of a setting."""


@dataclass(frozen=True)
class OpenRequest:
    """Open a source with a sensor and show a frame of it.

    Attributes
    ----------
    session : int
        Generation of the session it would start.
    what : str
        What to call it in a message.
    open_source, open_sensor : callable
        Make the source and the sensor; called in the solver thread.
    frame : int
        Frame to show first; proof that the source can be used with the sensor.
    demand : Demand
        Of that frame.
    options : EstimatorOptions
    playing, live : bool
        Play once it is open; it is a live source.
    cancelled : Event
        Set: nobody waits for it any more.
    """

    session: int
    what: str
    open_source: Callable[[Sensor], FrameSource]
    open_sensor: Callable[[], Sensor]
    frame: int
    demand: Demand
    options: EstimatorOptions = field(default_factory=EstimatorOptions)
    playing: bool = False
    live: bool = False
    cancelled: Event = field(default_factory=Event, compare=False)


@dataclass(frozen=True)
class FrameRequest:
    """Make products of one frame.

    `asked_s` is when it was asked for, by `time.perf_counter`; None where nobody waits.
    """

    session: int
    demand: Demand
    index: int
    asked_s: float | None = None


@dataclass(frozen=True)
class SettleRequest(FrameRequest):
    """Make products of a frame one stays at, the same whatever was looked at before it."""


@dataclass(frozen=True)
class CollectRequest(FrameRequest):
    """Make products of a frame, with the contact-free colour images found anew."""


@dataclass(frozen=True)
class FollowRequest:
    """Look for another object from now on, or for none.

    Attributes
    ----------
    session : int
    object_name : str or None
        Preset or mesh file.
    unit : {"m", "mm"} or None
        Of the file; None: by its name.
    start : (4, 4) array or None
        T_B_O to begin at; None to search.
    fit : FrameRequest or None
        Frame to fit at once.
    """

    session: int
    demand: Demand
    object_name: str | None
    unit: Literal["m", "mm"] | None
    start: np.ndarray | None
    fit: FrameRequest | None = None


@dataclass(frozen=True)
class NewestRequest:
    """Make products of the newest frame of a live source, as soon as there is one.

    `from_s`, by `time.perf_counter`, is when it may be taken at the earliest. `of_colour` says
    whether the source is to send colour images, also for looks that not every frame gets.
    """

    session: int
    demand: Demand
    from_s: float = 0.0
    of_colour: bool = False


@dataclass(frozen=True)
class AnalyseRequest:
    """Compute the numbers of frames nobody looks at; a part of them at a time.

    With `kept_only` those alone whose estimates are kept.
    """

    session: int
    demand: Demand
    frames: tuple[int, ...]
    kept_only: bool = False


@dataclass(frozen=True)
class CompareRequest:
    """Measure two settings on one frame; none: let go of what was built for that.

    `settled`: the same whatever was looked at before it, as the frame one stays at.
    """

    session: int
    index: int
    settings: tuple[ComparedOptions, ...]
    settled: bool = False


@dataclass(frozen=True)
class PatchRequest:
    """Threshold the estimate of a result anew at another κ, without solving."""

    session: int
    demand: Demand
    result: Result


Request = (
    OpenRequest
    | FollowRequest
    | FrameRequest
    | NewestRequest
    | PatchRequest
    | AnalyseRequest
    | CompareRequest
)


@dataclass(frozen=True)
class Opened:
    """A source is open; the solver thread keeps it."""

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

    request: FrameRequest | NewestRequest
    result: Result
    numbers: Numbers
    done_s: float = float("nan")
    outages: tuple[Gap, ...] = ()
    remark: str = ""


@dataclass(frozen=True)
class Waited:
    """No frame came while it was waited for.

    Either the source is `paused`, or the wait was called off for another request.
    """

    request: NewestRequest
    paused: bool


@dataclass(frozen=True)
class Analysed:
    """Numbers of the first frames of a request; the others are to be asked for again.

    None for a frame whose estimate is not kept.
    """

    request: AnalyseRequest
    numbers: tuple[Numbers | None, ...]


@dataclass(frozen=True)
class Followed:
    """The object that is looked for now, and the frame that was to be fitted."""

    request: FollowRequest
    obj: RigidObject | None
    solved: Solved | None


@dataclass(frozen=True)
class Thresholded:
    """A result with its patch at another κ."""

    request: PatchRequest
    result: Result
    numbers: Numbers


@dataclass(frozen=True)
class Compared:
    """What two settings make of a frame; a text where a setting is impossible."""

    request: CompareRequest
    measured: tuple[Measured | str, Measured | str]


@dataclass(frozen=True)
class Failed:
    """A request that could not be served: one line for a person, and the details.

    As a `warning` it was served all the same.
    """

    request: Request
    message: str
    details: str
    warning: bool = False


Answer = Opened | Followed | Solved | Waited | Thresholded | Analysed | Compared | Failed


# When requests are served: the latest of each kind, so nothing queues up, and none too early.


SLACK_S = 0.004
"""How long a result may wait for the window: a little, so that the window does not wait for it."""
GAIN = 0.4  # of the delay's integral control; chosen
MOST_S = 0.1  # s; longer delays are felt


class RequestSlots:
    """One waiting request of each kind, taken in the order of `ORDER`.

    One that is not due yet is waited for, unless one before it in that order comes.
    """

    ORDER: tuple[type[Request], ...] = (
        OpenRequest,
        FollowRequest,
        CollectRequest,
        PatchRequest,
        FrameRequest,
        NewestRequest,
        SettleRequest,
        CompareRequest,
        AnalyseRequest,
    )

    def __init__(self) -> None:
        self._waiting: dict[type[Request], Request] = {}
        self._changed = Condition()
        self._closed = False

    def put(self, request: Request) -> Request | None:
        """Leave a request; returns the one it replaces, which will never be served.

        A request for a frame also drops one to settle a frame: the user has left it.
        """
        with self._changed:
            replaced = self._waiting.get(type(request))
            if type(request) is FrameRequest:
                self._waiting.pop(SettleRequest, None)
            self._waiting[type(request)] = request
            self._changed.notify()
        return replaced

    def take(self) -> Request | None:
        """Wait for a request; None once the slots are closed."""
        with self._changed:
            while not self._closed:
                first = next((kind for kind in self.ORDER if kind in self._waiting), None)
                wait_s = None if first is None else _due_in_s(self._waiting[first])
                if first is not None and not wait_s:
                    return self._waiting.pop(first)
                self._changed.wait(wait_s)
            return None

    def goes_before_newest(self, request: Request) -> bool:
        """Whether the next frame of a live source is not to be waited for before this."""
        return self.ORDER.index(type(request)) < self.ORDER.index(NewestRequest)

    def close(self) -> None:
        """Wake the taker and let it go."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()


def _due_in_s(request: Request) -> float:
    if not isinstance(request, NewestRequest):
        return 0.0
    return max(request.from_s - time.perf_counter(), 0.0)


class RequestDelay:
    """Delays requests while the window draws: a frame taken too early would be old by then.

    Attributes
    ----------
    hold_s : float
        How long after the last result the next frame is to be taken.
    """

    def __init__(self) -> None:
        self.hold_s = 0.0

    def waited(self, seconds: float) -> None:
        """Take note of how long a result waited for the window."""
        self.hold_s = min(max(self.hold_s + GAIN * (seconds - SLACK_S), 0.0), MOST_S)
