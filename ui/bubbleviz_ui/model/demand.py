"""Pipeline products required by the visible layers and panels; hidden ones require none."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING

from bubbleviz.pipeline import (
    COLOUR_PRODUCTS,
    DIAGNOSTICS,
    FLOW_PRODUCTS,
    OBJECT_PRODUCTS,
    FrameOptions,
    Product,
    stages,
)
from bubbleviz.result import Result
from bubbleviz_ui.model.registry import (
    ESTIMATE,
    LAYERS,
    NO_PRODUCTS,
    PANELS,
    PATCH,
    PLOTS,
    Products,
)
from bubbleviz_ui.model.settings import Settings

if TYPE_CHECKING:
    from bubbleviz_ui.model.settings import PatchRule


POSE_CONSUMERS = frozenset({"object", "fit", "pose", "object_patch"})
"""Layers and panels that need the pose of a tracked object."""

CLOUD_COLOURS: Mapping[str, Products] = MappingProxyType(
    {"residual": ESTIMATE | {"residual"}, "patch": PATCH | {"pixel_mask"}, "plain": NO_PRODUCTS}
)
"""Products each colouring of the cloud needs in addition to the cloud."""


@dataclass(frozen=True)
class Demand:
    """Products to compute of a frame, with their options; part of every request."""

    products: Products
    options: FrameOptions = field(default_factory=FrameOptions)  # Of patch and cloud

    @classmethod
    def of(cls, settings: Settings) -> Demand:
        """Demand of the visible layers and panels."""
        options = FrameOptions(*settings.patch_rule, settings.cloud_points)
        return cls(needed_products(settings), options)

    @property
    def patch_rule(self) -> PatchRule:
        """Parameters of the patch threshold: κ and the smallest area."""
        return self.options.kappa, self.options.least_area_m2

    @property
    def images(self) -> Products:
        """Requested images of the frame shown, which take longest of all diagnostics."""
        return frozenset(name for name in self.products if name.endswith("_image"))

    def without_images(self) -> Demand:
        return replace(self, products=self.products - self.images)

    @property
    def flow(self) -> bool:
        """Whether forces use colour images, not depth alone."""
        return bool(self.products & FLOW_PRODUCTS)

    @property
    def needs_colour(self) -> bool:
        """Whether any product needs colour images."""
        return bool(self.products & COLOUR_PRODUCTS)

    def thinned(self, times: int) -> Demand:
        """The same demand with fewer points of the cloud, unless all are requested."""
        most = self.options.cloud_points
        if most is None or times == 1:
            return self
        return replace(self, options=replace(self.options, cloud_points=most // times))

    def covers(self, other: Demand) -> bool:
        """Whether this demand includes everything in another one, with the same forces."""
        return other.flow == self.flow and other.products <= self.products


def needed_products(settings: Settings) -> Products:
    """All products needed by the visible layers and panels."""
    needed = NO_PRODUCTS.union(
        *(LAYERS[name].needs for name in settings.layers),
        *(PANELS[name].needs for name in settings.panels),
    )
    if "cloud" in settings.layers:
        needed |= CLOUD_COLOURS[settings.cloud_colour]
    if "plots" in settings.panels:
        needed |= plot_products(settings)
    if "images" in settings.panels and "patch" in settings.images:
        needed |= PATCH | {"pixel_mask"}
    if settings.pose_track and (settings.layers | settings.panels) & POSE_CONSUMERS:
        needed |= PATCH | pose_products(settings)
    diagnostics = NO_PRODUCTS
    if "plots" in settings.panels and "kappa" in settings.plots:
        diagnostics |= {"kappa_curve"}
    if "threshold" in settings.panels:
        diagnostics |= {"kappa_curve", "components"}
    if "images" in settings.panels:
        shown = settings.images
        diagnostics |= {name for name in DIAGNOSTICS if name.removesuffix("_image") in shown}
    return needed.union(diagnostics, *(DIAGNOSTICS[name] for name in diagnostics))


def pose_products(settings: Settings) -> Products:
    """Products of a frame in which an object is registered."""
    return OBJECT_PRODUCTS if "object_patch" in settings.layers else frozenset({"pose"})


def plot_products(settings: Settings) -> Products:
    """Products that the chosen plots need for every frame."""
    return NO_PRODUCTS.union(*(PLOTS[name].needs for name in settings.plots))


# Performance: run time of each stage, and which layers and panels request it.

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
"""Titles of the pipeline stages."""
MEDIAN_FRAMES = 100
"""Frames over which a median is taken."""
ANALYSIS = "analysis of all frames"


class StageTimes:
    """Stage times of the last frames."""

    def __init__(self) -> None:
        # The last ones of each stage, ms
        self.of = {name: deque[float](maxlen=MEDIAN_FRAMES) for name in STAGES}
        self._last_times: object = None

    def clear(self) -> None:
        """Forget all times, for another source."""
        for times in self.of.values():
            times.clear()

    def take(self, result: Result) -> None:
        """Record the times of a frame, once."""
        if result.times_ms is self._last_times:
            return  # the same solve with another patch
        self._last_times = result.times_ms
        for stage in self.of.keys() & result.times_ms.keys():
            self.of[stage].append(result.times_ms[stage])


def names_by_stage(settings: Settings, *, analysing: bool = False) -> dict[str, list[str]]:
    """Names of the layers and panels that request each stage."""
    nothing = replace(settings, layers=frozenset(), panels=frozenset())
    requested: dict[str, list[str]] = {}

    def note(name: str, needed: Iterable[Product]) -> None:
        for stage in stages(frozenset(needed)) - DIAGNOSTICS.keys():
            requested.setdefault(stage, []).append(name)

    for name in sorted(settings.layers):
        note(name, needed_products(replace(nothing, layers=frozenset({name}))))
    for name in sorted(settings.panels):
        note(name, needed_products(replace(nothing, panels=frozenset({name}))))
    if analysing:
        note(ANALYSIS, plot_products(settings))
    return requested
