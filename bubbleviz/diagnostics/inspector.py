"""Images, curves and parts of one frame for the panels, each computed only when requested."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from bubbleviz.colour.seen_colour import SeenColour
from bubbleviz.diagnostics.frame_images import FrameImages
from bubbleviz.diagnostics.kappa_curve import KappaCurve, kappa_curve
from bubbleviz.patch.components import Component, components
from bubbleviz.pipeline import Pipeline, Product
from bubbleviz.result import Result

Look = Literal[
    "depth", "change", "residual", "noise", "used", "colour", "flow", "kappa_curve", "components"
]
"""An image (H, W) or (H, W, 3) by its name, or the curve of areas over κ."""

OUTERMOST = 0.5
"""Per cent of the pixels at either end that colours need not tell apart."""

NEEDS: dict[Look, frozenset[Product]] = {
    "depth": frozenset(),
    "change": frozenset(),
    "residual": frozenset({"estimate"}),
    "noise": frozenset(),
    "used": frozenset(),
    "colour": frozenset(),
    "flow": frozenset({"estimate", "flow"}),  # an estimate tells frames without contact
    "kappa_curve": frozenset({"estimate"}),
    "components": frozenset({"estimate", "patch"}),
}
"""Products of the pipeline that a look is made of."""


@dataclass(frozen=True)
class Inspection:
    """The requested diagnostics of a frame.

    Attributes
    ----------
    images : dict
        (H, W) image by name: z-depth, change and residual of the range and its σ in m; `used`
        bool; `flow`, length of the motion in the colour image in pixels, by blocks.
    ends : dict
        Between them lie all but the outermost values of each image.
    colour : SeenColour or None
    no_flow : str
        Why there is no image of the flow, in a few words; empty where the reference says it.
    reference : str
        What shear is measured against, in words; empty where nobody asked for it.
    kappa_curve : KappaCurve or None
    components : tuple of Component
        Parts of the patch, those too, that are left out for their size.
    """

    images: dict[str, np.ndarray] = field(default_factory=dict)
    ends: dict[str, tuple[float, float]] = field(default_factory=dict)
    colour: SeenColour | None = None
    no_flow: str = ""
    reference: str = ""
    kappa_curve: KappaCurve | None = None
    components: tuple[Component, ...] = ()


class Inspector:
    """Looks closer at the results of a pipeline; counts its stages as `look <name>`.

    Parameters
    ----------
    pipeline : Pipeline
    """

    def __init__(self, pipeline: Pipeline) -> None:
        self._pipeline = pipeline

    def look(
        self,
        result: Result,
        looks: frozenset[Look],
        kappa: float | None = None,
        truth: np.ndarray | None = None,
    ) -> Inspection:
        """Compute the requested diagnostics of a result; those that lack a product are left out.

        Parameters
        ----------
        result : Result
        looks : frozenset of Look
        kappa : float, optional
            Of the result's patch.
        truth : (H, W) bool array, optional
            True pixels of the patch, in a simulation.
        """
        images: dict[str, np.ndarray] = {}
        curve, parts, colour = None, tuple[Component, ...](), None
        for name in sorted(looks):
            self._pipeline.counts[f"look {name}"] += 1
            if name == "kappa_curve":
                if result.estimate is not None:
                    view = self._pipeline.model.view if truth is not None else None
                    curve = kappa_curve(self._pipeline.mesh, result.estimate, truth, view)
                continue
            if name == "components":
                parts = self._components(result, kappa)
                continue
            if name == "colour":
                texture = result.texture  # has it decoded
                colour = SeenColour.of(result.frame) if texture is None else texture.colour
                continue
            image = self._image(name, result)
            if image is not None:
                images[name] = image
        ends = {name: _ends(image) for name, image in images.items()}
        why = self._no_flow(result) if "flow" in looks - images.keys() else ""
        return Inspection(images, ends, colour, why, kappa_curve=curve, components=parts)

    def _no_flow(self, result: Result) -> str:
        if result.flow is not None:
            return result.flow.problem or "nothing of the texture is found again"
        if result.frame.find_colour is None:
            return result.frame.no_colour
        return "" if self._pipeline.flow_of is None else "no colour image at this time"

    def _components(self, result: Result, kappa: float | None) -> tuple[Component, ...]:
        if result.estimate is None:
            return ()
        whole = self._pipeline.whole_patch(result.estimate, kappa)
        return components(self._pipeline.mesh, result.estimate, whole)

    def _image(self, name: Look, result: Result) -> np.ndarray | None:
        depth, estimate = result.frame.depth_m, result.estimate
        if name == "depth":
            return depth
        if name == "change":
            return self._images.change(depth)
        if name == "used":
            return self._images.used(depth)
        if name == "noise":
            return self._images.noise
        if name == "flow":
            flow = result.flow
            return None if flow is None or not len(flow.pixel) else flow.lengths_px()
        if estimate is None or not estimate.trusted:
            return None
        return self._images.residual(depth, estimate.motion_m)

    @cached_property
    def _images(self) -> FrameImages:
        return FrameImages(self._pipeline.model)


def _ends(image: np.ndarray) -> tuple[float, float]:
    """Range of almost all values of an image, by some ten thousand of them."""
    values = image.ravel()[:: max(1, image.size // 10_000)].astype(float)
    values = values[np.isfinite(values)]
    if not len(values):
        return 0.0, 1.0
    low, high = np.percentile(values, [OUTERMOST, 100.0 - OUTERMOST])
    return float(low), float(high)
