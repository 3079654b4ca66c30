"""The few numbers of a contact with friction, each with its 95 % interval."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.result import HALF_95, Slip, Traction

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
        """Numbers of a frame; by depth alone nothing is known of what is tangential."""
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
        """That of a frame; None where nothing is known of friction."""
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
