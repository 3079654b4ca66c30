"""The session model: what is open, where the cursor is, what the user chose. No Qt in here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import numpy as np

from ui.units import Units

CloudColour = Literal["residual", "patch", "plain"]

LAYERS = ("membrane", "wireframe", "contour", "cloud", "force", "readout", "frustum", "rim")
"""Names of the 3-D layers, in the order the panel lists them."""


@dataclass(frozen=True)
class Choices:
    """What the user chose; it outlives new data.

    Attributes
    ----------
    kappa : float or None
        Patch threshold, multiple of the mean contact pressure; None for bubbleviz's default.
    solver : str or None
        Solver of the inverse problem; None for bubbleviz's default.
    speed : float
        Playback speed, 1 = as recorded.
    loop : bool
        Begin again after the last frame.
    layers, panels : frozenset of str
        What is visible.
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
    pressure_max_pa, residual_max_m : float or None
        Upper ends of the colour ranges; None: the largest value seen, rounded up.
    """

    kappa: float | None = None
    solver: str | None = None
    speed: float = 1.0
    loop: bool = True
    layers: frozenset[str] = frozenset(LAYERS) - {"wireframe", "frustum"}
    panels: frozenset[str] = frozenset({"kappa_panel", "status"})
    cloud_colour: CloudColour = "residual"
    cloud_points: int | None = 10_000
    membrane_opacity: float = 1.0
    view_from: tuple[float, float, float] = (-0.6, -1.0, 1.1)
    zoom: float = 1.32
    pressure_max_pa: float | None = None
    residual_max_m: float | None = None


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
    """

    title: str
    sensor_name: str
    times_s: np.ndarray
    live: bool = False

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


Event = SourceChanged | FrameChanged | PlayingChanged | ChoicesChanged


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
    units : Units
    """

    def __init__(self, choices: Choices | None = None) -> None:
        self.choices = choices or Choices()
        self.facts: SourceFacts | None = None
        self.frame = 0
        self.playing = False
        self.units = Units()
        self._observers: list[Callable[[Event], None]] = []

    def subscribe(self, observer: Callable[[Event], None]) -> None:
        """Call `observer` with every event from now on."""
        self._observers.append(observer)

    def unsubscribe_all(self) -> None:
        """Forget every observer (the window closes)."""
        self._observers.clear()

    def open(self, facts: SourceFacts, frame: int = 0, *, playing: bool) -> None:
        """Change to another source: choices stay, the cursor goes to `frame`."""
        self.facts = facts
        self.frame = min(max(frame, 0), facts.frames - 1)
        self._tell(SourceChanged(facts))
        self.set_playing(playing)

    def seek(self, index: int, *, by_playback: bool = False) -> None:
        """Move the cursor, held inside the recording."""
        if self.facts is None:
            return
        index = min(max(index, 0), self.facts.frames - 1)
        if index == self.frame:
            return
        self.frame = index
        self._tell(FrameChanged(index, by_playback))

    def step(self, frames: int) -> None:
        """Stop playing and move the cursor by a number of frames."""
        self.set_playing(False)
        self.seek(self.frame + frames)

    def set_playing(self, playing: bool) -> None:
        """Start or stop playback; starting at the end begins at the first frame."""
        if self.facts is None or playing == self.playing:
            return
        if playing and not self.choices.loop and self.frame == self.facts.frames - 1:
            self.seek(0)
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
