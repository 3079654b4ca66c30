"""Means of depth images that show the same.

A straight line over time is fitted to each pixel of the images around a frame, and evaluated at the
time of the frame: a motion too slow to be detected then causes no bias. Images of an object at rest
from both sides of a frame, as in a recording, leave 0.3 of the noise of one; those before a live
frame leave 0.7. The images of a recording are read from it, so that the result does not depend on
the order in which frames are solved.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bubbleviz.camera import ImageChange, Measured
from bubbleviz.errors import InputError
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import Frame, FrameSource

_REACH = 5
"""Most frames averaged on either side: eleven images are a third of a second at 30 Hz. More before
a live frame would cost accuracy: a simulated press that oscillates by 0.04 N a frame is off by
0.031 N with five, 0.034 N with seven, 0.038 N with ten and 0.030 N without."""

_OUTLIER = 6.0
"""A pixel that differs from the frame's own by more standard deviations than this is left out."""

_ONE_SIGMA = 0.683  # share of Gaussian noise within one standard deviation

_STRIDE = 8  # that standard deviation is estimated from every eighth pixel of every eighth row


class _Seen(NamedTuple):
    time_s: float
    image: Measured


class StillFrames:
    """Frames of a recording, with the mean of the images around that show the same.

    Without `source`: frames of a stream, with the mean of those given before.
    """

    def __init__(
        self,
        pipeline: Pipeline,
        source: FrameSource | None = None,
        *,
        both_sides: bool = True,  # False: only of those before, as of a live stream
    ) -> None:
        self._pipeline, self._source, self._both_sides = pipeline, source, both_sides
        self._change = ImageChange(pipeline.estimator.observer)
        self._seen: dict[int, _Seen] = {}  # frames read last

    def applied(self, frame: Frame) -> Frame:
        """The frame with the mean image; unchanged if it has no contact, or too few agree."""
        if self._source is None:
            self._seen.pop(frame.index, None)  # streams may begin anew
        own = self._of(frame.index, frame)
        noisy = own.image.at_noise(frame.noise)
        around: list[_Seen] = []
        for side in self._sides(frame):
            for other in self._agreeing(own.image, side):
                if not around and self._pipeline.estimator.fits_rest(noisy):
                    return frame
                around.append(other)
        if len(around) < 2:  # a straight line through two images is the frame's own image there
            return frame
        times_s = np.array([frame.time_s, *(each.time_s for each in around)])
        weights = _weights(times_s)
        mean = _mean(frame.depth_m, [each.image.depth_m for each in around], weights[1:])
        of_recording = self._both_sides and self._source is not None
        noise = float(np.linalg.norm(weights)) if of_recording else 1.0
        return replace(frame, mean_depth_m=mean, images=1 + len(around), mean_noise=noise)

    def _sides(self, frame: Frame) -> tuple[Iterable[int], ...]:
        """Indices of frames before and after one, the nearest first."""
        index = frame.index
        if self._source is None:
            seen = reversed(self._seen.items())
            earlier = [k for k, each in seen if k < index and each.time_s < frame.time_s]
            return (earlier[:_REACH],)
        before = range(index - 1, max(index - _REACH, 0) - 1, -1)
        after = range(index + 1, min(index + _REACH + 1, len(self._source)))
        return (before, after) if self._both_sides else (before,)

    def _agreeing(self, own: Measured, side: Iterable[int]) -> Iterator[_Seen]:
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
            if frame is None:
                assert self._source is not None  # frames of streams are given
                frame = self._source[index]
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

    `weights` are those of the others; the weight of the image is the rest, to a sum of 1. If a
    pixel of another image is missing or an outlier, its weight goes to the image's own pixel.
    """
    mean = own.copy()
    for image, weight in zip(around, weights.astype(np.float32), strict=True):
        change = image - own
        size = np.abs(change)
        some = size[::_STRIDE, ::_STRIDE]
        sigma = np.quantile(some[np.isfinite(some)], _ONE_SIGMA)
        near = size <= _OUTLIER * sigma  # not where either is NaN
        mean += weight * np.where(near, change, np.float32(0.0))
    return mean
