"""A looped source: the ground truth repeats, the noise does not."""

import numpy as np
import pytest

from bubbleviz.camera import DepthCamera, Intrinsics
from bubbleviz.recordings import Frame
from bubbleviz.simulation import DepthNoise, NoisyLoop

SIGMA = 1e-3


class Flat:
    name, times_s = "flat", np.arange(3) / 30.0

    def __len__(self):
        return 3

    def __getitem__(self, index):
        return Frame(index, index / 30.0, np.full((40, 50), 0.1 + 0.01 * index, np.float32))

    def close(self):
        pass


@pytest.fixture
def rounds():
    camera = DepthCamera(Intrinsics(50, 40, 40.0, 40.0, 25.0, 20.0), np.eye(4))
    return NoisyLoop(Flat(), camera, DepthNoise(absolute_m=SIGMA))


def test_noise_matches_the_camera_and_differs_in_every_loop(rounds):
    first = [rounds[k].depth_m for k in range(3)]
    second = [rounds[k].depth_m for k in range(3)]
    for k, (a, b) in enumerate(zip(first, second, strict=True)):
        assert np.mean(a) == pytest.approx(0.1 + 0.01 * k, abs=1e-4)
        assert np.std(a - b) == pytest.approx(np.sqrt(2.0) * SIGMA, rel=0.25)
        assert abs(np.corrcoef((a - a.mean()).ravel(), (b - b.mean()).ravel())[0, 1]) < 0.1


def test_a_frame_shown_again_has_the_same_result(rounds):
    np.testing.assert_array_equal(rounds[1].depth_m, rounds[1].depth_m)
