"""How far the force on a press moves with gauge pressure and pre-stretch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.calibration.rubber.press_fit import HeldPress

_GAUGE_STEP = 0.03
"""Step of the gauge pressure over itself: moves the force by far more than solving leaves open."""
_STRETCH_STEP = 0.1
"""Step of ln (λ − 1), so that no λ is below 1."""


@dataclass(frozen=True)
class ForceSensitivity:
    """Size of the force on a press, and what moves it.

    Attributes
    ----------
    force_n : float
        |F|, N.
    per_gauge_n_per_pa : float
        d|F|/dG, N/Pa; γ0 follows G, from which Young–Laplace has it.
    per_prestretch_n : float
        d|F|/dλ, N.
    """

    force_n: float
    per_gauge_n_per_pa: float
    per_prestretch_n: float

    @classmethod
    def of(cls, press: HeldPress, gauge_pressure_pa: float, prestretch: float) -> ForceSensitivity:
        """Central differences of the force that the mean image of a press asks for.

        Raises
        ------
        InputError
            No rubber is near the press.
        """
        gauges = [gauge_pressure_pa * (1.0 + sign * _GAUGE_STEP) for sign in (-1.0, 1.0)]
        stretches = [
            1.0 + (prestretch - 1.0) * float(np.exp(sign * _STRETCH_STEP)) for sign in (-1.0, 1.0)
        ]

        def size(gauge_pa: float, stretch: float) -> float:
            return float(np.linalg.norm(press.force(gauge_pa, stretch)))

        by_gauge = [size(gauge, prestretch) for gauge in gauges]
        by_stretch = [size(gauge_pressure_pa, stretch) for stretch in stretches]
        return cls(
            force_n=size(gauge_pressure_pa, prestretch),
            per_gauge_n_per_pa=float(np.diff(by_gauge)[0] / np.diff(gauges)[0]),
            per_prestretch_n=float(np.diff(by_stretch)[0] / np.diff(stretches)[0]),
        )
