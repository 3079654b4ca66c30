"""A looped source: the ground truth repeats, the noise does not."""

import numpy as np
import pytest

from bubbleviz.camera import DepthCamera, Intrinsics
from bubbleviz.recordings import Frame, HeldFrames
from bubbleviz.simulation import DepthNoise, LoopedSource

SIGMA = 1e-3


CAMERA = DepthCamera(Intrinsics(50, 40, 40.0, 40.0, 25.0, 20.0), np.eye(4))


@pytest.fixture
def rounds():
    flat = [Frame(k, k / 30.0, np.full((40, 50), 0.1 + 0.01 * k, np.float32)) for k in range(3)]
    return LoopedSource(HeldFrames(flat), CAMERA, DepthNoise(absolute_m=SIGMA))


def test_noise_matches_the_camera_and_differs_in_every_loop(rounds):
    first = [rounds[k].depth_m for k in range(3)]
    second = [rounds[k].depth_m for k in range(3)]
    for k, (a, b) in enumerate(zip(first, second, strict=True)):
        assert np.mean(a) == pytest.approx(0.1 + 0.01 * k, abs=1e-4)
        assert np.std(a - b) == pytest.approx(np.sqrt(2.0) * SIGMA, rel=0.25)
        assert abs(np.corrcoef((a - a.mean()).ravel(), (b - b.mean()).ravel())[0, 1]) < 0.1


def test_a_frame_is_simulated_once_and_without_noise_of_loops_is_the_same(rounds):
    read = list[int]()

    class Counted(HeldFrames):
        def __getitem__(self, index):
            read.append(index)
            return super().__getitem__(index)

    frames = [rounds[k] for k in range(3)]
    loop = LoopedSource(Counted(frames), CAMERA)
    for k in (0, 1, 2, 0, 1):
        np.testing.assert_array_equal(loop[k].depth_m, frames[k].depth_m)
    assert read == [0, 1, 2]
