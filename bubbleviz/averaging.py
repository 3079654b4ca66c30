"""Means of the depth images of a recording while they show the same.

An object at rest is seen again and again, and the mean of eleven images has a third of the noise.
It is taken of images before and after a frame, with weights by which a motion too slow to be seen
shifts nothing: those of a straight line through the images over time, at the time of the frame. So
it is the same however the frame was reached.
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

REACH = 5
"""Most frames averaged on either side: eleven images are a third of a second at 30 Hz."""

_OUTLIER = 6.0  # standard deviations from the frame's own pixel beyond which none is averaged

_ONE_SIGMA = 0.683  # share of Gaussian noise within one standard deviation

_SAMPLED = 3  # of the pixels that tell it, every third of every third row


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
        before = range(index - 1, max(index - REACH, 0) - 1, -1)
        after = range(index + 1, min(index + REACH + 1, len(self._source)))
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
            while len(self._seen) > 2 * REACH:
                self._seen.pop(next(iter(self._seen)))
            image = self._pipeline.estimator.observer.measure(frame.depth_m)
            self._seen[index] = _Seen(frame.time_s, image)
        return self._seen[index]


def _weights(times_s: np.ndarray) -> np.ndarray:
    """Weights (k,) of values by which a straight line over their times has its first value."""
    weights = np.full(len(times_s), 1.0 / len(times_s))
    from_mean = times_s - times_s.mean()
    if spread := float(from_mean @ from_mean):
        weights += from_mean[0] / spread * from_mean
    return weights


def _mean(own: np.ndarray, around: list[np.ndarray], weights: np.ndarray) -> np.ndarray:
    """Weighted mean (H, W) of an image and others, without outliers from it; NaN where it is.

    `weights` of the others; its own is the rest to 1, as is that of what is left out.
    """
    mean = own.copy()
    for image, weight in zip(around, weights.astype(np.float32), strict=True):
        change = image - own
        size = np.abs(change)
        some = size[::_SAMPLED, ::_SAMPLED]
        sigma = np.quantile(some[np.isfinite(some)], _ONE_SIGMA)
        near = size <= _OUTLIER * sigma  # not where either is NaN
        np.add(mean, weight * change, out=mean, where=near)
    return mean
