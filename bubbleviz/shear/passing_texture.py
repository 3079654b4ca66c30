"""Flow against contact-free colour images that are taken of frames as they pass."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bubbleviz.calibration.rest.contact_free import LAG
from bubbleviz.colour.colour_image import ColourCamera
from bubbleviz.errors import InputError
from bubbleviz.pipeline import Pipeline
from bubbleviz.result import Result
from bubbleviz.shear.texture_flow import TextureFlow, delay_text, flow_camera
from bubbleviz.shear.traction_estimator import TractionOptions

if TYPE_CHECKING:
    import numpy as np

    from bubbleviz.colour.optical_flow import FlowPreset

COLLECTED = 20
"""Images that are collected of frames that pass: two thirds of a second at 30 Hz."""


class PassingTexture:
    """Has a pipeline make traction once it has seen enough frames without contact.

    Parameters
    ----------
    pipeline : Pipeline
        By depth alone until then.
    friction : float, optional
        Coulomb's bound μ of the traction along the membrane over that across it.
    preset : {"fast", "balanced", "fine"}

    Attributes
    ----------
    words : str
        What flow is measured against, or why there is nothing, in one sentence.
    """

    def __init__(
        self,
        pipeline: Pipeline,
        friction: float | None = None,
        preset: FlowPreset = "fast",
    ) -> None:
        self.words = ""
        self._pipeline, self._options, self._preset = (
            pipeline,
            TractionOptions(friction or None),
            preset,
        )
        self._images: dict[int, np.ndarray] | None = {}  # while they are collected
        self._recent: dict[int, np.ndarray] = {}  # colour may show a contact before depth
        pipeline.watch_texture(None, options=self._options)

    def take(self, result: Result) -> None:
        """Take the colour image of a frame without contact, until there are enough."""
        images, estimate = self._images, result.estimate
        if images is None or estimate is None:
            return
        if result.frame.find_colour is None:
            self.words = f"Depth alone: {result.frame.no_colour}"
            return
        colour = result.frame.colour if estimate.status == "no_contact" else None
        if estimate.status != "no_contact":
            self._recent.clear()
        elif colour is not None:
            try:
                self._add(result.frame.index, colour.grey(), images)
            except InputError as error:
                self.words = str(error)
                return
        count = len(images) + len(self._recent)
        self.words = f"Collecting images without contact: {count} of {COLLECTED}"
        if colour is not None and count >= COLLECTED:
            self._images, self._recent = None, {}
            self._learn(images, colour.camera)

    def _add(self, index: int, grey: np.ndarray, images: dict[int, np.ndarray]) -> None:
        """Count an image as contact-free once the next `LAG` frames are so, too."""
        recent = self._recent
        if any(grey.shape != other.shape for other in (images | recent).values()):
            images.clear()  # another camera mode
            recent.clear()
        if index not in images:
            recent[index] = grey
        while len(recent) > LAG:
            oldest = next(iter(recent))
            images[oldest] = recent.pop(oldest)

    def _learn(self, images: dict[int, np.ndarray], colour: ColourCamera) -> None:
        from bubbleviz.colour.optical_flow import OpticalFlow  # OpenCV, for shear alone

        delay_s = self._pipeline.model.sensor.camera.colour_delay_s
        said = f"{len(images)} images without contact{delay_text(delay_s)}"
        try:
            camera = flow_camera(colour, self._pipeline.camera, "colour camera")
            flow = OpticalFlow.of(images.values(), self._preset)
            texture = TextureFlow(flow, said, colour.remark)
            texture.watched_by(self._pipeline, camera, self._options)
        except InputError as error:
            self.words = f"Depth alone: {error}"
            return
        self.words = texture.remark
