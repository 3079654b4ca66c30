"""Colour images of a recording, and the image nearest to a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bubbleviz.camera import ColourImage, EncodedImage
from bubbleviz.recordings.bag import Bag, Topic
from bubbleviz.recordings.colour_topics import find_camera
from bubbleviz.recordings.depth_topics import has_data
from bubbleviz.recordings.frame import usual_step
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
