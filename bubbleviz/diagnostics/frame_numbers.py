"""Scalar values of a frame that are plotted over time."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bubbleviz.membrane import Gas
from bubbleviz.recordings import force_of
from bubbleviz.result import HALF_95, Patch, Result, Slip, Traction

# The few numbers of a contact with friction, each with its 95 % interval.


Measure = tuple[float, float]  # value and half of its 95 % interval; NaN where it is not known
UNKNOWN: Measure = (np.nan, np.nan)
_TOLD = np.pi / 4.0  # a direction is told whose 95 % interval, rad, is within a quarter of a turn
_REGION_95 = float(np.sqrt(-2.0 * np.log(0.05)))
"""Radius that holds 95 % of a normal distribution in the plane, standard deviations."""
_OUTLINE = 61


@dataclass(frozen=True)
class ShearNumbers:
    """Force of the object on the membrane, along and across the contact's mean normal."""

    # force_n, normal_n, tangential_n: lengths, N; the mean normal is that of the normal forces,
    # into the sensor
    force_n: Measure = UNKNOWN
    normal_n: Measure = UNKNOWN
    tangential_n: Measure = UNKNOWN
    # of the tangential force, seen along z of the bubble frame: from x towards y, degrees
    direction_deg: Measure = UNKNOWN
    # about the mean normal through the contact's centre, right-handed, N·m
    torque_nm: Measure = UNKNOWN
    # largest displacement along the membrane of the nodes that are touched, m
    displacement_m: Measure = UNKNOWN
    slip_share: Measure = UNKNOWN  # share of the patch that moved against the rest of it, 0 to 1

    @classmethod
    def of(cls, traction: Traction, slip: Slip | None = None) -> ShearNumbers:
        """Numbers of a frame; depth alone gives no tangential ones."""
        along = traction.normal_force_n.sum(axis=0)
        size, force = float(np.linalg.norm(along)), traction.force_n
        if traction.status == "no_contact":
            return cls(force_n=(0.0, np.nan))
        if traction.status not in ("ok", "depth_alone") or not size > 0.0:
            return cls()
        n, covariance = along / size, traction.wrench_covariance
        total = _along(force, _unit(force), covariance[:3, :3])
        normal = _along(force, n, covariance[:3, :3])
        if traction.status == "depth_alone":
            return cls(total, normal)
        across = force - normal[0] * n
        tangential = _along(force, _unit(across), covariance[:3, :3])
        touched = traction.nodal_force_n.any(axis=1)
        moved = np.linalg.norm(traction.tangential_displacement_m[touched], axis=1)
        return cls(
            total,
            normal,
            tangential,
            _direction(across, covariance[:3, :3]),
            _along(traction.torque_nm, n, covariance[3:, 3:]),
            (float(moved.max()), HALF_95 * traction.displacement_sigma_m),
            UNKNOWN if slip is None else (slip.share, HALF_95 * slip.share_sigma),
        )


@dataclass(frozen=True)
class ShearEllipse:
    """Tangential force seen along z of the bubble frame."""

    force_n: np.ndarray  # (2,), along x and y, N
    outline_n: np.ndarray  # (k, 2), closed line around its 95 % region, N

    @classmethod
    def of(cls, traction: Traction) -> ShearEllipse | None:
        """Ellipse of a frame; None if friction is unknown."""
        along = traction.normal_force_n.sum(axis=0)
        if traction.status != "ok" or not along.any():
            return None
        n = _unit(along)
        across = (np.eye(3) - np.outer(n, n))[:2]
        force = across @ traction.force_n
        covariance = across @ traction.wrench_covariance[:3, :3] @ across.T
        lengths, axes = np.linalg.eigh(covariance)
        angle = np.linspace(0.0, 2.0 * np.pi, _OUTLINE)
        circle = np.stack([np.cos(angle), np.sin(angle)])
        reach = _REGION_95 * np.sqrt(np.maximum(lengths, 0.0))
        return cls(force, force + (axes @ (reach[:, None] * circle)).T)


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / max(float(np.linalg.norm(vector)), np.finfo(float).tiny)


def _along(vector: np.ndarray, axis: np.ndarray, covariance: np.ndarray) -> Measure:
    """Component along a unit vector (3,)."""
    return float(vector @ axis), HALF_95 * float(np.sqrt(axis @ covariance @ axis))


def _direction(across: np.ndarray, covariance: np.ndarray) -> Measure:
    """Angle of a vector (3,) in the x-y plane, degrees; unknown where it may be any."""
    x, y = across[:2]
    squared = x * x + y * y
    sideways = np.array([-y, x]) / max(squared, np.finfo(float).tiny)
    half = HALF_95 * float(np.sqrt(sideways @ covariance[:2, :2] @ sideways))
    if not half < _TOLD:
        return UNKNOWN
    return float(np.degrees(np.arctan2(y, x))), float(np.degrees(half))


NOTHING = float("nan")


@dataclass(frozen=True)
class Numbers:
    """Numbers of one frame, SI but for the times; NaN where not requested or unknown."""

    status: str = ""  # of the estimate; empty without one
    # p_v that the gas law (Eq. 6) gives for the estimated shape; 0 without contact, whose shape is
    # no measured one: a measured p_v of a drift, or of a touch too faint to be found, inflates it,
    # and its volume would say a p_v of the other sign and a dozen times as large.
    gas_law_pa: float = NOTHING
    gas_measured_pa: float = NOTHING  # measured gas pressure less the reference pressure P0
    # residual_m, solve_ms, total_ms: as in `Estimate` and `Result.times_ms`
    residual_m: float = NOTHING
    solve_ms: float = NOTHING
    total_ms: float = NOTHING
    # force_n, area_m2: length of the force vector; area of the patch
    force_n: float = NOTHING
    force_half_width_n: float = NOTHING  # half of the 95 % interval of the former
    # force of the recording's wrench, as recorded
    wrench_n: tuple[float, float, float] = (NOTHING, NOTHING, NOTHING)
    area_m2: float = NOTHING
    center_m: tuple[float, float, float] = (NOTHING, NOTHING, NOTHING)  # centre of pressure in B
    has_patch: bool = False
    has_shear: bool = False
    # depth image received → products in the window; NaN for frames not shown live
    latency_ms: float = NOTHING
    # shear_normal_n, shear_tangential_n: force with friction, across and along the membrane; NaN
    # where it is not known
    shear_normal_n: float = NOTHING
    shear_tangential_n: float = NOTHING
    shear_tangential_half_n: float = NOTHING  # half of the 95 % interval of the latter
    slip_share: float = NOTHING  # of the patch


def numbers_of(result: Result, gas: Gas) -> Numbers:
    """Numbers of a result; what it lacks is NaN."""
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
            exact = estimate.gas_law_pa
            known["residual_m"] = estimate.residual_rms_m
            known["force_half_width_n"] = estimate.force_half_width_n
            if estimate.status == "no_contact":
                known["gas_law_pa"] = 0.0
            elif exact is None:
                known["gas_law_pa"] = gas.pressure_change(estimate.displacement_m)
            else:
                known["gas_law_pa"] = exact
        if result.patch is not None:
            known |= patch_numbers(result.patch, trusted=estimate.trusted)
    if result.traction is not None:
        shear = ShearNumbers.of(result.traction, result.slip)
        known |= {
            "has_shear": True,
            "shear_normal_n": shear.normal_n[0],
            "shear_tangential_n": shear.tangential_n[0],
            "shear_tangential_half_n": shear.tangential_n[1],
            "slip_share": shear.slip_share[0],
        }
    return Numbers(**known)


def patch_numbers(patch: Patch, *, trusted: bool) -> dict[str, Any]:
    """The numbers that change with κ; NaN where the estimate is not to be trusted."""
    x, y, z = (float(c) for c in patch.center_of_pressure_m)
    return {
        "has_patch": True,
        "force_n": float(np.linalg.norm(patch.force_n)) if trusted else NOTHING,
        "area_m2": patch.area_m2 if trusted else NOTHING,
        "center_m": (x, y, z) if trusted else (NOTHING, NOTHING, NOTHING),
    }


# Summary of shear over many frames, as numbers and text.


@dataclass
class ShearSummary:
    """Shear of many frames: by status of their traction, and in that of the largest force.

    Numbers are None where there are none to trust, and tell the frame of the largest |force|.
    """

    status: dict[str, int] = field(default_factory=dict)  # number of frames by status
    reference: str = ""  # what flow was measured against, or why there was nothing
    # max_force_n, max_force_sigma_n: |force| with friction, and its standard deviation, N
    max_force_n: float | None = None
    max_force_sigma_n: float | None = None
    # torque_nm, torque_sigma_nm: about the mean normal through the contact's centre, N·m
    torque_nm: float | None = None
    torque_sigma_nm: float | None = None
    # slip_share, slip_share_sigma: 0 to 1
    slip_share: float | None = None
    slip_share_sigma: float | None = None

    def add(self, result: Result) -> None:
        traction = result.traction
        if traction is None:
            return
        self.status[traction.status] = self.status.get(traction.status, 0) + 1
        if traction.status != "ok":
            return
        found = ShearNumbers.of(traction, result.slip)
        if self.max_force_n is None or found.force_n[0] > self.max_force_n:
            self.max_force_n, self.max_force_sigma_n = _known(found.force_n)
            self.torque_nm, self.torque_sigma_nm = _known(found.torque_nm)
            self.slip_share, self.slip_share_sigma = _known(found.slip_share)

    def to_text(self) -> str:
        """Lines for the terminal; ± is half of the 95 % interval."""
        status = ", ".join(f"{count} {name}" for name, count in self.status.items())
        lines = [f"shear    {status or 'no frame'}"]
        if self.max_force_n is not None:
            numbers = _words(
                _measure(self.max_force_n, self.max_force_sigma_n),
                _measure(self.torque_nm, self.torque_sigma_nm),
                _measure(self.slip_share, self.slip_share_sigma),
            )
            lines += [f"         {numbers}, where the force was highest; ±: 95 % interval"]
            lines += ["         its direction has not been verified"]
        return "\n".join([*lines, *(f"         {line}" for line in filter(None, [self.reference]))])


def shear_line(result: Result) -> str:
    """Force with friction, torque and slip of one frame, or why there are none, in one line."""
    traction = result.traction
    if traction is None or traction.status == "no_contact":
        return ""
    if traction.status != "ok":
        status = traction.status.replace("_", " ")
        return f"{status}: {traction.reason}" if traction.reason else status
    numbers = ShearNumbers.of(traction, result.slip)
    return _words(numbers.force_n, numbers.torque_nm, numbers.slip_share)


def _words(force_n: Measure, torque_nm: Measure, slip_share: Measure) -> str:
    parts = [
        f"force {force_n[0]:.2f} ± {force_n[1]:.2g} N with friction",
        f"torque {1e3 * torque_nm[0]:.3g} ± {1e3 * torque_nm[1]:.2g} N·mm",
    ]
    if math.isfinite(slip_share[0]):
        parts.append(f"slip {1e2 * slip_share[0]:.0f} ± {1e2 * slip_share[1]:.2g} %")
    return ", ".join(parts)


def _measure(value: float | None, sigma: float | None) -> Measure:
    return math.nan if value is None else value, HALF_95 * (math.nan if sigma is None else sigma)


def _known(measure: Measure) -> tuple[float | None, float | None]:
    """Value and standard deviation; None where it is not known, as JSON has no NaN."""
    value, sigma = measure[0], measure[1] / HALF_95
    return value if math.isfinite(value) else None, sigma if math.isfinite(sigma) else None
