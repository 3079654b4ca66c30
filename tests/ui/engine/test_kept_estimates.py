"""What is kept of frames, and what is let go."""

from __future__ import annotations

import numpy as np

from bubbleviz.diagnostics.frame_numbers import Numbers
from bubbleviz.result import Estimate
from bubbleviz_ui.engine.kept_estimates import KeptEstimates

NODES = 1000


def estimate() -> Estimate:
    nothing = np.zeros(NODES)
    return Estimate("no_contact", nothing, nothing.copy(), 0.0, 0.0, 0.0)


def test_the_oldest_is_let_go_first() -> None:
    kept = KeptEstimates(3 * 2 * 8 * NODES)  # three of them
    for frame in (0, 1, 2, 0, 3):  # frame 0 is computed again
        kept.keep(frame, Numbers(area_m2=frame), estimate())
    assert kept.get(1) is None
    known = [kept.get(frame) for frame in (0, 2, 3)]
    assert [each[0].area_m2 for each in known if each] == [0, 2, 3]
