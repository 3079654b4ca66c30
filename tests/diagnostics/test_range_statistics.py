"""Statistics over a range of frames."""

import numpy as np
import pytest

from bubbleviz.diagnostics import statistics


def test_unknown_frames_are_ignored():
    found = statistics(np.array([np.nan, 2.0, 4.0, 9.0, np.nan]))
    assert (found.mean, found.minimum, found.maximum, found.frames) == (5.0, 2.0, 9.0, 3)
    assert found.standard_deviation == pytest.approx(np.sqrt(13.0))


def test_statistics_of_one_frame_and_of_none():
    assert np.isnan(statistics(np.array([3.0])).standard_deviation)
    nothing = statistics(np.full(4, np.nan))
    assert nothing.frames == 0 and np.isnan(nothing.mean)
