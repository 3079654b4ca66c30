"""Which frames of a press a wrench is compared in."""

import numpy as np
import pytest

from bubbleviz.calibration.tension.wrench_tension import press_halves
from bubbleviz.frames.frame import Frame

REST, RISE, HOLD = 20, 10, 10
NOISE_N = 0.05


class Wrenches:
    """A source of wrenches alone: rest with a bias, a press to 4 N that holds, and release."""

    name = "wrenches"

    def __init__(self, top_n=4.0, missing=()):
        rng, bias = np.random.default_rng(0), np.array([-0.4, -0.6, -0.5])
        up = np.linspace(0.0, top_n, RISE, endpoint=False)
        size = np.concatenate([np.zeros(REST), up, np.full(HOLD, top_n), up[::-1]])
        way = np.array([0.6, 0.0, -0.8])
        self.forces = bias + size[:, None] * way + NOISE_N * rng.standard_normal((len(size), 3))
        self.missing, self.times_s = missing, np.arange(len(size)) / 30.0

    def __len__(self):
        return len(self.forces)

    def __getitem__(self, k):
        wrench = (
            None if k in self.missing else np.append(self.forces[k], [9.0 * (-1.0) ** k, 5.0, 0.0])
        )
        return Frame(k, self.times_s[k], np.zeros((2, 2), np.float32), wrench=wrench)


def test_halves_of_a_press_are_of_the_frames_above_half_of_its_force():
    """2 N are passed after five of ten frames of the rise, and left after four of the release."""
    first, second = press_halves(Wrenches(), range(REST))
    picked = first + second
    assert len(first) == len(second) == 4 and picked == sorted(set(picked))
    assert picked[0] == pytest.approx(REST + RISE / 2, abs=1)
    assert picked[-1] == pytest.approx(REST + RISE + HOLD + 3, abs=1)
    assert len(press_halves(Wrenches(), range(REST), 5)[1]) == 3


@pytest.mark.parametrize("source", [
    Wrenches(top_n=0.5), Wrenches(missing=(0,)), Wrenches(missing=(len(Wrenches()) - 1,)),
])  # fmt: skip
def test_a_press_that_noise_hides_or_no_wrench_saw_has_none(source):
    assert press_halves(source, range(REST)) is None


def test_contact_free_all_along_has_none():
    assert press_halves(Wrenches(), range(len(Wrenches()))) is None
