"""The magnitude of a measured force: its bias, and what remains unknown."""

import numpy as np
import pytest

from bubbleviz.recordings import force_of, measured_force

BIAS = np.array([-0.41, -0.63, -0.53])
PRESS = np.array([3.0, 0.0, -4.0])


def test_bias_is_the_median_of_contact_free_frames():
    wrench = BIAS + np.array([[0, 0, 0], [0, 0, 0], [40, 0, 0], PRESS, PRESS / 5], float)
    free = np.array([True, True, True, False, False])  # one of them is an outlier
    np.testing.assert_allclose(measured_force(wrench, free)[[0, 3, 4]], [0.0, 5.0, 1.0], atol=1e-12)


def test_no_measured_force_without_a_contact_free_wrench():
    wrench = np.vstack([np.full(3, np.nan), BIAS + PRESS])
    assert np.isnan(measured_force(wrench, np.array([True, False]))).all()
    assert np.isnan(measured_force(wrench, np.array([False, False]))).all()
    found = measured_force(np.vstack([BIAS, wrench]), np.array([True, True, False]))
    assert np.isnan(found[1]) and found[2] == pytest.approx(5.0)


def test_force_of_a_wrench():
    assert np.isnan(force_of(None)).all()
    np.testing.assert_array_equal(force_of(np.arange(6.0)), [0, 1, 2])
