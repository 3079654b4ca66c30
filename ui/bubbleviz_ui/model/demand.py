"""What each visible thing asks of the pipeline: hidden means not asked for, not computed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

from bubbleviz.diagnostics.inspector import NEEDS
from bubbleviz.pipeline import FrameOptions

if TYPE_CHECKING:
    from bubbleviz.diagnostics.inspector import Look
    from bubbleviz.pipeline import Product
    from bubbleviz_ui.model.choices import Choices, Rule

CONSUMERS: Mapping[str, frozenset[Product]] = MappingProxyType(
    {
        "membrane": frozenset({"estimate"}),
        "wireframe": frozenset({"estimate"}),
        "contour": frozenset({"estimate", "patch"}),
        "cloud": frozenset({"cloud"}),
        "force": frozenset({"estimate", "patch"}),
        "readout": frozenset({"estimate", "patch"}),
        "frustum": frozenset(),
        "rim": frozenset(),
        "object": frozenset(),
        "fit": frozenset(),
        "pose": frozenset(),
        "vectors": frozenset({"estimate"}),
        "kappa_panel": frozenset({"estimate", "patch"}),
        "status": frozenset({"estimate", "patch"}),
        "plots": frozenset(),
        "images": frozenset(),
        "threshold": frozenset({"estimate", "patch"}),
        "compare": frozenset(),
    }
)
"""Products by the name of a layer, panel or bar."""

POSE_CONSUMERS = frozenset({"object", "fit", "pose"})
"""Who wants the pose of the object while it is tracked."""

PLOTS: Mapping[str, frozenset[Product]] = MappingProxyType(
    {
        "force": frozenset({"estimate", "patch"}),
        "gas": frozenset({"estimate"}),
        "area": frozenset({"estimate", "patch"}),
        "center": frozenset({"estimate", "patch"}),
        "residual": frozenset({"estimate"}),
        "solve": frozenset({"estimate", "patch"}),
        "latency": frozenset(),
        "kappa": frozenset({"estimate"}),
    }
)
"""Products by the name of a plot."""

CLOUD_COLOURS: Mapping[str, frozenset[Product]] = MappingProxyType(
    {
        "residual": frozenset({"estimate", "residual"}),
        "patch": frozenset({"estimate", "patch", "pixel_mask"}),
        "plain": frozenset(),
    }
)
"""Products a colouring of the cloud needs on top of the cloud itself."""


@dataclass(frozen=True)
class Demand:
    """What is asked of a frame; part of every request.

    Attributes
    ----------
    products : frozenset of Product
    looks : frozenset of Look
        Closer looks at the frame.
    options : FrameOptions
        What makes its patch and its cloud.
    """

    products: frozenset[Product]
    looks: frozenset[Look] = frozenset()
    options: FrameOptions = FrameOptions()

    @classmethod
    def of(cls, choices: Choices) -> Demand:
        """What the visible things need."""
        options = FrameOptions(*choices.rule, choices.cloud_points)
        return cls(products(choices), looks(choices), options)

    @property
    def rule(self) -> Rule:
        """What makes a patch of a contact pressure: κ and the least area."""
        return self.options.kappa, self.options.least_area_m2

    def covers(self, other: Demand) -> bool:
        """Whether all that another asks for is asked for here."""
        return other.products <= self.products and other.looks <= self.looks


def products(choices: Choices) -> frozenset[Product]:
    """Everything the visible layers and panels need of a frame."""
    visible = choices.layers | choices.panels
    needed: frozenset[Product] = frozenset()
    needed = needed.union(*(CONSUMERS[name] for name in visible))
    if "cloud" in choices.layers:
        needed |= CLOUD_COLOURS[choices.cloud_colour]
    if "plots" in choices.panels:
        needed |= plotted(choices)
    if "images" in choices.panels and "patch" in choices.images:
        needed |= {"estimate", "patch", "pixel_mask"}
    if choices.pose_track and visible & POSE_CONSUMERS:
        needed |= {"estimate", "patch", "pose"}
    for look in looks(choices):
        needed |= NEEDS[look]
    return needed


def plotted(choices: Choices) -> frozenset[Product]:
    """What the chosen plots need of every frame."""
    needed: frozenset[Product] = frozenset()
    return needed.union(*(PLOTS[name] for name in choices.plots))


def looks(choices: Choices) -> frozenset[Look]:
    """Closer looks at the frame that is shown."""
    wanted: set[Look] = set()
    if "plots" in choices.panels and "kappa" in choices.plots:
        wanted.add("kappa_curve")
    if "threshold" in choices.panels:
        wanted |= {"kappa_curve", "components"}
    if "images" in choices.panels:
        wanted |= {look for look in NEEDS if look in choices.images}
    return frozenset(wanted)
