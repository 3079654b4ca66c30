"""Identification in steps, with cached results of each.

When a user of the window removes a frame, changes a threshold or goes back a step, `Workbench.work`
returns a new `Identification` and repeats only the steps that depend on the change. A command runs
all steps at once.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import IntEnum
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from bubbleviz.calibration.identification import Identification, open_chamber, rest_gauge
from bubbleviz.calibration.rectification import rectify
from bubbleviz.calibration.rest_frames import (
    FrameSamples,
    as_ranges,
    collect,
    frame_numbers,
    select_pixels,
)
from bubbleviz.calibration.rubber_problem import collect_press, with_rubber
from bubbleviz.calibration.surface import fit_surfaces, segment_membrane, with_tension
from bubbleviz.errors import InputError
from bubbleviz.progress import Progress, part_of, quiet
from bubbleviz.recordings import CachedFrames, FrameSource, Recording, find_contact_free
from bubbleviz.sensor import Sensor

if TYPE_CHECKING:
    from bubbleviz.calibration.rest_frames import Ranges
    from bubbleviz.calibration.surface import SurfaceName


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
    # known press in the same source, for the validation: mesh file or preset of the object, its
    # pose T_B_O as "x y z qx qy qz qw" (m, unit quaternion), first frame and the one after the last
    obj: str = ""
    pose: str = ""
    pressed: tuple[int, int] | None = None
    held_press: bool = True  # use a press in the source for λ and gauge pressure without levels
    search: bool = True  # search contact-free frames even if `ranges` is given
    force: bool = True  # estimate the force of a simulated press, for the verdict


_CACHED = 2  # results of a step: the present one and the one before an undo
_SHARES = {Step.FRAMES: 0.1, Step.PIXELS: 0.1, Step.SURFACE: 0.2, Step.TENSION: 0.6}
"""Approximate share of each step in the run time."""

T = TypeVar("T")


class Workbench:
    """Identification of one source, from an initial sensor file."""

    def __init__(self, source: FrameSource, sensor: Sensor) -> None:
        self.source, self.sensor = source, sensor
        self._cache: dict[Hashable, OrderedDict[Hashable, object]] = {}

    def work(self, settings: Settings, progress: Progress = quiet) -> Identification:
        """Run the steps up to the last one of the settings.

        Raises InputError: as `bubbleviz.identify`. Raises Cancelled: by `progress`; steps completed
        before stay cached.
        """
        last, found = settings.last_step, Identification(self.sensor)
        progress = part_of(progress, 0.0, 1.0)
        ends = np.cumsum([share for step, share in _SHARES.items() if step <= last])
        parts = [part_of(progress, *pair) for pair in pairwise([0.0, *(ends / ends[-1:])])]
        # measures other levels and the press beside the surface
        executor = ThreadPoolExecutor(max(1, len(settings.levels)))
        beside = part_of(progress, 0.0, 0.0)
        try:
            levels = [
                executor.submit(self._level, each, settings.nodes, beside)
                for each in settings.levels
                if last == Step.TENSION
            ]
            with _errors_name(self.source):
                if last >= Step.FRAMES:
                    found = self._frames(found, settings, parts[0])
                if last >= Step.PIXELS:
                    found = self._pixels(found, settings, parts[1])
                if last == Step.TENSION:
                    press = executor.submit(self._press, found, settings, beside)
                if last >= Step.SURFACE:
                    found = self._surface(found, settings, parts[2])
            if last == Step.TENSION:
                found = self._tension(found, settings, levels, press, parts[3])
        finally:
            executor.shutdown(cancel_futures=True)
        progress("done", 1.0)
        return found

    def _frames(
        self, found: Identification, settings: Settings, progress: Progress
    ) -> Identification:
        ranges, searched = settings.ranges, None
        if ranges is None or settings.search:
            try:
                searched = self._cached(
                    "rest", (), lambda: find_contact_free(self.source, progress)
                )
            except InputError:
                if ranges is None:
                    raise  # else the frames given are used
        if ranges is None and searched is not None:
            ranges = as_ranges(searched.frames)
        return replace(found, ranges=ranges or (), contact_free=searched)

    def _pixels(
        self, found: Identification, settings: Settings, progress: Progress
    ) -> Identification:
        ranges = found.ranges
        samples = self._cached(
            "samples",
            ranges,
            lambda: collect(self.source, self.sensor, frame_numbers(ranges), progress),
        )
        found = replace(found, samples=samples)
        if settings.last_step > Step.PIXELS:
            return found  # the step SURFACE chooses pixels
        membrane, _ = self._cached("membrane", ranges, lambda: segment_membrane(samples))
        return _with_pixels(found, settings, membrane, np.where(membrane, 0.0, np.nan))

    def _surface(
        self, found: Identification, settings: Settings, progress: Progress
    ) -> Identification:
        surfaces = self._cached(
            "surfaces",
            (found.ranges, settings.nodes, settings.surface),
            lambda: fit_surfaces(found.samples, settings.nodes, settings.surface, progress),
        )
        found = replace(found, surfaces=surfaces)
        return _with_pixels(found, settings, surfaces.membrane, surfaces.residual_m)

    def _tension(
        self,
        found: Identification,
        settings: Settings,
        levels: Sequence[Future[Identification]],
        press: Future[FrameSamples | None],
        progress: Progress,
    ) -> Identification:
        vented = None
        if settings.vented is not None:
            vented = self._of_other(settings.vented, "vented", open_chamber)
        with _errors_name(self.source):
            gauge = rest_gauge(found.samples, self.sensor, vented, settings.level_sigma_pa)
            surfaces = self._cached(
                "tension",
                (found.ranges, settings.nodes, settings.surface),
                lambda: with_tension(found.samples, found.surfaces),
            )
        every = [level.result() for level in levels]
        plain = rectify(replace(found, surfaces=surfaces, gauge=gauge, vented=vented), every)
        progress("fitting the rubber", 0.5)
        of_rubber = replace(settings, obj="", pose="", pressed=None)
        fitted = self._cached(
            "rubber",
            of_rubber,
            lambda: with_rubber(
                plain, [each.samples for each in every], press.result(), settings.level_sigma_pa
            ),
        )
        if settings.force:
            fitted = self._cached("force", of_rubber, lambda: with_force(fitted))
        if (pressed := settings.pressed) is None:
            return fitted
        progress("predicting the known press", 0.9)
        # not at the window's start
        from bubbleviz.simulation import validate_press

        known = settings.obj, settings.pose, pressed
        validation = self._cached(
            "validation", settings, lambda: validate_press(fitted.model, self.source, *known)
        )
        return replace(fitted, validation=validation)

    def _press(
        self, found: Identification, settings: Settings, progress: Progress
    ) -> FrameSamples | None:
        """Frames of a held press, where the rubber is fitted to them."""
        if settings.levels or not settings.held_press:
            return None
        return self._cached(
            "press",
            found.ranges,
            lambda: collect_press(self.source, found.samples, self.sensor, progress),
        )

    def _level(self, level: FrameSource | Path, nodes: int, progress: Progress) -> Identification:
        """Another inflation level up to its surface and pixels, by the same steps."""
        settings = Settings(Step.SURFACE, nodes=nodes)
        return self._of_other(
            level, nodes, lambda source: Workbench(source, self.sensor).work(settings, progress)
        )

    def _of_other(
        self, frames: FrameSource | Path, inputs: Hashable, measure: Callable[[FrameSource], T]
    ) -> T:
        """Result of another source, from the cache or measured."""

        def opened() -> T:
            if not isinstance(frames, Path):
                return measure(frames)
            with Recording(frames) as recording:
                return measure(CachedFrames(recording))

        return self._cached(("source", frames), inputs, opened)

    def _cached(self, step: Hashable, inputs: Hashable, compute: Callable[[], T]) -> T:
        """Result of a step for its inputs, from the cache or computed."""
        results = self._cache.setdefault(step, OrderedDict())
        if inputs not in results:
            results[inputs] = compute()
            while len(results) > _CACHED:
                results.popitem(last=False)
        results.move_to_end(inputs)
        return results[inputs]  # type: ignore[return-value]


def with_force(found: Identification) -> Identification:
    """With the force of a simulated press, which the verdict needs."""
    # not at the window's start
    from bubbleviz.calibration.reference_press import reference_force

    return replace(found, reference_force=reference_force(found.model))


def _with_pixels(
    found: Identification, settings: Settings, membrane: np.ndarray, residual_m: np.ndarray
) -> Identification:
    limits = settings.min_validity, settings.deviations
    pixels = select_pixels(found.samples.statistics, membrane, residual_m, *limits)
    return replace(found, pixels=pixels)


@contextmanager
def _errors_name(source: FrameSource) -> Iterator[None]:
    """Prefix error messages that lack it with the name of a source."""
    try:
        yield
    except InputError as error:
        if source.name in str(error):
            raise
        raise InputError(f"{source.name}: {error}") from error
