"""Optical flow of frames from contact-free colour images, for a pipeline to make traction of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from bubbleviz.camera import ColourCamera, DepthCamera, readable
from bubbleviz.errors import InputError
from bubbleviz.recordings import LAG, MIN_FRAMES, Frame, Recording, placed
from bubbleviz.result import Result
from bubbleviz.shear.optical_flow import FlowField, FlowPreset, OpticalFlow
from bubbleviz.shear.traction_estimator import TractionOptions

if TYPE_CHECKING:
    import numpy as np

    from bubbleviz.pipeline import Pipeline


class TextureFlow:
    """Flow of the colour image of a frame.

    Parameters
    ----------
    flow : OpticalFlow
    learned_from, granted : str, optional
        What it was learned from, and `ColourCamera.remark`.

    Attributes
    ----------
    remark : str
        Both in one line; or why it is of no use.
    """

    def __init__(self, flow: OpticalFlow, learned_from: str = "", granted: str = "") -> None:
        self._flow = flow
        camera = f"colour camera: {granted}" if granted else ""
        self.remark = flow.problem or "; ".join(filter(None, (learned_from, camera)))

    def __call__(self, frame: Frame) -> FlowField | None:
        """Flow of a frame; None where there is no image of its moment.

        Empty, with the reason, where the image cannot be read or is of another size.
        """
        try:
            colour = frame.colour
            return None if colour is None else self._flow.measure(colour.grey())
        except InputError as error:
            return self._flow.nothing(str(error))

    def watched_by(self, pipeline: Pipeline, camera: DepthCamera, options: TractionOptions) -> None:
        """Have a pipeline make traction by it.

        Raises InputError: the camera does not see the membrane, or the estimator is not of the
        exact membrane; the pipeline then goes on by depth alone.
        """
        pipeline.watch_texture(self, camera, options)
        try:
            pipeline.prepare(frozenset({"traction"}))
        except InputError:
            pipeline.watch_texture(None, options=options)
            raise


def delay_text(delay_s: float) -> str:
    """How colour and depth are paired where that is not by equal stamps, to add to a sentence."""
    return f", colour delay {delay_s:+.3f} s" if delay_s else ""


def flow_camera(colour: ColourCamera, depth: DepthCamera, name: str) -> DepthCamera:
    """The camera whose images flow is of, in the bubble frame.

    Raises InputError: where its pixels look is not known; `name` tells whose it is.
    """
    camera = placed(colour, depth)
    if camera is None:
        raise InputError(
            f"{name}: no camera info for the colour images, so their flow cannot be mapped to the "
            "membrane; record or publish it with them"
        )
    return camera


# Flow against contact-free colour images that are taken of frames as they pass.


COLLECTED = 20  # images that are collected of frames that pass: two thirds of a second at 30 Hz


class PassingTexture:
    """Has a pipeline make traction once it has seen enough frames without contact.

    Attributes
    ----------
    words : str
        What flow is measured against, or why there is nothing, in one sentence.
    """

    def __init__(
        self,
        pipeline: Pipeline,  # by depth alone until then
        # Coulomb's bound μ of the traction along the membrane over that across it
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


# Optical flow of a recording's colour images, for the pipeline to make traction of.


def recorded_texture(
    recording: Recording,
    contact_free: Sequence[int],  # frames before the first contact
    preset: FlowPreset = "fast",
    colour_delay_s: float = 0.0,
) -> TextureFlow:
    """Learn reference and noise from the images before the first contact.

    Raises InputError: there are no colour images, or too few before the first contact.
    """
    times_s = (recording.times_s + colour_delay_s).tolist()
    found = {k: recording.colour_at(times_s[k]) for k in contact_free[:-LAG]}
    seen = readable({k: image for k, image in found.items() if image is not None})
    if len(seen) < MIN_FRAMES:
        raise InputError(
            f"{recording.path}: shear needs {MIN_FRAMES} colour images before the first contact, "
            f"there are {len(seen)}; record one second without contact first, or leave out --shear"
        )
    flow = OpticalFlow.of(seen.values(), preset)
    said = f"contact-free frames {min(seen)}–{max(seen)}{delay_text(colour_delay_s)}"
    granted = "" if recording.colour is None else recording.colour.camera.remark
    return TextureFlow(flow, said, granted)


def watch_recorded_texture(
    pipeline: Pipeline,
    recording: Recording,
    contact_free: Callable[[], Sequence[int]],  # finds the frames before the first contact
    friction: float | None = None,
    preset: FlowPreset = "fast",
) -> str:
    """Have a pipeline make traction by the recording's own colour images; tells which, in words.

    Raises InputError: as of `recorded_texture`, `flow_camera` and `TextureFlow.watched_by`.
    """
    if recording.colour is None:
        raise InputError(f"{recording.path}: has no colour images; leave out --shear")
    options = TractionOptions(friction or None)
    camera = flow_camera(recording.colour.camera, pipeline.camera, str(recording.path))
    texture = recorded_texture(
        recording, contact_free(), preset, pipeline.model.sensor.camera.colour_delay_s
    )
    texture.watched_by(pipeline, camera, options)
    return texture.remark
