"""An identification that goes step by step, and does again only what a change asks for.

A person at a window takes a sample out, moves a threshold, goes a step back: `Workbench.work`
answers each such choice with a `Draft`, and remembers the last few results of every step by what
they rest on. A command has all steps done at once.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from bubbleviz.calibration.identification import Identification, assemble, rest_gauge
from bubbleviz.calibration.material import Vented, collect_press, with_rubber
from bubbleviz.calibration.rectification import Level, rectify
from bubbleviz.calibration.rest_frames import (
    Samples,
    as_ranges,
    collect,
    numbers,
    select_pixels,
)
from bubbleviz.calibration.surface import fit_surfaces, segment_membrane
from bubbleviz.calibration.tension import estimate_tension
from bubbleviz.calibration.validation import Validation
from bubbleviz.camera import PixelModel
from bubbleviz.errors import InputError
from bubbleviz.progress import Progress, part_of, quiet
from bubbleviz.recordings import FrameSource, KeptFrames, Recording, find_contact_free
from bubbleviz.sensor import Sensor

if TYPE_CHECKING:
    from bubbleviz.calibration.rest_frames import Ranges
    from bubbleviz.calibration.surface import Name, Surfaces
    from bubbleviz.calibration.validation import KnownPress
    from bubbleviz.recordings import ContactFree


class Step(IntEnum):
    START = 0
    FRAMES = 1
    PIXELS = 2
    SURFACE = 3
    TENSION = 4


@dataclass(frozen=True)
class Settings:
    """What a person decides; the rest follows."""

    reached: Step = Step.START  # the last step to do
    # contact-free frames, first and one after the last of each range; None: found
    ranges: Ranges | None = None
    # share of the frames in which a pixel must have a return; None: nine tenths of the usual
    min_validity: float | None = None
    # robust standard deviations beyond which a pixel is too noisy, or too far off
    deviations: float = 3.0
    surface: Name | None = None  # None: the data choose
    nodes: int = 1000  # target number of nodes of the mesh
    # of the untouched sensor at other inflation levels; of the open chamber, for the atmospheric
    # pressure
    levels: tuple[FrameSource | Path, ...] = ()
    vented: FrameSource | Path | None = None
    level_sigma_pa: float | None = None  # of a gas pressure beside that of another recording, Pa
    press: KnownPress | None = None  # what to validate by, in the same source
    # whether a press that is held is asked for λ and gauge pressure where there are no levels
    held_press: bool = True
    scored: bool = True  # whether contact-free frames are looked for where they are given


@dataclass(frozen=True)
class Draft:
    """What is known after the steps so far; None where a step was not reached."""

    settings: Settings
    ranges: Ranges = ()  # contact-free frames in use
    contact_free: ContactFree | None = None  # what was found, whether or not it is used
    samples: Samples | None = None
    # of the step SURFACE on less its bias; before, by validity and noise alone
    pixels: PixelModel | None = None
    surfaces: Surfaces | None = None
    found: Identification | None = None  # rectified by the other levels, where there are
    validation: Validation | None = None


_KEPT = 3  # results of a step: the present one, the one undone, and one more
_SHARES = {Step.FRAMES: 0.1, Step.PIXELS: 0.1, Step.SURFACE: 0.2, Step.TENSION: 0.6}
"""Of the time that the steps take, about."""

T = TypeVar("T")


class Workbench:
    """One source and the sensor file to start from."""

    def __init__(self, source: FrameSource, sensor: Sensor) -> None:
        self.source, self.sensor = source, sensor
        self._kept: dict[str, OrderedDict[Hashable, object]] = {}

    def work(self, settings: Settings, progress: Progress = quiet) -> Draft:
        """Do the steps up to the one reached.

        Raises InputError: whatever makes the answer worthless, as in `bubbleviz.identify`. Raises
        Cancelled: by `progress`; what was finished before is remembered, nothing else has changed.
        """
        draft, done = Draft(settings), 0.0
        steps = self._frames, self._pixels, self._surface, self._tension
        wanted = [step for step in _SHARES if settings.reached >= step]
        total = sum(_SHARES[step] for step in wanted)
        for step, do in zip(wanted, steps, strict=False):
            before, done = done, done + _SHARES[step] / total
            own = (
                _errors_name(self.source) if step < Step.TENSION else nullcontext()
            )  # others follow
            with own:
                draft = do(draft, part_of(progress, before, done))
        progress("done", 1.0)
        return draft

    def _frames(self, draft: Draft, progress: Progress) -> Draft:
        chosen, found = draft.settings.ranges, None
        if chosen is None or draft.settings.scored:
            try:
                found = self._once("rest", (), lambda: find_contact_free(self.source, progress))
            except InputError:
                if chosen is None:
                    raise  # else the operator knows better, and has said so
        ranges = as_ranges(found.frames) if chosen is None and found else chosen
        return replace(draft, ranges=ranges or (), contact_free=found)

    def _pixels(self, draft: Draft, progress: Progress) -> Draft:
        chosen = numbers(draft.ranges)
        samples = self._once(
            "samples", draft.ranges, lambda: collect(self.source, self.sensor, chosen, progress)
        )
        draft = replace(draft, samples=samples)
        if draft.settings.reached > Step.PIXELS:
            return draft  # pixels are chosen by the surface
        membrane, _ = self._once("membrane", draft.ranges, lambda: segment_membrane(samples))
        nothing = np.where(membrane, 0.0, np.nan)  # no surface yet to be off from
        return self._select(draft, samples, membrane, nothing)

    def _surface(self, draft: Draft, progress: Progress) -> Draft:
        settings, samples = draft.settings, _known(draft.samples)
        surfaces = self._once(
            "surfaces",
            (draft.ranges, settings.nodes, settings.surface),
            lambda: fit_surfaces(samples, settings.nodes, settings.surface, progress),
        )
        draft = replace(draft, surfaces=surfaces)
        return self._select(draft, samples, surfaces.membrane, surfaces.residual_m)

    def _tension(self, draft: Draft, progress: Progress) -> Draft:
        settings, onwards = draft.settings, part_of(progress, 0.5, 0.6)
        vented = None if settings.vented is None else self._vented(settings.vented)
        found = self._at_rest(draft, vented, part_of(progress, 0.0, 0.5))
        levels = [self._level(each, settings.nodes, onwards) for each in settings.levels]
        found = rectify(found, levels)
        found = self._once(
            "rubber",
            replace(settings, press=None),
            lambda: self._with_rubber(found, levels, vented, settings, part_of(progress, 0.6, 0.9)),
        )
        draft = replace(draft, pixels=found.pixels, found=found)
        if (press := settings.press) is None:
            return draft
        progress("predicting the known press", 0.9)
        validation = self._once(
            "validation", settings, lambda: press.validate(found.model, self.source)
        )
        return replace(draft, validation=validation)

    def _at_rest(self, draft: Draft, vented: Vented | None, progress: Progress) -> Identification:
        settings, samples, surfaces = draft.settings, _known(draft.samples), _known(draft.surfaces)
        sensor = self.sensor if vented is None else vented.set_in(self.sensor)
        with _errors_name(self.source):
            gauge = rest_gauge(samples, sensor)
            tension = self._once(
                "tension",
                (draft.ranges, settings.nodes, settings.surface, settings.vented),
                lambda: estimate_tension(samples, surfaces, *gauge, progress),
            )
        return assemble(sensor, samples, surfaces, _known(draft.pixels), tension)

    def _with_rubber(
        self,
        found: Identification,
        levels: list[Level],
        vented: Vented | None,
        settings: Settings,
        progress: Progress,
    ) -> Identification:
        asked = settings.held_press and not levels
        held = collect_press(self.source, found, progress) if asked else None
        progress("stretching rubber", 0.0)
        seen = [samples for samples, _, _ in levels]
        return with_rubber(found, seen, vented, held, settings.level_sigma_pa)

    def _vented(self, frames: FrameSource | Path) -> Vented:
        def measure() -> Vented:
            with _opened(frames) as chamber:
                return Vented.measure(chamber)

        return self._once(f"vented {frames}", (), measure)

    def _level(self, frames: FrameSource | Path, nodes: int, progress: Progress) -> Level:
        """The level's own surface, by the same steps; its gauge pressure need not be known."""

        def measure() -> Level:
            with _opened(frames) as level:
                draft = Workbench(level, self.sensor).work(
                    Settings(Step.SURFACE, nodes=nodes), progress
                )
            return _known(draft.samples), _known(draft.surfaces), _known(draft.pixels)

        return self._once(f"level {frames}", nodes, measure)

    def _select(
        self, draft: Draft, samples: Samples, membrane: np.ndarray, residual_m: np.ndarray
    ) -> Draft:
        limits = draft.settings.min_validity, draft.settings.deviations
        pixels = select_pixels(samples.statistics, membrane, residual_m, *limits)
        return replace(draft, pixels=pixels)

    def _once(self, step: str, key: Hashable, make: Callable[[], T]) -> T:
        """Result of a step for what it rests on: remembered, or made now."""
        kept = self._kept.setdefault(step, OrderedDict())
        if key not in kept:
            kept[key] = make()
            while len(kept) > _KEPT:
                kept.popitem(last=False)
        kept.move_to_end(key)
        return kept[key]  # type: ignore[return-value]


def identify(
    source: FrameSource,
    sensor: Sensor,
    contact_free: Sequence[int] | None = None,
    *,
    nodes: int = 1000,
    surface: Name | None = None,
    progress: Progress = quiet,
) -> Identification:
    """Identify a sensor from contact-free frames alone; arguments as of `bubbleviz.identify`."""
    ranges = None if contact_free is None else as_ranges(contact_free)
    settings = Settings(
        Step.TENSION, ranges, surface=surface, nodes=nodes, held_press=False, scored=False
    )
    return _known(Workbench(source, sensor).work(settings, progress).found)


@contextmanager
def _errors_name(source: FrameSource) -> Iterator[None]:
    """Put the name of a source before errors of steps that do not know it."""
    try:
        yield
    except InputError as error:
        if source.name in str(error):
            raise
        raise InputError(f"{source.name}: {error}") from error


@contextmanager
def _opened(frames: FrameSource | Path) -> Iterator[FrameSource]:
    """Frames, or those of a recording while they are looked at."""
    if not isinstance(frames, Path):
        yield frames
        return
    with Recording(frames) as recording:
        yield KeptFrames(recording)


def _known(value: T | None) -> T:
    if value is None:
        raise AssertionError("steps are done in their order")
    return value
