"""Find the frames of a press that is held, by the gas pressure."""

from __future__ import annotations

import numpy as np

from bubbleviz.calibration.rest.contact_free import LAG
from bubbleviz.calibration.rest.rest_frames import Samples
from bubbleviz.calibration.robust_statistics import robust_sigma
from bubbleviz.frames.frame_source import FrameSource
from bubbleviz.progress import Progress, quiet

_HELD = 0.9
"""Share of the largest rise of the gas pressure from which on a press counts as held."""
_CLEAR = 10.0
"""Standard deviations of the gas pressure by which a press must move it."""


def held_frames(source: FrameSource, samples: Samples, progress: Progress = quiet) -> list[int]:
    """Frames after the contact-free ones in which the gas pressure is near its largest.

    None of them where there is no gas pressure, or no press that moves it ten times its noise.
    """
    free = samples.gas_pressure_pa
    if free is None:
        return []
    rest = float(np.median(free))
    later = range(max(samples.frames) + 1, len(source))
    rises = []
    for k in later:
        value = source[k].gas_pressure_pa
        rises.append(np.nan if value is None else value - rest)
        progress("finding the press", (k - later.start) / len(later))
    rise = np.array(rises)
    if not np.isfinite(rise).any() or np.nanmax(rise) < _CLEAR * max(robust_sigma(free), 1e-9):
        return []
    return [later[k] for k in np.flatnonzero(rise > _HELD * np.nanmax(rise))]


def settled(frames: list[int]) -> list[int]:
    """Those whose images a camera's temporal filter has cleared of what was before them."""
    known = set(frames)
    return [k for k in frames if k - LAG in known]
