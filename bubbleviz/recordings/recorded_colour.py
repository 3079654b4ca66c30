"""Colour images of a recording, of a frame, and as a texture of the membrane."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from bubbleviz.camera import ColourCamera, ColourImage, DepthCamera, EncodedImage
from bubbleviz.errors import InputError
from bubbleviz.recordings.bag import Bag, Topic
from bubbleviz.recordings.colour_topics import find_camera
from bubbleviz.recordings.depth_topics import has_data
from bubbleviz.recordings.frame import Frame, usual_step
from bubbleviz.recordings.time_series import NEAREST_NS, Moment, Series, recorded_series


def half_step_ns(stamps_ns: np.ndarray) -> int:
    """Half the usual step of frames: colour images further from one belong to others."""
    step = usual_step(np.diff(stamps_ns))
    return NEAREST_NS if step is None else int(step) // 2


@dataclass(frozen=True)
class ColourAround:
    """Finds the colour image nearest to a time after a frame, s; called, as `Frame.find_colour`."""

    images: Series[ColourImage]
    moment: Moment
    time_s: float  # of the frame
    within_ns: int  # an image further off does not belong to that moment

    def __call__(self, after_s: float) -> ColourImage | None:
        """Nearest image among those present when this object was made."""
        found = self.images.nearest(self.moment.later(round(1e9 * after_s)), self.within_ns)
        if found is None:
            return None
        k, off_ns = found
        return replace(self.images.item(k), time_s=self.time_s + after_s + 1e-9 * off_ns)


class RecordedColour:
    """Colour images of the recording of depth images; only headers are read here."""

    def __init__(
        self,
        bag: Bag,
        topic: Topic,  # of the colour images
        depth: Topic,  # of the depth images
        # calls a function that reads a message; one at a time, with the errors of a damaged file
        reading: Callable[[Callable[[], EncodedImage]], EncodedImage],
        *,
        by_log: bool = False,  # whether frames are timed by their log times
    ) -> None:
        messages = bag.messages(topic)

        def image(k: int) -> ColourImage:
            read = partial(reading, lambda: EncodedImage.of(messages.message(k)))
            return ColourImage(read, messages.stamp_ns(k), camera=self.camera)

        self.topic, self.camera = topic, find_camera(bag, topic, depth)
        self.images = recorded_series(messages, image, by_log=by_log)
        first = EncodedImage.of(messages.first(has_data))
        # size: width and height, pixels
        self.encoding, self.size = first.encoding, first.size
        step = usual_step(np.diff(messages.log_ns))
        # one over the median period; None for fewer than two images
        self.rate_hz = None if step is None else 1e9 / step

    def __len__(self) -> int:
        return len(self.images)


@dataclass(frozen=True)
class FrameColour:
    rgb: np.ndarray | None = None  # (H, W, 3) uint8
    camera: ColourCamera = field(default_factory=ColourCamera)
    reason: str = ""  # why there is no image; empty if there is one

    @classmethod
    def of(cls, frame: Frame) -> FrameColour:
        if frame.find_colour is None:
            return cls(reason=frame.no_colour)
        try:
            found = frame.colour
            if found is None:
                return cls(reason="no colour image at this time")
            return cls(found.rgb(), found.camera)
        except InputError:  # the depth image can be used without it
            return cls(reason="the colour image cannot be read or decoded")

    def aligned(self, depth: DepthCamera) -> bool:
        """Whether its pixels have the same rays as the pixels of the depth image."""
        same = self.camera.intrinsics == depth.intrinsics
        return same and np.array_equal(self.camera.T_D_C, np.eye(4))


@dataclass(frozen=True)
class Texture:
    """A colour image mapped to the deformed membrane."""

    colour: FrameColour
    # (n, 2), position of each node in the image: fractions of the width and of the height, from the
    # upper left corner
    place: np.ndarray
    seen: np.ndarray  # (n,) bool, nodes inside the image
    reason: str = ""  # why there is no texture; empty if there is one

    @classmethod
    def of(cls, colour: FrameColour, nodes_m: np.ndarray, depth: DepthCamera) -> Texture:
        camera = placed(colour.camera, depth)
        if colour.rgb is None or camera is None:
            nothing = np.zeros((len(nodes_m), 2)), np.zeros(len(nodes_m), bool)
            why = colour.reason or "the intrinsics of the colour camera are not known"
            return cls(colour, *nothing, why)
        own, points = camera.intrinsics, camera.local(nodes_m)
        before = points[:, 2] > 0.0
        points[~before] = (0.0, 0.0, 1.0)
        place = (own.project(points) + 0.5) / (own.width, own.height)  # pixel centres are integers
        return cls(colour, place, before & np.all((place >= 0.0) & (place <= 1.0), axis=1))


def placed(colour: ColourCamera, depth: DepthCamera) -> DepthCamera | None:
    """The colour camera in the bubble frame; None where its intrinsics are not known."""
    if colour.intrinsics is None:
        return None
    return DepthCamera(colour.intrinsics, depth.T_B_C @ colour.T_D_C)
