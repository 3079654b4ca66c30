"""The session model: what is open, where the cursor is, what the user chose. No Qt in here."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Literal, Protocol

import numpy as np

from bubbleviz.numbers import Numbers
from ui.history import History, grown
from ui.units import SYSTEMS, Units

CloudColour = Literal["residual", "patch", "plain"]
Axis = Literal["x", "y", "z"]
ColourMap = Literal["inferno", "viridis", "cividis", "magma", "plasma"]
COLOUR_MAPS: tuple[ColourMap, ...] = ("inferno", "viridis", "cividis", "magma", "plasma")
"""All perceptually uniform (van der Walt and Smith 2015; Nuñez 2018)."""
ImageName = Literal["depth", "change", "residual", "noise", "used", "patch"]
ThemeName = Literal["system", "dark", "light"]

LAYERS = ("membrane", "wireframe", "contour", "cloud", "force", "readout", "frustum", "rim",
          "vectors", "object", "fit")  # fmt: skip
"""Names of the 3-D layers, in the order the panel lists them."""


SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Playback speeds to choose from."""
PATCH_CHOICES = frozenset({"kappa", "least_area_m2"})
"""Choices that make another patch of the same contact pressure."""
POSE_CHOICES = frozenset({"pose_object", "pose_unit"})
"""Choices that make it another object."""
PRE_ROLL_S = 2.0
LOOPBACK = "tcp/127.0.0.1:7448"
"""Where results are published unless told otherwise: this computer only."""


@dataclass(frozen=True)
class Setting:
    """A setting of the estimator to compare; None is bubbleviz's default.

    Attributes
    ----------
    solver : str or None
    pressure_scale : float or None
        Contact pressure expected, in gauge pressures.
    recasts : int or None
        How often rays are cast again in a frame.
    nodes : int or None
        Of the mesh; None: the sensor's.
    block : int or None
        Side of the squares of pixels that are averaged.
    """

    solver: str | None = None
    pressure_scale: float | None = None
    recasts: int | None = None
    nodes: int | None = None
    block: int | None = None


@dataclass(frozen=True)
class Choices:
    """What the user chose; it outlives new data.

    Attributes
    ----------
    kappa : float or None
        Patch threshold, multiple of the mean contact pressure; None for bubbleviz's default.
    least_area_m2 : float
        Parts of the patch smaller than this are left out.
    solver : str or None
        Solver of the inverse problem; None for bubbleviz's default.
    speed : float
        Playback speed, 1 = as recorded.
    every_frame : bool
        Playback waits for each frame, however slow; else it keeps time and leaves some out.
    loop : bool
        Begin again after the last frame, or the last of the looped range.
    layers, panels : frozenset of str
        What is visible.
    plots, images : frozenset of str
        What the panels of these names show.
    cloud_colour : {"residual", "patch", "plain"}
        What colours the measured points.
    cloud_points : int or None
        Points drawn at most: beyond that, every n-th measured point; None for all. Of 10,000
        on the dome each has some 4×4 screen pixels, so one sees both them and the membrane.
    membrane_opacity : float
        0 … 1.
    view_from : (float, float, float)
        Direction in B that a fresh view looks from, towards the middle of the membrane.
    zoom : float
        How near a fresh view is; 1 shows the whole box around the membrane.
    colour_map : str
        Of the contact pressure, one of `COLOUR_MAPS`.
    exaggeration : float
        Drawn displacement in true ones.
    section_axis : {"x", "y", "z"} or None
        Normal of the plane that cuts the scene open; None: it is whole.
    section_at_m : float
        Where the plane crosses its axis.
    section_flipped : bool
        The other side is drawn.
    pressure_max_pa, residual_max_m : float or None
        Upper ends of the colour ranges; None: the largest value seen, rounded up.
    pose_object : str or None
        Object to look for: preset or mesh file; None for none.
    pose_unit : {"m", "mm"} or None
        Of the mesh file; None: by its name.
    pose_start : tuple of 7 float or None
        T_B_O the search begins at, x y z in m and qx qy qz qw; None: all around.
    pose_track : bool
        Follow the object that is chosen in every frame.
    pose_stage : int
        Stage whose pose the object is drawn at; 2 for both.
    compared : (Setting, Setting)
        What is measured side by side.
    picture_size : (int, int)
        Width and height of pictures of the 3-D view, pixels.
    pre_roll_s : float
        How much of what came before the record button is recorded, too.
    record_folder : str or None
        Where recordings go; None: where the program was started.
    publish_at : str
        Where results are published once that is asked for.
    length_unit, pressure_unit, force_unit, duration_unit : str
        What numbers are shown in, see `units.SYSTEMS`.
    theme : {"system", "dark", "light"}
        Colours of the window.
    """

    kappa: float | None = None
    least_area_m2: float = 0.0
    solver: str | None = None
    speed: float = 1.0
    every_frame: bool = False
    loop: bool = True
    layers: frozenset[str] = frozenset(LAYERS) - {"wireframe", "frustum", "vectors"}
    panels: frozenset[str] = frozenset({"kappa_panel", "status"})
    plots: frozenset[str] = frozenset({"force", "gas", "area"})
    images: frozenset[ImageName] = frozenset({"depth", "change", "residual"})
    cloud_colour: CloudColour = "residual"
    cloud_points: int | None = 10_000
    membrane_opacity: float = 1.0
    view_from: tuple[float, float, float] = (-0.6, -1.0, 1.1)
    zoom: float = 1.32
    colour_map: ColourMap = "inferno"
    exaggeration: float = 1.0
    section_axis: Axis | None = None
    section_at_m: float = 0.0
    section_flipped: bool = False
    pressure_max_pa: float | None = None
    residual_max_m: float | None = None
    pose_object: str | None = None
    pose_unit: Literal["m", "mm"] | None = None
    pose_start: tuple[float, float, float, float, float, float, float] | None = None
    pose_track: bool = False
    pose_stage: int = 2
    compared: tuple[Setting, Setting] = (Setting(), Setting(recasts=0))
    picture_size: tuple[int, int] = (1920, 1080)
    pre_roll_s: float = PRE_ROLL_S
    record_folder: str | None = None
    publish_at: str = LOOPBACK
    length_unit: Literal["mm", "m"] = "mm"
    pressure_unit: Literal["kPa", "Pa", "psi"] = "kPa"
    force_unit: Literal["N", "mN"] = "N"
    duration_unit: Literal["ms", "s"] = "ms"
    theme: ThemeName = "system"


class HasRule(Protocol):
    """What says what makes a patch of a contact pressure: choices, and requests made of them."""

    @property
    def kappa(self) -> float | None:
        """See `Choices`."""

    @property
    def least_area_m2(self) -> float:
        """See `Choices`."""


Rule = tuple[float | None, float]


def rule_of(thing: HasRule) -> Rule:
    """What makes a patch of a contact pressure."""
    return thing.kappa, thing.least_area_m2


@dataclass(frozen=True)
class SourceFacts:
    """What the window says about the open source.

    Attributes
    ----------
    title : str
        Name of the source.
    sensor_name : str
        Name of the sensor.
    times_s : (F,) array
        Time of each frame, s.
    live : bool
        A live source, not a recording.
    grows : bool
        Frames are added while one looks.
    remark : str
        What the user should know about it; empty for nothing.
    """

    title: str
    sensor_name: str
    times_s: np.ndarray
    live: bool = False
    grows: bool = False
    remark: str = ""

    @property
    def frames(self) -> int:
        """Count the frames."""
        return len(self.times_s)

    @property
    def rate_hz(self) -> float:
        """Mean frame rate of the camera, Hz; NaN for a single frame."""
        span = float(self.times_s[-1] - self.times_s[0]) if self.frames else 0.0
        return (self.frames - 1) / span if span > 0 else float("nan")


@dataclass(frozen=True)
class SourceChanged:
    """Another source or sensor is open."""

    facts: SourceFacts


@dataclass(frozen=True)
class FrameChanged:
    """The cursor moved; `by_playback` tells it from a person's seek."""

    index: int
    by_playback: bool


@dataclass(frozen=True)
class PlayingChanged:
    """Playback started or stopped."""

    playing: bool


@dataclass(frozen=True)
class ChoicesChanged:
    """The user chose something: the names of the fields of `Choices` that differ."""

    names: frozenset[str]


@dataclass(frozen=True)
class RangeChanged:
    """Another range of frames is played, first and last; None: all."""

    frames: tuple[int, int] | None


@dataclass(frozen=True)
class MarkersChanged:
    """Frames the user has marked."""

    frames: tuple[int, ...]


@dataclass(frozen=True)
class FrozenChanged:
    """The view of a live source stands still, or goes on."""

    frozen: bool


@dataclass(frozen=True)
class HistoryChanged:
    """More is known of some frames, or less."""


Event = (
    SourceChanged
    | FrameChanged
    | PlayingChanged
    | ChoicesChanged
    | RangeChanged
    | MarkersChanged
    | FrozenChanged
    | HistoryChanged
)


class SessionState:
    """Single place where the window's state lives; views subscribe to its events.

    Attributes
    ----------
    choices : Choices
    facts : SourceFacts or None
        None until a source is open.
    frame : int
        Cursor: the frame the user wants to see.
    playing : bool
    frozen : bool
        The cursor stays while the live source goes on.
    now : int
        Frame a live source is at.
    play_range : (int, int) or None
        First and last frame to play; None for all.
    markers : tuple of int
        Marked frames, in order.
    history : History
        What was computed so far.
    units : Units
    """

    def __init__(self, choices: Choices | None = None) -> None:
        self.choices = choices or Choices()
        self.facts: SourceFacts | None = None
        self.frame = 0
        self.playing = False
        self.frozen = False
        self.now = 0
        self.play_range: tuple[int, int] | None = None
        self.markers: tuple[int, ...] = ()
        self.history = History(0)
        self.units = Units()
        self.units.use({name: getattr(self.choices, name) for name in SYSTEMS})
        self._observers: list[Callable[[Event], None]] = []

    def subscribe(self, observer: Callable[[Event], None]) -> None:
        """Call `observer` with every event from now on."""
        self._observers.append(observer)

    def unsubscribe_all(self) -> None:
        """Forget every observer (the window closes)."""
        self._observers.clear()

    def open(
        self,
        facts: SourceFacts,
        frame: int = 0,
        *,
        playing: bool,
        history: History | None = None,
    ) -> None:
        """Change to another source: choices stay, the cursor goes to `frame`."""
        same = self.facts is not None and self.facts.title == facts.title
        if not same or (self.facts is not None and self.facts.frames != facts.frames):
            self.play_range, self.markers = None, ()
        self.facts = facts
        self.history = History(facts.frames) if history is None else history
        self.frame = self.now = min(max(frame, 0), facts.frames - 1)
        self.frozen = False
        self._tell(SourceChanged(facts))
        self.set_playing(playing)

    def seek(self, index: int, *, by_playback: bool = False) -> None:
        """Move the cursor, held inside the recording; a live source goes on without it."""
        if self.facts is None:
            return
        if self.facts.live and self.playing and not by_playback:
            self.freeze(True)
        index = min(max(index, 0), self.facts.frames - 1)
        if index == self.frame:
            return
        self.frame = index
        self._tell(FrameChanged(index, by_playback))

    def step(self, frames: int) -> None:
        """Stop playing and move the cursor by a number of frames."""
        if self.facts is not None and not self.facts.live:
            self.set_playing(False)
        self.seek(self.frame + frames)

    def jump(self, seconds: float) -> None:
        """Stop playing and move the cursor by a time, by one frame at least."""
        if self.facts is None:
            return
        times = self.facts.times_s
        nearest = int(np.abs(times - (times[self.frame] + seconds)).argmin())
        away = nearest - self.frame
        self.step(away if away * seconds > 0 else int(np.sign(seconds)))

    def grow(self, time_s: float) -> None:
        """Take one more frame of a live source, and go on to it."""
        facts = self.facts
        if facts is not None:
            count = facts.frames + 1
            times = grown(facts.times_s, count, np.nan)
            times[-1] = time_s
            self.facts = replace(facts, times_s=times)
            self.history.grow(count)
            self.go_on(count - 1)

    def go_on(self, index: int) -> None:
        """Take the frame that playback, or a live source, is at now."""
        self.now = index
        if not self.frozen:
            self.seek(index, by_playback=True)

    def freeze(self, frozen: bool) -> None:
        """Let a live source go on unseen, or come back to now."""
        if self.facts is None or not self.facts.live or frozen == self.frozen:
            return
        self.frozen = frozen
        self._tell(FrozenChanged(frozen))
        if not frozen:
            self.seek(self.now, by_playback=True)

    def choose_range(self, frames: tuple[int, int] | None) -> None:
        """Play only from one frame to another."""
        if frames is not None and self.facts is not None:
            first, last = sorted(min(max(k, 0), self.facts.frames - 1) for k in frames)
            frames = (first, last) if first < last else None
        if frames != self.play_range:
            self.play_range = frames
            self._tell(RangeChanged(frames))

    def toggle_marker(self, frame: int) -> None:
        """Mark a frame, or take its mark away."""
        self.choose_markers(tuple(sorted(set(self.markers) ^ {frame})))

    def choose_markers(self, frames: tuple[int, ...]) -> None:
        """Mark these frames, in order, and no others."""
        self.markers = frames
        self._tell(MarkersChanged(frames))

    def seek_marker(self, direction: int) -> None:
        """Go to the next marker (1) or the one before (-1)."""
        ahead = [k for k in self.markers if (k - self.frame) * direction > 0]
        if ahead:
            self.step(min(ahead, key=lambda k: abs(k - self.frame)) - self.frame)

    def remember(
        self, frames: Sequence[int], numbers: Sequence[Numbers], *, same_patch: bool
    ) -> None:
        """Keep what was computed of some frames; of the patch only where it is the present one."""
        for frame, known in zip(frames, numbers, strict=True):
            self.history.take(frame, known, patch=same_patch)
        self._tell(HistoryChanged())

    def set_playing(self, playing: bool) -> None:
        """Start or stop playback; starting at the end begins at the first frame."""
        if self.facts is None or playing == self.playing:
            return
        first, last = self.play_range or (0, self.facts.frames - 1)
        outside = not first <= self.frame <= last
        over = outside or (not self.choices.loop and self.frame == last)
        if playing and over and not self.facts.grows:
            self.seek(first)
        self.playing = playing
        self._tell(PlayingChanged(playing))

    def choose(self, **changes: Any) -> None:
        """Change choices by name; observers hear which ones differ."""
        new = replace(self.choices, **changes)
        names = frozenset(
            f.name for f in fields(new) if getattr(new, f.name) != getattr(self.choices, f.name)
        )
        if names:
            self.choices = new
            self.units.use({name: getattr(new, name) for name in names & SYSTEMS.keys()})
            if names & PATCH_CHOICES:
                self.history.forget_patches()
            self._tell(ChoicesChanged(names))

    def choose_layer(self, name: str, visible: bool) -> None:
        """Show or hide a 3-D layer."""
        layers = self.choices.layers
        self.choose(layers=layers | {name} if visible else layers - {name})

    def choose_panel(self, name: str, visible: bool) -> None:
        """Note that a panel that shows results is open or closed."""
        panels = self.choices.panels
        self.choose(panels=panels | {name} if visible else panels - {name})

    def _tell(self, event: Event) -> None:
        for observer in tuple(self._observers):
            observer(event)
