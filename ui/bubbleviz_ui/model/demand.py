"""What each visible thing asks of the pipeline: hidden means not asked for, not computed."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from statistics import median
from types import MappingProxyType
from typing import TYPE_CHECKING

from bubbleviz.pipeline import (
    COLOUR_PRODUCTS,
    DIAGNOSTICS,
    OBJECT_PRODUCTS,
    FrameOptions,
    Product,
    stages,
)
from bubbleviz.result import Result
from bubbleviz_ui.model.choices import Choices
from bubbleviz_ui.model.registry import ASKING, ESTIMATE, LAYERS, NOTHING, PATCH, PLOTS, Products

if TYPE_CHECKING:
    from bubbleviz.shear import FlowPreset
    from bubbleviz_ui.model.choices import Rule


POSE_CONSUMERS = frozenset({"object", "fit", "pose", "object_patch"})
"""Who wants the pose of the object while it is tracked."""

CLOUD_COLOURS: Mapping[str, Products] = MappingProxyType(
    {"residual": ESTIMATE | {"residual"}, "patch": PATCH | {"pixel_mask"}, "plain": NOTHING}
)
"""Products a colouring of the cloud needs on top of the cloud itself."""


@dataclass(frozen=True)
class ShearOptions:
    """How traction with friction is made: preset of the optical flow, and the bound μ or none."""

    flow: FlowPreset = "fast"
    friction: float | None = None


@dataclass(frozen=True)
class Demand:
    """What is asked of a frame; part of every request."""

    products: Products
    # What makes its patch and its cloud
    options: FrameOptions = field(default_factory=FrameOptions)
    shear: ShearOptions = field(default_factory=ShearOptions)  # What makes its traction

    @classmethod
    def of(cls, choices: Choices) -> Demand:
        """What the visible things need."""
        options = FrameOptions(*choices.rule, choices.cloud_points)
        shear = ShearOptions(choices.flow_preset, choices.friction)
        return cls(products(choices), options, shear)

    @property
    def rule(self) -> Rule:
        """What makes a patch of a contact pressure: κ and the least area."""
        return self.options.kappa, self.options.least_area_m2

    @property
    def looks(self) -> Products:
        """Closer looks at the frame that is shown."""
        return self.products & DIAGNOSTICS.keys()

    def looking(self, looks: Products = NOTHING) -> Demand:
        """The same with other closer looks, or none."""
        return replace(self, products=self.products - DIAGNOSTICS.keys() | looks)

    @property
    def of_colour(self) -> bool:
        """Whether colour images are needed for it."""
        return bool(self.products & COLOUR_PRODUCTS)

    def thinned(self, times: int) -> Demand:
        """The same with fewer points of the cloud, unless all of them are asked for."""
        most = self.options.cloud_points
        if most is None or times == 1:
            return self
        return replace(self, options=replace(self.options, cloud_points=most // times))

    def covers(self, other: Demand) -> bool:
        """Whether all that another asks for is asked for here."""
        same = other.shear == self.shear or not other.products & {"flow", "traction", "slip"}
        return same and other.products <= self.products


def products(choices: Choices) -> Products:
    """Everything the visible layers and panels need of a frame."""
    needed = NOTHING.union(
        *(LAYERS[name].needs for name in choices.layers),
        *(ASKING[name].needs for name in choices.panels),
    )
    if "cloud" in choices.layers:
        needed |= CLOUD_COLOURS[choices.cloud_colour]
    if "plots" in choices.panels:
        needed |= plotted(choices)
    if "images" in choices.panels and "patch" in choices.images:
        needed |= PATCH | {"pixel_mask"}
    if choices.pose_track and (choices.layers | choices.panels) & POSE_CONSUMERS:
        needed |= PATCH | of_object(choices)
    looks = _looks(choices)
    return needed.union(looks, *(DIAGNOSTICS[look] for look in looks))


def of_object(choices: Choices) -> Products:
    """What is asked of a frame in which an object is looked for."""
    return OBJECT_PRODUCTS if "object_patch" in choices.layers else frozenset({"pose"})


def plotted(choices: Choices) -> Products:
    """What the chosen plots need of every frame."""
    return NOTHING.union(*(PLOTS[name].needs for name in choices.plots))


def _looks(choices: Choices) -> Products:
    wanted = NOTHING
    if "plots" in choices.panels and "kappa" in choices.plots:
        wanted |= {"kappa_curve"}
    if "threshold" in choices.panels:
        wanted |= {"kappa_curve", "components"}
    if "images" in choices.panels:
        wanted |= {look for look in DIAGNOSTICS if look.removesuffix("_image") in choices.images}
    return wanted


# Performance: each stage's time and count, and who asked for it. No Qt in here.


STAGES = {
    "estimate": "Contact pressure (Eq. 23)",
    "fine_contact": "Contact on a finer mesh, if the camera resolves more than the sensor's mesh",
    "patch": "Contact patch (section V-C of the paper)",
    "pixel_mask": "Pixels of the patch",
    "pose": "Pose of the object (section VI of the paper)",
    "cloud": "Measured points",
    "residual": "Residual of the range",
    "flow": "Optical flow of the colour image",
    "traction": "Traction with friction",
    "slip": "Slip",
    "texture": "Colour image on the membrane",
    "total": "Whole frame: depth image in, results out",
}
"""What each stage of the pipeline computes."""
KEPT = 100
"""Frames that a median is of."""
ANALYSIS = "analysis of all frames"


@dataclass(frozen=True)
class Cost:
    """One line of the table."""

    stage: str
    title: str  # What it computes
    # last_ms, median_ms: Time of the last frame it ran for, and median of the last hundred; None:
    # never ran
    last_ms: float | None
    median_ms: float | None
    runs: int  # How often it has run for the open source
    why: tuple[str, ...]  # Layers and panels that ask for it now; empty: it does not run


class Costs:
    """Times of the frames that were computed last."""

    def __init__(self) -> None:
        self._times: dict[str, deque[float]] = {name: deque(maxlen=KEPT) for name in STAGES}
        self._seen: object = None

    def clear(self) -> None:
        """Begin anew for another source."""
        for times in self._times.values():
            times.clear()

    def take(self, result: Result) -> None:
        """Note the times of a frame, once."""
        if result.times_ms is self._seen:
            return  # the same frame with another patch
        self._seen = result.times_ms
        for stage, time_ms in result.times_ms.items():
            if stage in self._times:
                self._times[stage].append(time_ms)

    def table(
        self, choices: Choices, counts: Mapping[str, int], *, analysing: bool = False
    ) -> list[Cost]:
        """Every stage, whether it runs or not."""
        asked = who_asks(choices, analysing=analysing)
        lines = []
        for stage, title in STAGES.items():
            times = self._times[stage]
            lines.append(
                Cost(
                    stage,
                    title,
                    times[-1] if times else None,
                    median(times) if times else None,
                    counts.get(stage, 0),
                    () if stage == "total" else tuple(asked.get(stage, ())),
                )
            )
        return lines


def who_asks(choices: Choices, *, analysing: bool = False) -> dict[str, list[str]]:
    """Layers and panels by the stages that run because of them."""
    nothing = replace(choices, layers=frozenset(), panels=frozenset())
    asked: dict[str, list[str]] = {}

    def note(name: str, needed: Iterable[Product]) -> None:
        for stage in stages(frozenset(needed)) - DIAGNOSTICS.keys():
            asked.setdefault(stage, []).append(name)

    for name in sorted(choices.layers):
        note(name, products(replace(nothing, layers=frozenset({name}))))
    for name in sorted(choices.panels):
        note(name, products(replace(nothing, panels=frozenset({name}))))
    if analysing:
        note(ANALYSIS, plotted(choices))
    return asked
