"""Identification in steps, with cached results of each.

When a user of the window removes a frame, changes a threshold or goes back a step, `Workbench.work`
returns a new `Draft` and repeats only the steps that depend on the change. A command runs all steps
at once.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from bubbleviz.calibration.identification import Identification, Vented, rest_gauge
from bubbleviz.calibration.material import collect_press, with_rubber
from bubbleviz.calibration.rectification import Level, rectify
from bubbleviz.calibration.rest_frames import (
    FrameSamples,
    as_ranges,
    collect,
    frame_numbers,
    select_pixels,
)
from bubbleviz.calibration.surface import fit_surfaces, segment_membrane
from bubbleviz.calibration.tension import estimate_tension
from bubbleviz.camera import PixelModel
from bubbleviz.errors import InputError
from bubbleviz.progress import Progress, part_of, quiet
from bubbleviz.recordings import CachedFrames, FrameSource, Recording, find_contact_free
from bubbleviz.sensor import Sensor

if TYPE_CHECKING:
    from bubbleviz.calibration.rest_frames import Ranges
    from bubbleviz.calibration.surface import SurfaceName, Surfaces
    from bubbleviz.calibration.validation import KnownPress, Validation
    from bubbleviz.recordings import ContactFree


class Step(IntEnum):
    START = 0
    FRAMES = 1
    PIXELS = 2
    SURFACE = 3
    TENSION = 4


@dataclass(frozen=True)
class Settings:
    """Choices of the user."""

    last_step: Step = Step.START
    # contact-free frames, first and one after the last of each range; None: searched
    ranges: Ranges | None = None
    # share of the frames in which a pixel must have a return; None: 0.9 of the typical share
    min_validity: float | None = None
    # robust standard deviations beyond which noise or bias of a pixel is an outlier
    deviations: float = 3.0
    surface: SurfaceName | None = None  # None: by cross-validation
    nodes: int = 1000  # target number of nodes of the mesh
    levels: tuple[FrameSource | Path, ...] = ()  # the untouched sensor at other inflation levels
    vented: FrameSource | Path | None = None  # the open chamber, for the atmospheric pressure
    level_sigma_pa: float | None = None  # of gas pressure differences between recordings, Pa
    press: KnownPress | None = None  # for the validation, in the same source
    held_press: bool = True  # use a press in the source for λ and gauge pressure without levels
    search: bool = True  # search contact-free frames even if `ranges` is given


@dataclass(frozen=True)
class Draft:
    """Results of the steps done so far; None for later steps."""

    settings: Settings
    ranges: Ranges = ()  # contact-free frames in use
    contact_free: ContactFree | None = None  # result of the search, even if it is not used
    samples: FrameSamples | None = None
    # chosen by validity and noise; after the step SURFACE by bias, too
    pixels: PixelModel | None = None
    surfaces: Surfaces | None = None
    found: Identification | None = None  # with the rectification by the other levels

    @property
    def validation(self) -> Validation | None:
        return None if self.found is None else self.found.validation


_CACHED = 3  # results of a step: the present one, the one before an undo, and one more
_SHARES = {Step.FRAMES: 0.1, Step.PIXELS: 0.1, Step.SURFACE: 0.2, Step.TENSION: 0.6}
"""Approximate share of each step in the run time."""

T = TypeVar("T")


class Workbench:
    """Identification of one source, from an initial sensor file."""

    def __init__(self, source: FrameSource, sensor: Sensor) -> None:
        self.source, self.sensor = source, sensor
        self._cache: dict[str, OrderedDict[Hashable, object]] = {}

    def work(self, settings: Settings, progress: Progress = quiet) -> Draft:
        """Run the steps up to the last one of the settings.

        Raises InputError: as `bubbleviz.identify`. Raises Cancelled: by `progress`; steps completed
        before stay cached.
        """
        draft, done, progress = Draft(settings), 0.0, part_of(progress, 0.0, 1.0)
        wanted = [step for step in _SHARES if settings.last_step >= step]
        total = sum(_SHARES[step] for step in wanted)
        executor = ThreadPoolExecutor(1)  # levels are measured while the first steps run
        try:
            measure = partial(self._level, settings.nodes, part_of(progress, 0.0, 0.0))
            levels = [
                executor.submit(self._of_other, each, settings.nodes, measure)
                for each in settings.levels
                if settings.last_step == Step.TENSION
            ]
            steps: tuple[Callable[[Draft, Progress], Draft], ...]
            steps = self._frames, self._pixels, self._surface, partial(self._tension, levels)
            for step, run in zip(wanted, steps, strict=False):
                before, done = done, done + _SHARES[step] / total
                # the last step reads other sources, too
                named = _errors_name(self.source) if step < Step.TENSION else nullcontext()
                with named:
                    draft = run(draft, part_of(progress, before, done))
        finally:
            executor.shutdown(cancel_futures=True)
        progress("done", 1.0)
        return draft

    def _frames(self, draft: Draft, progress: Progress) -> Draft:
        chosen, found = draft.settings.ranges, None
        if chosen is None or draft.settings.search:
            try:
                found = self._cached("rest", (), lambda: find_contact_free(self.source, progress))
            except InputError:
                if chosen is None:
                    raise  # else the frames given are used
        ranges = as_ranges(found.frames) if chosen is None and found else chosen
        return replace(draft, ranges=ranges or (), contact_free=found)

    def _pixels(self, draft: Draft, progress: Progress) -> Draft:
        chosen = frame_numbers(draft.ranges)
        samples = self._cached(
            "samples", draft.ranges, lambda: collect(self.source, self.sensor, chosen, progress)
        )
        draft = replace(draft, samples=samples)
        if draft.settings.last_step > Step.PIXELS:
            return draft  # the step SURFACE chooses pixels
        membrane, _ = self._cached("membrane", draft.ranges, lambda: segment_membrane(samples))
        no_residual = np.where(membrane, 0.0, np.nan)
        return self._select(draft, samples, membrane, no_residual)

    def _surface(self, draft: Draft, progress: Progress) -> Draft:
        settings, samples = draft.settings, _known(draft.samples)
        surfaces = self._cached(
            "surfaces",
            (draft.ranges, settings.nodes, settings.surface),
            lambda: fit_surfaces(samples, settings.nodes, settings.surface, progress),
        )
        draft = replace(draft, surfaces=surfaces)
        return self._select(draft, samples, surfaces.membrane, surfaces.residual_m)

    def _tension(
        self, measured: Sequence[Future[Level]], draft: Draft, progress: Progress
    ) -> Draft:
        settings, samples, surfaces = draft.settings, _known(draft.samples), _known(draft.surfaces)
        vented = None
        if settings.vented is not None:
            vented = self._of_other(settings.vented, "vented", Vented.measure)
        with _errors_name(self.source):
            gauge = rest_gauge(samples, self.sensor, vented)
            tension = self._cached(
                "tension",
                (draft.ranges, settings.nodes, settings.surface, settings.vented),
                lambda: estimate_tension(samples, surfaces, *gauge, part_of(progress, 0.0, 0.5)),
            )
        parts = samples, surfaces, _known(draft.pixels), tension
        found = Identification(self.sensor, *parts, vented)
        levels = [level.result() for level in measured]
        found = rectify(found, levels)

        def fit_rubber() -> Identification:
            own = part_of(progress, 0.6, 0.9)
            use_press = settings.held_press and not levels
            press = collect_press(self.source, found, own) if use_press else None
            own("fitting the rubber", 0.0)
            shapes = [samples for samples, _, _ in levels]
            return with_rubber(found, shapes, press, settings.level_sigma_pa)

        rubber = self._cached("rubber", replace(settings, press=None), fit_rubber)
        draft = replace(draft, pixels=rubber.pixels, found=rubber)
        if (press := settings.press) is None:
            return draft
        progress("predicting the known press", 0.9)
        validation = self._cached(
            "validation", settings, lambda: press.validate(rubber.model, self.source)
        )
        return replace(draft, found=replace(rubber, validation=validation))

    def _level(self, nodes: int, progress: Progress, level: FrameSource) -> Level:
        """Frames, surface and pixels of a level, by the same steps."""
        found = Workbench(level, self.sensor).work(Settings(Step.SURFACE, nodes=nodes), progress)
        return _known(found.samples), _known(found.surfaces), _known(found.pixels)

    def _of_other(
        self, frames: FrameSource | Path, inputs: Hashable, measure: Callable[[FrameSource], T]
    ) -> T:
        """Result of another source, from the cache or measured."""

        def opened() -> T:
            if not isinstance(frames, Path):
                return measure(frames)
            with Recording(frames) as recording:
                return measure(CachedFrames(recording))

        return self._cached(f"source {frames}", inputs, opened)

    def _select(
        self, draft: Draft, samples: FrameSamples, membrane: np.ndarray, residual_m: np.ndarray
    ) -> Draft:
        limits = draft.settings.min_validity, draft.settings.deviations
        pixels = select_pixels(samples.statistics, membrane, residual_m, *limits)
        return replace(draft, pixels=pixels)

    def _cached(self, step: str, inputs: Hashable, compute: Callable[[], T]) -> T:
        """Result of a step for its inputs, from the cache or computed."""
        results = self._cache.setdefault(step, OrderedDict())
        if inputs not in results:
            results[inputs] = compute()
            while len(results) > _CACHED:
                results.popitem(last=False)
        results.move_to_end(inputs)
        return results[inputs]  # type: ignore[return-value]


@contextmanager
def _errors_name(source: FrameSource) -> Iterator[None]:
    """Prefix error messages that lack it with the name of a source."""
    try:
        yield
    except InputError as error:
        if source.name in str(error):
            raise
        raise InputError(f"{source.name}: {error}") from error


def _known(value: T | None) -> T:
    assert value is not None  # the steps run in order
    return value
