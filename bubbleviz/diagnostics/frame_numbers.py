"""Scalar values of a frame that are plotted over time."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bubbleviz.membrane import Gas
from bubbleviz.recordings import force_of
from bubbleviz.result import HALF_95, Patch, Result

# Summary values of a contact with friction, with 95 % intervals.


Measure = tuple[float, float]  # value and half of its 95 % interval; NaN: unknown
UNKNOWN: Measure = (np.nan, np.nan)
_MAX_DIRECTION_ERROR = np.pi / 4.0  # largest half of a 95 % interval, rad, of a known direction
_REGION_95 = float(np.sqrt(-2.0 * np.log(0.05)))
"""Radius of 95 % of a normal distribution in the plane, in standard deviations."""
_OUTLINE_POINTS = 61


@dataclass(frozen=True)
class ShearNumbers:
    """Force of the object on the membrane, along and across the contact's mean normal."""

    # force_n, normal_n, tangential_n: magnitudes, N; the mean normal is the direction of the summed
    # normal forces, into the sensor
    force_n: Measure = UNKNOWN
    normal_n: Measure = UNKNOWN
    tangential_n: Measure = UNKNOWN
    # of the tangential force in the x-y plane of the bubble frame, from x towards y, degrees
    direction_deg: Measure = UNKNOWN
    # about the mean normal through the contact's centre, right-handed, N·m
    torque_nm: Measure = UNKNOWN
    # largest tangential displacement of the nodes in contact, m
    displacement_m: Measure = UNKNOWN
    slip_share: Measure = UNKNOWN  # share of the patch that slips relative to the rest, 0 to 1
    # tangential force along x and y of B, (2,), N, and the outline of its 95 % region, (k, 2)
    across_n: np.ndarray | None = None
    outline_n: np.ndarray | None = None

    @classmethod
    def of(cls, result: Result) -> ShearNumbers:
        """Values of a frame; displacement and slip are unknown from depth alone."""
        traction, slip = result.traction, result.slip
        if traction is None:
            return cls()
        estimate, patch = result.solution
        nodal, friction = estimate.nodal_force_n, estimate.friction_n
        if estimate.status == "no_contact":
            return cls(force_n=(0.0, np.nan))
        if not estimate.trusted or nodal is None or friction is None:
            return cls()
        assert estimate.wrench_covariance is not None  # as of every estimate of friction
        force, covariance = nodal.sum(axis=0), estimate.wrench_covariance[:3, :3]
        n = _unit(force - friction.sum(axis=0))
        total, normal = _along(force, _unit(force), covariance), _along(force, n, covariance)
        if not friction.any():  # it was not estimated
            return cls(total, normal)
        across = force - normal[0] * n
        center = patch.center_of_pressure_m
        found = cls(
            total,
            normal,
            _along(force, _unit(across), covariance),
            _direction(across, covariance),
            _along(patch.torque_nm, n, estimate.torque_covariance_about(center)),
            across_n=across[:2],
            outline_n=_outline(across, n, covariance),
        )
        if estimate.flow is None:
            return found
        moved = np.linalg.norm(traction.tangential_displacement_m[nodal.any(axis=1)], axis=1)
        return replace(
            found,
            displacement_m=(float(moved.max()), HALF_95 * estimate.flow.displacement_sigma_m),
            slip_share=UNKNOWN if slip is None else (slip.share, HALF_95 * slip.share_sigma),
        )


def _outline(across: np.ndarray, n: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """95 % region of a force (3,) across a normal (3,), in the x-y plane, (k, 2)."""
    project = (np.eye(3) - np.outer(n, n))[:2]
    lengths, axes = np.linalg.eigh(project @ covariance @ project.T)
    angle = np.linspace(0.0, 2.0 * np.pi, _OUTLINE_POINTS)
    reach = _REGION_95 * np.sqrt(np.maximum(lengths, 0.0))
    ellipse: np.ndarray = (axes * reach) @ np.stack([np.cos(angle), np.sin(angle)])
    return across[:2] + ellipse.T


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / max(float(np.linalg.norm(vector)), np.finfo(float).tiny)


def _along(vector: np.ndarray, axis: np.ndarray, covariance: np.ndarray) -> Measure:
    """Component along a unit vector (3,)."""
    return float(vector @ axis), HALF_95 * float(np.sqrt(axis @ covariance @ axis))


def _direction(across: np.ndarray, covariance: np.ndarray) -> Measure:
    """Angle of a vector (3,) in the x-y plane, degrees; unknown if its interval is too wide."""
    x, y = across[:2]
    squared = x * x + y * y
    sideways = np.array([-y, x]) / max(squared, np.finfo(float).tiny)
    half = HALF_95 * float(np.sqrt(sideways @ covariance[:2, :2] @ sideways))
    if not half < _MAX_DIRECTION_ERROR:
        return UNKNOWN
    return float(np.degrees(np.arctan2(y, x))), float(np.degrees(half))


NOTHING = float("nan")


@dataclass(frozen=True)
class Numbers:
    """Values of one frame, SI, run times in ms; NaN if not requested or unknown."""

    status: str = ""  # of the estimate; empty without one
    # p_v by the gas law (Eq. 6) for the estimated shape; 0 without contact, where that shape is not
    # measured but follows from the measured p_v: a drift of it inflates the shape, whose volume
    # would give a p_v of the opposite sign, a dozen times as large.
    gas_law_pa: float = NOTHING
    gas_measured_pa: float = NOTHING  # measured gas pressure minus the reference pressure P0
    # residual_m, solve_ms, total_ms: as in `Estimate` and `Result.times_ms`
    residual_m: float = NOTHING
    peak_pa: float = NOTHING  # largest contact pressure
    solve_ms: float = NOTHING
    total_ms: float = NOTHING
    # force_n, area_m2: magnitude of the force; area of the patch
    force_n: float = NOTHING
    force_half_width_n: float = NOTHING  # half of the 95 % interval
    # force of the recorded wrench, uncorrected
    wrench_n: tuple[float, float, float] = (NOTHING, NOTHING, NOTHING)
    area_m2: float = NOTHING
    center_m: tuple[float, float, float] = (NOTHING, NOTHING, NOTHING)  # centre of pressure in B
    has_patch: bool = False
    has_shear: bool = False
    # depth image received → products in the window; only of live frames
    latency_ms: float = NOTHING
    # shear_normal_n, shear_tangential_n: force with friction, normal and tangential
    shear_normal_n: float = NOTHING
    shear_tangential_n: float = NOTHING
    shear_tangential_half_n: float = NOTHING  # half of the 95 % interval
    slip_share: float = NOTHING  # of the patch


def numbers_of(result: Result, gas: Gas) -> Numbers:
    """Values of a result; NaN if missing."""
    estimate, measured = result.estimate, result.frame.gas_pressure_pa
    known: dict[str, Any] = {
        "gas_measured_pa": NOTHING if measured is None else measured - gas.P0,
        "wrench_n": tuple(force_of(result.frame.wrench).tolist()),
        "total_ms": result.times_ms.get("total", NOTHING),
    }
    if estimate is not None:
        known |= {
            "status": estimate.status,
            "solve_ms": estimate.solve_ms,
        }
        if estimate.trusted:
            known["residual_m"] = estimate.residual_rms_m
            known["force_half_width_n"] = estimate.force_half_width_n
            if estimate.status == "ok":
                known["peak_pa"] = float(estimate.contact_pressure_pa.max(initial=0.0))
            if estimate.status == "no_contact":
                known["gas_law_pa"] = 0.0
            elif estimate.gas_law_pa is None:
                known["gas_law_pa"] = gas.pressure_change(estimate.displacement_m)
            else:
                known["gas_law_pa"] = estimate.gas_law_pa
        if result.patch is not None:
            known |= patch_numbers(result.patch, trusted=estimate.trusted)
    if result.traction is not None:
        shear = ShearNumbers.of(result)
        known |= {
            "has_shear": True,
            "shear_normal_n": shear.normal_n[0],
            "shear_tangential_n": shear.tangential_n[0],
            "shear_tangential_half_n": shear.tangential_n[1],
            "slip_share": shear.slip_share[0],
        }
    return Numbers(**known)


def patch_numbers(patch: Patch, *, trusted: bool) -> dict[str, Any]:
    """The values that depend on κ; NaN without trusted estimate."""
    x, y, z = (float(c) for c in patch.center_of_pressure_m)
    return {
        "has_patch": True,
        "force_n": float(np.linalg.norm(patch.force_n)) if trusted else NOTHING,
        "area_m2": patch.area_m2 if trusted else NOTHING,
        "center_m": (x, y, z) if trusted else (NOTHING, NOTHING, NOTHING),
    }


def shear_line(result: Result) -> str:
    """One line with force, torque and slip of a frame, or the reason why they are unknown."""
    traction = result.traction
    if traction is None or traction.status == "no_contact":
        return ""
    if traction.status != "ok":
        status = traction.status.replace("_", " ")
        return f"{status}: {traction.reason}" if traction.reason else status
    return _words(ShearNumbers.of(result))


def _words(numbers: ShearNumbers) -> str:
    force_n, torque_nm, slip_share = numbers.force_n, numbers.torque_nm, numbers.slip_share
    parts = [
        f"force {force_n[0]:.2f} ± {force_n[1]:.2g} N with friction",
        f"torque about the contact normal {1e3 * torque_nm[0]:.3g} ± {1e3 * torque_nm[1]:.2g} N·mm",
    ]
    if math.isfinite(slip_share[0]):
        parts.append(f"slip {1e2 * slip_share[0]:.0f} ± {1e2 * slip_share[1]:.2g} %")
    return ", ".join(parts)
