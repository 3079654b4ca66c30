"""Means of the depth images of a recording while they show the same.

Eleven images of an object at rest have a third of the noise of one. A straight line over time is
fitted to each pixel of the images before and after a frame, and evaluated at the time of the frame:
a motion too slow to be detected then causes no bias. The images come from the recording, not from
the frames solved before, so that the result does not depend on the order of frames.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bubbleviz.camera import ImageChange, Measured
from bubbleviz.errors import InputError
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import Frame, FrameSource

_REACH = 5
"""Most frames averaged on either side: eleven images are a third of a second at 30 Hz."""

_OUTLIER = 6.0
"""Difference from the frame's own pixel, in standard deviations, beyond which one is left out."""

_ONE_SIGMA = 0.683  # share of Gaussian noise within one standard deviation

_STRIDE = 3  # that standard deviation is estimated from every third pixel of every third row


class _Seen(NamedTuple):
    time_s: float
    image: Measured


class StillFrames:
    """Frames of a recording, with the mean of the images around that show the same."""

    def __init__(self, source: FrameSource, pipeline: Pipeline) -> None:
        self._source, self._pipeline = source, pipeline
        self._change = ImageChange(pipeline.estimator.observer)
        self._seen: dict[int, _Seen] = {}  # frames read last

    def applied(self, frame: Frame) -> Frame:
        """The frame with the mean image; unchanged if it has no contact, or too few agree."""
        own, index = self._of(frame.index, frame), frame.index
        before = range(index - 1, max(index - _REACH, 0) - 1, -1)
        after = range(index + 1, min(index + _REACH + 1, len(self._source)))
        around: list[_Seen] = []
        for side in (before, after):
            for other in self._agreeing(own.image, side):
                if not around and self._pipeline.estimator.fits_rest(own.image):
                    return frame
                around.append(other)
        if len(around) < 2:  # a straight line through two images is the frame's own image there
            return frame
        times_s = np.array([frame.time_s, *(each.time_s for each in around)])
        mean = _mean(frame.depth_m, [each.image.depth_m for each in around], _weights(times_s)[1:])
        return replace(frame, mean_depth_m=mean, images=1 + len(around))

    def _agreeing(self, own: Measured, side: range) -> Iterator[_Seen]:
        """Frames that show the same as one, up to the first that does not."""
        for index in side:
            try:
                other = self._of(index)
            except InputError:  # it is damaged; its own frame says so
                return
            same = np.array_equal(own.moment, other.image.moment)  # to the last bit: adds nothing
            if same or self._change.differ(own, other.image):
                return
            yield other

    def _of(self, index: int, frame: Frame | None = None) -> _Seen:
        """A frame, which is read if it is not given."""
        if index not in self._seen:
            frame = frame or self._source[index]
            while len(self._seen) > 2 * _REACH:
                self._seen.pop(next(iter(self._seen)))
            image = self._pipeline.estimator.observer.measure(frame.depth_m)
            self._seen[index] = _Seen(frame.time_s, image)
        return self._seen[index]


def _weights(times_s: np.ndarray) -> np.ndarray:
    """Weights (k,) of values, for a straight line fitted over times, at the first of the times."""
    weights = np.full(len(times_s), 1.0 / len(times_s))
    from_mean = times_s - times_s.mean()
    if spread := float(from_mean @ from_mean):
        weights += from_mean[0] / spread * from_mean
    return weights


def _mean(own: np.ndarray, around: list[np.ndarray], weights: np.ndarray) -> np.ndarray:
    """Weighted mean (H, W) of an image and others; NaN where the image is.

    `weights` are those of the others, and the image has the rest to 1. Where a pixel of another
    image is missing or an outlier, its weight goes to the image's own pixel.
    """
    mean = own.copy()
    for image, weight in zip(around, weights.astype(np.float32), strict=True):
        change = image - own
        size = np.abs(change)
        some = size[::_STRIDE, ::_STRIDE]
        sigma = np.quantile(some[np.isfinite(some)], _ONE_SIGMA)
        near = size <= _OUTLIER * sigma  # not where either is NaN
        np.add(mean, weight * change, out=mean, where=near)
    return mean
