"""Exact nonlinear contact of a constant-tension bubble, a reference for the linear model.

A film of tension γ0 over a circular rim, pressed on its axis by a ball or a flat plate without
friction. The free part is a surface of revolution of constant mean curvature, P = γ0 (κ1 + κ2);
where the film lies on the ball the contact pressure is P + 2 γ0/R_ball. There are no triangles, no
normals of a reference shape, and displacements are not assumed small.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from bubbleviz.errors import SolveError


@dataclass(frozen=True)
class Bubble:
    """A spherical-cap bubble at rest, whose tension follows from Young–Laplace."""

    rim_radius_m: float
    height_m: float
    gauge_pressure_pa: float
    atmospheric_pressure_pa: float
    chamber_volume_m3: float  # gas behind the rim plane, m³

    @property
    def radius_m(self) -> float:
        """Radius of the sphere, m."""
        return (self.rim_radius_m**2 + self.height_m**2) / (2.0 * self.height_m)

    @property
    def tension_n_per_m(self) -> float:
        """γ0 = P R / 2, N/m."""
        return 0.5 * self.gauge_pressure_pa * self.radius_m

    @property
    def cap_volume_m3(self) -> float:
        """Volume under the cap, m³."""
        a, h = self.rim_radius_m, self.height_m
        return np.pi * h * (3.0 * a**2 + h**2) / 6.0


@dataclass(frozen=True)
class AxialContact:
    """Exact equilibrium of a bubble pressed on its axis."""

    contact_radius_m: float  # radius of the circle where the film leaves the object, m
    gas_pressure_change_pa: float  # p_v, Pa
    contact_pressure_pa: float  # uniform in the contact, Pa
    force_n: float  # force on the object along the axis, N
    profile_m: np.ndarray  # (k, 2), r and z of the free part from the contact to the rim, m


def axial_contact(bubble: Bubble, depth_m: float, ball_radius_m: float = np.inf) -> AxialContact:
    """Press a ball (a plate if the radius is infinite) to `depth_m` below the apex.

    Raises
    ------
    SolveError
        No such equilibrium: the depth is not within the bubble.
    """
    if not 0.0 < depth_m < bubble.height_m:
        raise SolveError(f"depth {depth_m} m is not within the bubble's {bubble.height_m} m")
    P0 = bubble.atmospheric_pressure_pa + bubble.gauge_pressure_pa
    filled = P0 * (bubble.chamber_volume_m3 + bubble.cap_volume_m3)

    def gas_excess(gauge: float) -> float:
        shape = _shape(bubble, depth_m, ball_radius_m, gauge)
        volume = bubble.chamber_volume_m3 + shape[1]
        return (bubble.atmospheric_pressure_pa + gauge) * volume - filled

    low, high = bubble.gauge_pressure_pa, 1.05 * bubble.gauge_pressure_pa
    while gas_excess(high) < 0.0:
        low, high = high, 1.05 * high
    gauge = float(brentq(gas_excess, low, high, xtol=1e-9 * low, rtol=1e-12))
    radius, _, profile = _shape(bubble, depth_m, ball_radius_m, gauge)
    pressure = gauge + 2.0 * bubble.tension_n_per_m / ball_radius_m
    return AxialContact(
        contact_radius_m=radius,
        gas_pressure_change_pa=gauge - bubble.gauge_pressure_pa,
        contact_pressure_pa=pressure,
        force_n=pressure * np.pi * radius**2,
        profile_m=profile,
    )


def _shape(
    bubble: Bubble, depth: float, ball: float, gauge: float
) -> tuple[float, float, np.ndarray]:
    """Contact radius at which the free part ends on the rim; volume under the film; profile."""

    def miss(contact_radius: float) -> float:
        end = _free_part(bubble, depth, ball, gauge, contact_radius)[0][-1]
        return float(end[0] - bubble.rim_radius_m)

    widest = 0.999 * min(bubble.rim_radius_m, ball)
    radius = float(brentq(miss, 1e-6 * bubble.rim_radius_m, widest, xtol=1e-13, rtol=1e-13))
    profile, volume = _free_part(bubble, depth, ball, gauge, radius)
    return radius, volume, profile


def _free_part(
    bubble: Bubble, depth: float, ball: float, gauge: float, contact_radius: float
) -> tuple[np.ndarray, float]:
    """Meridian (r, z) from the contact down to z = 0, and the volume under the film.

    Arc length s, angle ψ below the horizontal: r' = cos ψ, z' = −sin ψ,
    ψ' = P/γ0 − sin ψ / r.
    """
    slope = np.arcsin(contact_radius / ball) if np.isfinite(ball) else 0.0
    sag = ball * (1.0 - np.cos(slope)) if slope else 0.0
    tip = bubble.height_m - depth
    curvature = gauge / bubble.tension_n_per_m

    def along(_: float, y: np.ndarray) -> list[float]:
        r, _z, psi, _v = y
        sine, cosine = np.sin(psi), np.cos(psi)
        return [cosine, -sine, curvature - sine / r, np.pi * r * r * sine]

    def at_rim_plane(_: float, y: np.ndarray) -> float:
        return float(y[1])

    at_rim_plane.terminal = True  # type: ignore[attr-defined]
    at_rim_plane.direction = -1.0  # type: ignore[attr-defined]
    # Film on the ball: the spherical segment above its tip is outside the gas.
    segment = np.pi * sag**2 * (ball - sag / 3.0) if slope else 0.0
    start = [contact_radius, tip + sag, -slope, 0.0]
    longest = 6.0 * (bubble.rim_radius_m + bubble.height_m)
    result = solve_ivp(
        along,
        (0.0, longest),
        start,
        "DOP853",
        events=at_rim_plane,
        rtol=1e-10,
        atol=1e-13,
        dense_output=True,
    )
    # V = ∫ π r² (−dz) of the free part, less the dent between tip and contact circle.
    dense: Any = result.sol
    profile = dense(np.linspace(0.0, result.t[-1], 401))[:2].T
    return profile, float(result.y[3, -1]) - segment
