"""Plausibility checks on converged estimates."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from bubbleviz.camera import SHIFTS, ImageErrors, Misfit
from bubbleviz.membrane import Gas
from bubbleviz.result import Status

GAS_NOISE = 1e-4
"""σ of a measured gas pressure over its absolute value: 10 Pa, what barometers resolve."""

GAS_MODEL_ERROR = 0.02
"""Relative uncertainty of the exact membrane's bulge under p_v: triangles of 3 mm on a dome of
45 mm contribute 0.01, μh 0.01 to 0.02 where it was identified from several gas pressures."""

GAS_LAG = 0.05
"""Largest error of a measured p_v, relative to the gauge pressure: a larger one means a wrong
sensor file or zero. Chosen; on the one real press, p_v lags by up to 0.02."""

IMPLAUSIBLE_MISFIT = 5.0
"""Misfit in standard deviations beyond which the image does not fit the membrane: wrong sensor file
or depth unit."""

IMPLAUSIBLE_CLUMPING = 6.0
"""Clumping (see `Misfit`) beyond which residuals are not the white noise of the sensor file, as
averaging over blocks does not reduce them; up to it the force is off by less than a tenth."""

IMPLAUSIBLE_REGION = 10.0
"""Median residual of a square of the image, in standard deviations, beyond which it does not show
the membrane. Chosen: correct presses reach 4, a plane across a whole dome 9.5, a hand 190."""

IMPLAUSIBLE_SHARE = 0.2
"""Misfit relative to the membrane's size beyond which an image shows no membrane, however noisy it
is. Chosen; eight times the noise of the sensor file has a misfit of 0.05."""

IMPLAUSIBLE_SHIFT = 10.0
"""Sideways motion of the camera since the calibration, in standard deviations of that of a moved
one, beyond which no force is told. Chosen: 5 mm at 100 mm; in a simulation with shifts to first
order the force is 0.5 to 1.8 half widths of its interval off at 4 mm, and 1.6 at 12 mm."""

STATUS_REASONS: Mapping[Status, str] = MappingProxyType(
    {
        "no_data": "too few depth pixels lie on the membrane, or too few on the contact for the "
        "mesh there; uncover the camera, coarsen the mesh (membrane.nodes), check the sensor "
        "file, or see the information on damaged images (bubbleviz info; window: File menu)",
        "not_converged": "the solver did not converge; look at the residual in the window, or try "
        "another solver (--solver)",
        "implausible": "depths do not fit this membrane; an object may hide it, or the press may "
        "be too deep to solve; otherwise check sensor file and unit of depth",
    }
)
"""Default reason of each status."""
GAS_CONTRADICTS = (
    "the measured gas pressure does not fit the measured shape; zero it without contact, or check "
    "the pressure sensor and the gauge pressure in the sensor file"
)


def reason_against_gas(change_pa: float, gas: Gas, *, measured: bool = True) -> str:
    """Why p_v, measured or by the shape, is impossible for this membrane; empty if possible."""
    if gas.lowest_change_pa <= change_pa <= gas.highest_change_pa:
        return ""
    change = f"{1e-3 * change_pa:+.1f} kPa"
    if measured:
        return (
            f"the measured gas pressure differs from the sensor file by {change}, more than "
            "contact can change it; correct the sensor file, or check the pressure sensor"
        )
    return (
        f"this image's shape would change the gas pressure by {change}, more than contact can; "
        "check sensor file and unit of depth"
    )


def reason_against_camera(errors: np.ndarray, moved: ImageErrors) -> str:
    """Why errors (e,) of the whole image are too large for a moved camera; empty if they are not.

    `moved`: prior of the errors of one.
    """
    shift_m, sigma_m = float(np.linalg.norm(errors[SHIFTS])), np.sqrt(moved.covariance[-1, -1])
    if shift_m <= IMPLAUSIBLE_SHIFT * sigma_m:
        return ""
    return (
        f"the camera is {1e3 * shift_m:.0f} mm beside its place in the sensor file, or turned as "
        "much; check its mounting and the sensor file, or identify the sensor again"
    )


def reason_against_fit(misfit: Misfit, white: bool, size_m: float) -> str:
    """Why a misfit is implausible; empty if it is plausible.

    Parameters
    ----------
    misfit : Misfit
    white : bool
        Whether the noise should be white, see `RangeObserver.white`.
    size_m : float
        Size of the membrane, m.
    """
    if misfit.rms_m > IMPLAUSIBLE_SHARE * size_m:
        return (
            f"depths are {1e3 * misfit.rms_m:.0f} mm from any shape that this membrane can take; "
            "check sensor file and unit of depth"
        )
    if misfit.deviations > IMPLAUSIBLE_MISFIT:
        return (
            f"depths are {misfit.deviations:.0f} standard deviations from any shape that this "
            "membrane can take; check sensor file and unit of depth"
        )
    if misfit.regional > IMPLAUSIBLE_REGION:
        return (
            "depths of a region are not of this membrane; look at the residual in the window for a "
            "foreign object or a fold, or check the sensor file"
        )
    clumped = misfit.deviations > 1.5 and misfit.clumping > IMPLAUSIBLE_CLUMPING
    return (
        "residuals are spatially correlated, unlike the noise in the sensor file; run bubbleviz "
        "check"
        if white and clumped
        else ""
    )


def gas_sigma(gas: Gas, measured_pa: float) -> float:
    """Standard deviation of a measured p_v and of the membrane's response to it, Pa."""
    parts = GAS_NOISE * gas.P0, GAS_MODEL_ERROR * measured_pa, gas.zero_sigma_pa
    return float(np.linalg.norm(parts))


def contradicts_measured_gas(
    shape_pa: float,
    measured_pa: float,
    gas: Gas,
    gauge_pressure_pa: float,
    gauge_sigma_pa: float = 0.0,  # its standard deviation: the stiffness is as uncertain
) -> bool:
    """Whether p_v by the shape of the exact membrane contradicts the measured one."""
    noise_bound = IMPLAUSIBLE_MISFIT * gas_sigma(gas, measured_pa)
    by_stiffness = 1.96 * gauge_sigma_pa / gauge_pressure_pa * abs(measured_pa)
    bound = max(noise_bound, GAS_LAG * gauge_pressure_pa, by_stiffness)
    return abs(shape_pa - measured_pa) > bound
