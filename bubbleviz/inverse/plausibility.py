"""When a solution is not to be believed, however well it solves its problem."""

from __future__ import annotations

import numpy as np

from bubbleviz.camera.observer import Misfit
from bubbleviz.inverse.problem import FrameProblem

GAS_NOISE = 1e-4
"""σ of a measured gas pressure over its absolute value: 10 Pa, what barometers resolve."""

IMPLAUSIBLE_MISFIT = 5.0
"""Misfit in standard deviations that no membrane explains: not this sensor, or not in metres."""

IMPLAUSIBLE_CLUMPING = 6.0
"""Clumping beyond which residuals that averaging over blocks has not made smaller are not the
white noise of the sensor file; up to it the force is off by less than a tenth."""

GAS_LINEAR = 0.1
"""Compression p_v/P0 beyond which the linear gas law (Eq. 22) is off by a tenth of p_v."""


def explains(misfit: Misfit, white: bool) -> bool:
    """Whether a misfit is what the noise leaves.

    Parameters
    ----------
    misfit : Misfit
    white : bool
        Whether the noise should be white, see `RangeObserver.white`.
    """
    if misfit.deviations > IMPLAUSIBLE_MISFIT:
        return False
    clumped = misfit.deviations > 1.5 and misfit.clumping > IMPLAUSIBLE_CLUMPING
    return not (white and clumped)


def contradicts_gas(
    problem: FrameProblem, bulge: np.ndarray, displacement: np.ndarray, gas_noise: float
) -> bool:
    """Whether the shape, contact and all, asks for another p_v than was measured.

    A measured p_v that is too low leaves a bulge that no contact explains, as contact only
    pushes; one that is too high is taken for a contact pressure and cannot be told from it. Contact
    hides nine tenths of the error, which is why two σ of what is left are a lot.

    Parameters
    ----------
    problem : FrameProblem
    bulge : (n,) array
        Displacement under unit pressure.
    displacement : (n,) array
        Of the solution.
    gas_noise : float
        σ of a measured p_v; all dimensionless.
    """
    if problem.measured_gas is None:
        return False
    weight = float(bulge @ (problem.Q @ bulge))
    asked = float(bulge @ (problem.g - problem.Q @ displacement)) / weight
    certain = asked * np.sqrt(weight) > IMPLAUSIBLE_MISFIT
    return bool(certain and asked > 2.0 * gas_noise)
