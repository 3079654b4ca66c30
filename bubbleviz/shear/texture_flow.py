"""Optical flow of frames relative to contact-free colour images, for tractions of a pipeline."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from bubbleviz.camera import ColourCamera, DepthCamera, FlowField, readable
from bubbleviz.errors import InputError
from bubbleviz.recordings import LAG, MIN_FRAMES, NO_COLOUR, Frame, Recording, placed
from bubbleviz.result import Result
from bubbleviz.shear.optical_flow import OpticalFlow

if TYPE_CHECKING:
    import numpy as np

    from bubbleviz.pipeline import Pipeline


class TextureFlow:
    """Flow of the colour image of a frame.

    Parameters
    ----------
    flow : OpticalFlow
    reference, assumption : str, optional
        Description of the contact-free images, and `ColourCamera.remark`.

    Attributes
    ----------
    remark : str
        Both in one line; or why flow cannot be measured.
    """

    def __init__(self, flow: OpticalFlow, reference: str = "", assumption: str = "") -> None:
        self._flow = flow
        camera = f"colour camera: {assumption}" if assumption else ""
        self.remark = flow.problem or "; ".join(filter(None, (reference, camera)))

    def __call__(self, frame: Frame) -> FlowField | None:
        """Flow of a frame; None if it has no colour image.

        Empty, with the reason, if the image cannot be read or is of another size.
        """
        try:
            colour = frame.colour
            return None if colour is None else self._flow.measure(colour.grey())
        except InputError as error:
            return self._flow.nothing(str(error))

    def attach_to(self, pipeline: Pipeline, camera: DepthCamera) -> None:
        """Have a pipeline estimate tractions by this flow.

        Raises InputError: the camera does not see the membrane, or the estimator is not of the
        exact membrane; the pipeline then uses depth only.
        """
        pipeline.use_optical_flow(self, camera)
        try:
            pipeline.prepare(frozenset({"traction"}))
        except InputError:
            pipeline.use_optical_flow(None)
            raise


def delay_text(delay_s: float) -> str:
    """Text for a delay between colour and depth, to append to a sentence; empty for none."""
    return f", colour delay {delay_s:+.3f} s" if delay_s else ""


def flow_camera(colour: ColourCamera, depth: DepthCamera, name: str) -> DepthCamera:
    """The colour camera in the bubble frame.

    Raises InputError: it is not calibrated; `name` says whose it is.
    """
    camera = placed(colour, depth)
    if camera is None:
        raise InputError(
            f"{name}: no intrinsics for colour images of this size, so their flow cannot be mapped "
            "to the membrane; record or publish their camera info"
        )
    return camera


# Contact-free colour images collected from live frames.


COLLECTED = 20  # images to collect: two thirds of a second at 30 Hz


class PassingTexture:
    """Has a pipeline estimate tractions after enough frames without contact.

    Attributes
    ----------
    words : str
        Reference of the flow, or why there is none, in one sentence.
    """

    def __init__(
        self,
        pipeline: Pipeline,  # by depth only until then
    ) -> None:
        self.words = ""
        self._pipeline = pipeline
        self._images: dict[int, np.ndarray] | None = {}  # None after they are collected
        self._recent: dict[int, np.ndarray] = {}  # colour may show a contact before depth
        pipeline.use_optical_flow(None)

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
        self.words = f"Collecting colour images without contact: {count} of {COLLECTED}"
        if colour is not None and count >= COLLECTED:
            self._images, self._recent = None, {}
            self._learn(images, colour.camera)

    def _add(self, index: int, grey: np.ndarray, images: dict[int, np.ndarray]) -> None:
        """Add an image as contact-free after `LAG` more contact-free frames."""
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
        delay_s = self._pipeline.model.sensor.camera.colour_delay_s
        reference = f"{len(images)} images without contact{delay_text(delay_s)}"
        try:
            camera = flow_camera(colour, self._pipeline.camera, "colour camera")
            flow = OpticalFlow.of(images.values())
            texture = TextureFlow(flow, reference, colour.remark)
            texture.attach_to(self._pipeline, camera)
        except InputError as error:
            self.words = f"Depth alone: {error}"
            return
        self.words = texture.remark


# Optical flow of a recording's colour images.


def recorded_texture(
    recording: Recording,
    contact_free: Sequence[int],  # frames before the first contact
    colour_delay_s: float = 0.0,
) -> TextureFlow:
    """Learn reference and noise from the images before the first contact.

    Raises InputError: there are no colour images, or too few before the first contact.
    """
    times_s = (recording.times_s + colour_delay_s).tolist()
    images = {k: recording.colour_at(times_s[k]) for k in contact_free[:-LAG]}
    seen = readable({k: image for k, image in images.items() if image is not None})
    if len(seen) < MIN_FRAMES:
        raise InputError(
            f"{recording.path}: shear needs {MIN_FRAMES} readable colour images before the first "
            f"contact, there are {len(seen)}; record a second without contact first, or leave out "
            "shear (--shear)"
        )
    flow = OpticalFlow.of(seen.values())
    reference = f"contact-free frames {min(seen)}–{max(seen)}{delay_text(colour_delay_s)}"
    assumption = "" if recording.colour is None else recording.colour.camera.remark
    return TextureFlow(flow, reference, assumption)


def watch_recorded_texture(
    pipeline: Pipeline,
    recording: Recording,
    contact_free: Callable[[], Sequence[int]],  # finds the frames before the first contact
) -> str:
    """Have a pipeline estimate tractions by a recording's colour images; returns a description.

    Raises InputError: as of `recorded_texture`, `flow_camera` and `TextureFlow.attach_to`.
    """
    if recording.colour is None:
        raise InputError(f"{recording.path}: {NO_COLOUR}; record them, or leave out --shear")
    camera = flow_camera(recording.colour.camera, pipeline.camera, str(recording.path))
    delay_s = pipeline.model.sensor.camera.colour_delay_s
    texture = recorded_texture(recording, contact_free(), delay_s)
    texture.attach_to(pipeline, camera)
    return texture.remark
