"""A short source played in a loop, with new noise every round, as a camera would have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bubbleviz.camera.depth_camera import DepthCamera
from bubbleviz.frames.frame import Frame
from bubbleviz.frames.frame_source import FrameSource
from bubbleviz.simulation.depth_noise import DepthNoise
from bubbleviz.simulation.truth import Truth, truth_of


class NoisyLoop:
    """Adds noise to frames without; it changes when reading begins again before where it was."""

    def __init__(
        self,
        source: FrameSource,  # without noise
        camera: DepthCamera,
        noise: DepthNoise,
    ) -> None:
        self._source, self._camera, self._noise = source, camera, noise
        self._round, self._last = 0, 0
        self.name, self.times_s = source.name, source.times_s

    def __len__(self) -> int:
        """Count the frames of a round."""
        return len(self._source)

    def __getitem__(self, index: int) -> Frame:
        """Frame number `index` of the present round."""
        frame = self._source[index]
        self._round += index < self._last
        self._last = index
        ranges = self._noise.apply(
            self._camera.range_image(frame.depth_m).astype(float), self._round, index
        )
        depth = self._camera.depth_image(ranges).astype(np.float32)
        return replace(frame, depth_m=depth)

    def truth(self, index: int) -> Truth | None:
        """Ground truth of a frame, the same in every round."""
        return truth_of(self._source, index)

    def close(self) -> None:
        """Close the source."""
        self._source.close()
