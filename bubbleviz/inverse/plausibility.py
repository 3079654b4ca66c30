"""When a solution is not to be believed, however well it solves its problem."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from bubbleviz.camera import Misfit
from bubbleviz.membrane import Gas
from bubbleviz.result import Status

GAS_NOISE = 1e-4
"""σ of a measured gas pressure over its absolute value: 10 Pa, what barometers resolve."""

GAS_MODEL_ERROR = 0.02
"""Share of p_v by which the exact membrane's bulge under it is not known: triangles of 3 mm on a
dome of 45 mm leave 0.01 of it, μh 0.01 to 0.02 where it was identified from levels."""

GAS_LAG = 0.05
"""Share of the gauge pressure, which contacts carry, by which a measured p_v may be off without
being of another sensor or zero. Chosen; on the one real press they lag by up to 0.02 of it."""

IMPLAUSIBLE_MISFIT = 5.0
"""Misfit in standard deviations that no membrane explains: not this sensor, or not in metres."""

IMPLAUSIBLE_CLUMPING = 6.0
"""Clumping beyond which residuals that averaging over blocks has not made smaller are not the
white noise of the sensor file; up to it the force is off by less than a tenth."""

IMPLAUSIBLE_SHARE = 0.2
"""Misfit over the membrane's size beyond which an image shows noise and no membrane, however well
that noise was told by its own scatter. Chosen; eight times the noise of the sensor file leave 0.05
of it."""

STATUS_REASONS: Mapping[Status, str] = MappingProxyType(
    {
        "no_data": "too few depth pixels lie on the membrane",
        "not_converged": "no equilibrium was found",
        "implausible": "depths are far from this membrane: wrong sensor file or depth unit?",
    }
)
"""Reason of a status where nothing more is known."""
GAS_CONTRADICTS = "the measured gas pressure does not fit the measured shape"


def reason_against_gas(change_pa: float, gas: Gas) -> str:
    """Why this membrane cannot cause a measured p_v; empty if it can."""
    if gas.lowest_change_pa <= change_pa <= gas.highest_change_pa:
        return ""
    return (
        f"gas pressure differs from the sensor file by {1e-3 * change_pa:+.1f} kPa, more than "
        "contact can change it"
    )


def reason_against_fit(misfit: Misfit, white: bool, size_m: float) -> str:
    """Why a misfit is larger than noise; empty if it is not.

    Parameters
    ----------
    misfit : Misfit
    white : bool
        Whether the noise should be white, see `RangeObserver.white`.
    size_m : float
        Size of the membrane, m.
    """
    if misfit.rms_m > IMPLAUSIBLE_SHARE * size_m:
        return f"depths are {1e3 * misfit.rms_m:.0f} mm from any shape that this membrane can take"
    if misfit.deviations > IMPLAUSIBLE_MISFIT:
        return f"depths are {misfit.deviations:.0f} σ from any shape that this membrane can take"
    clumped = misfit.deviations > 1.5 and misfit.clumping > IMPLAUSIBLE_CLUMPING
    return (
        "residuals are not white, unlike the noise in the sensor file" if white and clumped else ""
    )


def gas_sigma(gas: Gas, measured_pa: float) -> float:
    """Standard deviation of a measured p_v, and of what the exact membrane makes of it, Pa."""
    parts = GAS_NOISE * gas.P0, GAS_MODEL_ERROR * measured_pa, gas.zero_sigma_pa
    return float(np.linalg.norm(parts))


def contradicts_measured_gas(
    asked_pa: float, measured_pa: float, gas: Gas, gauge_pressure_pa: float
) -> bool:
    """Whether the shape of the exact membrane asks for another p_v than was measured."""
    certain = IMPLAUSIBLE_MISFIT * gas_sigma(gas, measured_pa)
    return abs(asked_pa - measured_pa) > max(certain, GAS_LAG * gauge_pressure_pa)
