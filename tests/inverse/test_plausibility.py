"""What is refused as an image of this membrane."""

import pytest

from bubbleviz.camera.observer import Misfit
from bubbleviz.inverse.plausibility import reason_against_fit


@pytest.mark.parametrize(
    ("deviations", "clumping", "white", "explained"),
    [
        (1.0, 1.0, True, True),
        (4.5, 1.0, True, True),
        (5.5, 1.0, True, False),  # more than five deviations are not noise
        (5.5, 1.0, False, False),
        (2.0, 5.0, True, True),
        (2.0, 7.0, True, False),  # six times as much as white noise leaves in squares of blocks
        (2.0, 7.0, False, True),
        (1.2, 50.0, True, True),  # smaller than the noise, whatever its shape
    ],
)
def test_a_misfit_is_noise_up_to_a_size_and_a_shape(deviations, clumping, white, explained):
    assert (reason_against_fit(Misfit(1e-4, deviations, clumping), white) == "") is explained
