"""The colour images of a recording, by time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bubbleviz.colour.colour_image import ColourImage, EncodedImage
from bubbleviz.colour.colour_topics import find_camera
from bubbleviz.frames.bags import Bag, Topic
from bubbleviz.frames.gaps import usual_step
from bubbleviz.frames.time_series import Laps, Timeline


class RecordedColour:
    """Colour images beside the depth images of a recording; only headers are read here.

    Parameters
    ----------
    bag : Bag
    topic : Topic
        Of the colour images.
    depth : Topic
        Of the depth images.
    reading : callable
        Runs a function that reads a message, one at a time, errors as of a damaged file.
    by_log : bool
        Whether frames are timed by their log times.
    laps : Laps, optional
        Those of the depth images, where there is more than one.

    Attributes
    ----------
    topic : Topic
    camera : ColourCamera
    encoding : str
    size : (int, int)
        Width and height, pixels.
    rate_hz : float or None
        One over the median period; None for fewer than two images.
    """

    def __init__(
        self,
        bag: Bag,
        topic: Topic,
        depth: Topic,
        reading: Callable[[Callable[[], EncodedImage]], EncodedImage],
        *,
        by_log: bool = False,
        laps: Laps | None = None,
    ) -> None:
        self.topic, self._reading = topic, reading
        self._messages = bag.messages(topic)
        self._timeline = Timeline(self._messages, by_log=by_log, laps=laps)
        self.camera = find_camera(bag, topic, depth)
        first = EncodedImage.of(self._messages.message(0))
        self.encoding, self.size = first.encoding, first.size
        step = usual_step(np.diff(self._messages.log_ns))
        self.rate_hz = None if step is None else 1e9 / step

    def __len__(self) -> int:
        """Count the images."""
        return len(self._messages)

    def nearest(
        self, stamp_ns: int, log_ns: int, within_ns: int, time_s: float
    ) -> ColourImage | None:
        """Image nearest to a frame's stamp (with laps: its key) or log time; None further off.

        Parameters
        ----------
        stamp_ns, log_ns : int
        within_ns : int
        time_s : float
            Time of the frame, which the image's is told from.
        """
        k, off_ns = self._timeline.nearest(stamp_ns, log_ns)
        if abs(off_ns) > within_ns:
            return None

        def read() -> EncodedImage:
            return self._reading(lambda: EncodedImage.of(self._messages.message(k)))

        stamp = self._messages.stamp_ns(k)
        return ColourImage(read, stamp, time_s + 1e-9 * off_ns, self.camera)
