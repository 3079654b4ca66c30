"""Means of the depth images of a recording while they show the same.

An object at rest is seen again and again: the mean of 2 k + 1 images has a smaller noise. It is
taken of as many frames before as after, so that a motion too slow to be seen shifts nothing, and so
that a frame has the same image however it was reached.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bubbleviz.camera import ImageChange, Measured
from bubbleviz.errors import InputError
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import Frame, FrameSource

REACH = 5
"""Most frames averaged on either side: eleven images have less than a third of the noise, a third
of a second at 30 Hz."""

_OUTLIER = 6.0  # standard deviations from the frame's own pixel beyond which none is averaged

_ONE_SIGMA = 0.683  # share of Gaussian noise within one standard deviation

_SAMPLED = 3  # of the pixels that tell it, every third of every third row


class StillFrames:
    """Frames of a recording, with the mean of the images around that show the same."""

    def __init__(self, source: FrameSource, pipeline: Pipeline) -> None:
        self._source, self._pipeline = source, pipeline
        self._change = ImageChange(pipeline.estimator.observer)
        self._measured: dict[int, Measured] = {}  # of the images read last

    def applied(self, frame: Frame) -> Frame:
        """The frame with the mean image; unchanged if it has no contact, or none around agrees."""
        own, around = self._of(frame.index, frame), list[np.ndarray]()
        for distance in range(1, REACH + 1):
            pair = self._pair(own, frame.index, distance)
            if not pair or (not around and self._pipeline.estimator.fits_rest(own)):
                break
            around += [each.depth_m for each in pair]
        if not around:
            return frame
        return replace(frame, mean_depth_m=_mean(frame.depth_m, around), images=1 + len(around))

    def _pair(self, own: Measured, index: int, distance: int) -> list[Measured]:
        """Images before and after one that show the same; empty unless both do."""
        if index < distance or index + distance >= len(self._source):
            return []
        pair = list[Measured]()
        for other in (index - distance, index + distance):
            try:
                pair.append(self._of(other))
            except InputError:  # it is damaged; its own frame says so
                return []
            if _is_same(own, pair[-1]) or self._change.differ(own, pair[-1]):
                return []
        return pair

    def _of(self, index: int, frame: Frame | None = None) -> Measured:
        """Measurement of a frame, which is read if it is not given."""
        if index not in self._measured:
            frame = frame or self._source[index]
            while len(self._measured) > 2 * REACH:
                self._measured.pop(next(iter(self._measured)))
            measured = self._pipeline.estimator.observer.measure(frame.depth_m)
            self._measured[index] = measured
        return self._measured[index]


def _is_same(one: Measured, other: Measured) -> bool:
    """Whether images are equal to the last bit, so that the second one adds nothing."""
    return np.array_equal(one.moment, other.moment)


def _mean(own: np.ndarray, around: list[np.ndarray]) -> np.ndarray:
    """Mean (H, W) of an image and those around, without outliers from it; NaN where it is."""
    total, count = np.zeros_like(own), np.ones_like(own)
    for image in around:
        change = image - own
        size = np.abs(change)
        some = size[::_SAMPLED, ::_SAMPLED]
        sigma = np.quantile(some[np.isfinite(some)], _ONE_SIGMA)
        near = size <= _OUTLIER * sigma  # not where either is NaN
        np.add(total, change, out=total, where=near)
        count += near
    mean: np.ndarray = own + total / count
    return mean
