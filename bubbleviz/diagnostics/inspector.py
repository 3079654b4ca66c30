"""Images, curves and parts of one frame for the panels."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from bubbleviz.colour.seen_colour import SeenColour
from bubbleviz.diagnostics.kappa_curve import KappaCurve, kappa_curve
from bubbleviz.patch.components import Component, components

if TYPE_CHECKING:
    from bubbleviz.pipeline import Pipeline, Product
    from bubbleviz.result import Result
    from bubbleviz.sensor_model import SensorModel

OUTERMOST = 0.5  # per cent of the pixels at either end that colours need not tell apart


@dataclass(frozen=True)
class Inspection:
    """The requested diagnostics of a frame."""

    # (H, W) image by name: z-depth, change and residual of the range and its σ in m; `used` bool;
    # `flow`, length of the motion in the colour image in pixels, by blocks
    images: dict[str, np.ndarray] = field(default_factory=dict)
    # between them lie all but the outermost values of each image
    ends: dict[str, tuple[float, float]] = field(default_factory=dict)
    colour: SeenColour | None = None
    # why there is no image of the flow, in a few words; empty where the reference says it
    no_flow: str = ""
    reference: str = ""  # what shear is measured against, in words; empty where nobody asked for it
    kappa_curve: KappaCurve | None = None
    # parts of the patch, those too, that are left out for their size
    components: tuple[Component, ...] = ()


def inspection(
    pipeline: Pipeline,
    result: Result,
    looks: frozenset[Product],
    kappa: float | None = None,
    truth: np.ndarray | None = None,
) -> Inspection:
    """Some of `pipeline.LOOKS` at a result; those that lack a product are left out.

    Parameters are those of `Pipeline.look`, and the κ of the result's patch.
    """
    images: dict[str, np.ndarray] = {}
    curve, parts, colour, why = None, tuple[Component, ...](), None, ""
    estimate = result.estimate
    for look in sorted(looks):
        if look == "kappa_curve":
            if estimate is not None:
                view = pipeline.model.view if truth is not None else None
                curve = kappa_curve(pipeline.mesh, estimate, truth, view)
        elif look == "components":
            if estimate is not None:
                whole = pipeline.whole_patch(estimate, kappa)
                parts = components(pipeline.mesh, estimate, whole)
        elif look == "colour_image":
            texture = result.texture  # has it decoded
            colour = SeenColour.of(result.frame) if texture is None else texture.colour
        else:
            name = look.removesuffix("_image")
            image = _image(name, result, pipeline.model)
            if image is not None:
                images[name] = image
            elif name == "flow":
                why = _no_flow(pipeline, result)
    ends = {name: _ends(image) for name, image in images.items()}
    return Inspection(images, ends, colour, why, kappa_curve=curve, components=parts)


def _image(name: str, result: Result, model: SensorModel) -> np.ndarray | None:
    """Image (H, W) of a name of `Inspection.images`, at full resolution."""
    depth, estimate, flow = result.frame.depth_m, result.trusted_estimate, result.flow
    if name == "depth":
        return depth
    if name == "flow":
        return None if flow is None or not len(flow.pixel) else flow.lengths_px()
    if name == "noise":
        if model.pixels is None:
            return model.sensor.camera.noise_relative * model.view.rest_range
        return np.where(model.pixels.mask, model.pixels.noise_m, np.nan)
    measured = model.range_image(depth)
    if name == "change":
        return measured - model.view.rest_range
    if name == "used":
        return np.isfinite(measured) & np.isfinite(model.view.rest_range)
    return None if estimate is None else measured - model.view.range_image(estimate.motion_m)


def _no_flow(pipeline: Pipeline, result: Result) -> str:
    if result.flow is not None:
        return result.flow.problem or "nothing of the texture is found again"
    if result.frame.find_colour is None:
        return result.frame.no_colour
    return "" if pipeline.flow_of is None else "no colour image at this time"


def _ends(image: np.ndarray) -> tuple[float, float]:
    """Range of almost all values of an image, by some ten thousand of them."""
    values = image.ravel()[:: max(1, image.size // 10_000)].astype(float)
    values = values[np.isfinite(values)]
    if not len(values):
        return 0.0, 1.0
    low, high = np.percentile(values, [OUTERMOST, 100.0 - OUTERMOST])
    return float(low), float(high)
