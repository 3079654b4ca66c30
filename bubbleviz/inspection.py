"""A closer look at one frame than its result gives: what nobody looks at is not computed."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from bubbleviz.camera.images import FrameImages
from bubbleviz.camera.view import MembraneView
from bubbleviz.inverse.kappa_curve import KappaCurve, kappa_curve
from bubbleviz.pipeline import Pipeline, Product
from bubbleviz.result import Result

Look = Literal["change", "residual", "noise", "used", "kappa_curve"]
"""An image (H, W) by its name, or the curve of areas over κ."""

NEEDS: dict[Look, frozenset[Product]] = {
    "change": frozenset(),
    "residual": frozenset({"estimate"}),
    "noise": frozenset(),
    "used": frozenset(),
    "kappa_curve": frozenset({"estimate"}),
}
"""Products of the pipeline that a look is made of."""


@dataclass(frozen=True)
class Inspection:
    """What was looked at.

    Attributes
    ----------
    images : dict
        (H, W) image by name: change and residual of the range and its σ in m; `used` bool.
    kappa_curve : KappaCurve or None
    """

    images: dict[Look, np.ndarray] = field(default_factory=dict)
    kappa_curve: KappaCurve | None = None


class Inspector:
    """Looks closer at the results of a pipeline; counts its stages as `look <name>`.

    Parameters
    ----------
    pipeline : Pipeline
    """

    def __init__(self, pipeline: Pipeline) -> None:
        self._pipeline = pipeline

    def look(
        self, result: Result, looks: frozenset[Look], truth: np.ndarray | None = None
    ) -> Inspection:
        """Make what is asked for of a result; what the result lacks products for is left out.

        Parameters
        ----------
        result : Result
        looks : frozenset of Look
        truth : (H, W) bool array, optional
            True pixels of the patch, in a simulation.
        """
        images: dict[Look, np.ndarray] = {}
        curve = None
        for name in sorted(looks):
            self._pipeline.counts[f"look {name}"] += 1
            if name == "kappa_curve":
                if result.estimate is not None:
                    view = self._view if truth is not None else None
                    curve = kappa_curve(self._pipeline.mesh, result.estimate, truth, view)
                continue
            image = self._image(name, result)
            if image is not None:
                images[name] = image
        return Inspection(images, curve)

    def _image(self, name: Look, result: Result) -> np.ndarray | None:
        depth, estimate = result.frame.depth_m, result.estimate
        if name == "change":
            return self._images.change(depth)
        if name == "used":
            return self._images.used(depth)
        if name == "noise":
            return self._images.noise
        if estimate is None or estimate.status not in ("ok", "no_contact"):
            return None
        return self._images.residual(depth, estimate.displacement_m)

    @cached_property
    def _images(self) -> FrameImages:
        pipeline = self._pipeline
        return FrameImages(self._view, pipeline.sensor.camera.noise_relative, pipeline.pixels)

    @cached_property
    def _view(self) -> MembraneView:
        return MembraneView(self._pipeline.camera, self._pipeline.mesh)
