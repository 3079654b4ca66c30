"""An identification that goes step by step, and does again only what a change asks for.

`identify` runs everything once. A person at a window takes a sample out, moves a threshold, goes
a step back: `Workbench.work` answers each such choice with a `Draft`, and remembers the last few
results of every step by what they rest on.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from bubbleviz.calibration.contact_free import check_still, find_contact_free
from bubbleviz.calibration.identification import (
    Identification,
    assemble,
    check_dome,
    collect_press,
    errors_name,
    rest_gauge_pressure,
    with_rubber,
)
from bubbleviz.calibration.material import Vented
from bubbleviz.calibration.rectification import Level, rectify
from bubbleviz.calibration.rest_frames import (
    PixelStatistics,
    Samples,
    as_ranges,
    collect,
    numbers,
    select_pixels,
    tidy,
)
from bubbleviz.calibration.surface import fit_surfaces, segment_membrane
from bubbleviz.calibration.tension import estimate_tension
from bubbleviz.calibration.validation import Validation
from bubbleviz.errors import InputError
from bubbleviz.progress import Progress, part_of, quiet
from bubbleviz.recordings import FrameSource, Recording
from bubbleviz.sensor import Sensor

if TYPE_CHECKING:
    from bubbleviz.calibration.contact_free import ContactFree
    from bubbleviz.calibration.rest_frames import Ranges
    from bubbleviz.calibration.surface import Name, Surfaces
    from bubbleviz.calibration.tension import TensionEstimate
    from bubbleviz.calibration.validation import KnownPress


# What a person decides of an identification, and what is known after each of its steps.


class Step(IntEnum):
    """The steps in their order."""

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
    levels: tuple[Path, ...] = ()  # recordings of the untouched sensor at other inflation levels
    vented: Path | None = None  # recording of the open chamber, for the atmospheric pressure
    press: KnownPress | None = None  # what to validate by, in the same source


@dataclass(frozen=True)
class Draft:
    """What is known after the steps so far; None where a step was not reached."""

    settings: Settings
    ranges: Ranges = ()  # contact-free frames in use
    contact_free: ContactFree | None = None  # what was found, whether or not it is used
    samples: Samples | None = None
    # of the step SURFACE on less its bias; before, by validity and noise alone
    pixels: PixelStatistics | None = None
    surfaces: Surfaces | None = None
    tension: TensionEstimate | None = None
    found: Identification | None = None  # rectified by the other levels, where there are
    validation: Validation | None = None


_KEPT = 3  # results of a step: the present one, the one undone, and one more

T = TypeVar("T")


_SHARES = {Step.FRAMES: 0.1, Step.PIXELS: 0.1, Step.SURFACE: 0.2, Step.TENSION: 0.6}
"""Of the time that the steps take, about."""


class Workbench:
    """One source and the sensor file to start from."""

    def __init__(self, source: FrameSource, sensor: Sensor) -> None:
        self.source, self.sensor = source, sensor
        self._kept: dict[str, OrderedDict[Hashable, object]] = {}

    def work(self, settings: Settings, progress: Progress = quiet) -> Draft:
        """Do the steps up to the one reached.

        Raises InputError: whatever makes the answer worthless, as in `identify`. Raises Cancelled:
        by `progress`; what was finished before is remembered, nothing else has changed.
        """
        with errors_name(self.source):
            return self._work(settings, progress)

    def _work(self, settings: Settings, progress: Progress) -> Draft:
        draft, done = Draft(settings), 0.0
        steps = {
            Step.FRAMES: self._frames,
            Step.PIXELS: self._pixels,
            Step.SURFACE: self._surface,
            Step.TENSION: self._tension,
        }
        wanted = [step for step in steps if settings.reached >= step]
        total = sum(_SHARES[step] for step in wanted)
        for step in wanted:
            before, done = done, done + _SHARES[step] / total
            draft = steps[step](draft, part_of(progress, before, done))
        progress("done", 1.0)
        return draft

    def _frames(self, draft: Draft, progress: Progress) -> Draft:
        try:
            found = self._once("contact free", (), lambda: find_contact_free(self.source, progress))
        except InputError:
            if draft.settings.ranges is None:
                raise
            found = None  # the operator knows better, and has said so
        if draft.settings.ranges is None and found is not None:
            return replace(draft, ranges=as_ranges(found.frames), contact_free=found)
        ranges = tidy(draft.settings.ranges or (), len(self.source))
        return replace(draft, ranges=ranges, contact_free=found)

    def _pixels(self, draft: Draft, progress: Progress) -> Draft:
        chosen = draft.ranges
        samples = self._once(
            "samples",
            chosen,
            lambda: collect(self.source, self.sensor, numbers(chosen), progress),
        )
        membrane, _ = self._once("membrane", chosen, lambda: segment_membrane(samples))
        nothing = np.where(membrane, 0.0, np.nan)  # no surface yet to be off from
        return replace(
            draft, samples=samples, pixels=self._select(draft, samples, membrane, nothing)
        )

    def _surface(self, draft: Draft, progress: Progress) -> Draft:
        settings, samples = draft.settings, _known(draft.samples)
        key = (draft.ranges, settings.nodes, settings.surface)
        self._once("still", draft.ranges, lambda: check_still(samples))
        surfaces = self._once(
            "surfaces",
            key,
            lambda: fit_surfaces(samples, settings.nodes, settings.surface, progress),
        )
        pixels = self._select(draft, samples, surfaces.membrane, surfaces.residual_m)
        return replace(draft, surfaces=surfaces, pixels=pixels)

    def _tension(self, draft: Draft, progress: Progress) -> Draft:
        settings, samples = draft.settings, _known(draft.samples)
        surfaces, pixels = _known(draft.surfaces), _known(draft.pixels)
        key = (draft.ranges, settings.nodes, settings.surface)
        seen = self._once("seen", key, lambda: check_dome(samples, surfaces))
        wander = self._once("still", draft.ranges, lambda: check_still(samples))
        vented = self._vented(settings.vented)
        sensor = self.sensor if vented is None else vented.set_in(self.sensor)
        gauge = rest_gauge_pressure(samples, sensor)
        rests_on = (*key, settings.vented)
        tension = self._once(
            "tension",
            rests_on,
            lambda: estimate_tension(samples, surfaces, gauge, part_of(progress, 0.0, 0.5)),
        )
        found = assemble(sensor, samples, surfaces, pixels, tension, seen, wander)
        onwards = part_of(progress, 0.5, 0.6)
        levels = [self._level(path, onwards) for path in settings.levels]
        found = rectify(found, levels)
        found = self._once(
            "rubber",
            (*rests_on, settings.min_validity, settings.deviations, settings.levels),
            lambda: self._with_rubber(found, levels, vented, part_of(progress, 0.6, 0.9)),
        )
        draft = replace(draft, tension=found.tension, pixels=found.pixels, found=found)
        last = part_of(progress, 0.9, 1.0)
        return replace(draft, validation=self._validation(found, settings, last))

    def _with_rubber(
        self,
        found: Identification,
        levels: list[Level],
        vented: Vented | None,
        progress: Progress,
    ) -> Identification:
        held = collect_press(self.source, found, progress)
        progress("stretching rubber", 0.0)
        return with_rubber(found, [each.samples for each in levels if each.samples], vented, held)

    def _vented(self, path: Path | None) -> Vented | None:
        if path is None:
            return None

        def measure() -> Vented:
            with Recording(path) as chamber:
                return Vented.measure(chamber)

        return self._once("vented", path, measure)

    def _level(self, path: Path, progress: Progress) -> Level:
        def measure() -> Level:
            with Recording(path) as level:
                return Level.measure(level, self.sensor, progress=progress)

        return self._once(f"level {path}", (), measure)

    def _validation(
        self, found: Identification, settings: Settings, progress: Progress
    ) -> Validation | None:
        press = settings.press
        if press is None:
            return None

        def validate() -> Validation:
            progress("predicting the known press", 0.0)
            return press.validate(found.model, self.source)

        return self._once("validation", settings, validate)

    def _select(
        self, draft: Draft, samples: Samples, membrane: np.ndarray, residual_m: np.ndarray
    ) -> PixelStatistics:
        settings = draft.settings
        return select_pixels(
            samples.statistics, membrane, residual_m, settings.min_validity, settings.deviations
        )

    def _once(self, step: str, key: Hashable, make: Callable[[], T]) -> T:
        """Result of a step for what it rests on: remembered, or made now."""
        kept = self._kept.setdefault(step, OrderedDict())
        if key not in kept:
            kept[key] = make()
            while len(kept) > _KEPT:
                kept.popitem(last=False)
        kept.move_to_end(key)
        return kept[key]  # type: ignore[return-value]


def _known(value: T | None) -> T:
    if value is None:
        raise AssertionError("steps are done in their order")
    return value
