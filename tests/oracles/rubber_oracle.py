"""Exact contact of an axisymmetric rubber membrane, a reference for the triangle mesh.

An incompressible neo-Hookean membrane over a circular rim, inflated and pressed on its axis by a
ball, a flat plate or the sharp-edged end of a rod without friction: ordinary differential equations
along the meridian, solved by shooting, without triangles and without an energy.

With stretches λ1 along and λ2 around the meridian, tensions T = μh (λ_i² − (λ1 λ2)⁻²)/(λ1 λ2),
radius r, arc length s and slope ψ below the horizontal,

    d(r T1)/ds = T2 cos ψ,   T1 dψ/ds + T2 sin ψ / r = p   without contact.

At a sharp edge ψ jumps and T1 does not: without friction the edge's line load bisects the angle.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from math import acos, asin, cos, pi, sin
from typing import Any
from warnings import catch_warnings

import numpy as np
from scipy.integrate import ode
from scipy.optimize import root

from bubbleviz.errors import SolveError
from bubbleviz.membrane import MembraneMesh, mesh_cap, spherical_cap

_cap = cache(lambda rim_m, height_m, nodes: mesh_cap(spherical_cap(rim_m, height_m), nodes))
_START = 1e-5
"""Share of the meridian at which integration begins; the apex is isotropic up to there."""


@dataclass(frozen=True)
class Meridian:
    """A solution along the meridian, from the axis to the rim."""

    s_m: np.ndarray  # (k,), arc length on the stress-free sheet or dome, m
    # r_m, z_m: (k,), m
    r_m: np.ndarray
    z_m: np.ndarray
    stretches: np.ndarray  # (k, 2), λ1 and λ2 over the stress-free material
    tensions_n_per_m: np.ndarray  # (k, 2), T1 and T2
    volume_m3: float  # under the membrane, m³


@dataclass(frozen=True)
class RubberPress:
    """Exact equilibrium of a rubber membrane pressed on its axis."""

    meridian: Meridian
    contact_radius_m: float  # of the circle where the membrane leaves the object, m
    gas_pressure_change_pa: float  # p_v, Pa
    force_n: float  # on the object along the axis, N

    def contact_area_m2(self, radius_m: float) -> float:
        """Area of the contact on the spherical surface at rest, m²."""
        s = np.interp(self.contact_radius_m, self.meridian.r_m, self.meridian.s_m)
        return float(2.0 * pi * radius_m**2 * (1.0 - cos(s / radius_m)))

    def surface(self, rim_m: float, height_m: float, nodes: int = 8_000) -> MembraneMesh:
        """Mesh of the deformed surface, as dense along the meridian as the cap's."""
        r, z = (np.concatenate([[v[0]], v]) for v in (self.meridian.r_m, self.meridian.z_m))
        r[0] = 0.0
        cap = _cap(rim_m, height_m, nodes)
        height = np.interp(np.hypot(*cap.nodes[:, :2].T), r, z)
        height[cap.rim] = 0.0
        return replace(cap, nodes=np.column_stack([cap.nodes[:, :2], height]))


@dataclass(frozen=True)
class AxialRubber:
    """A round rubber membrane under gauge pressure, at rest."""

    rim_radius_m: float
    mu_h_n_per_m: float
    prestretch: float  # λ of the dome at rest, or of the flat sheet before it is inflated
    gauge_pressure_pa: float
    # height of a dome of uniform tension at rest, so that G R / 2 = μh (1 − λ⁻⁶); None: a sheet
    # that was flat before inflation by G
    dome_height_m: float | None = None
    atmospheric_pressure_pa: float = 101_325.0
    chamber_volume_m3: float = 3e-4  # gas behind the rim plane, m³

    @classmethod
    def dome(
        cls, rim_radius_m: float, height_m: float, prestretch: float, gauge_pressure_pa: float
    ) -> AxialRubber:
        """Spherical dome of uniform tension; μh follows from λ."""
        radius = (rim_radius_m**2 + height_m**2) / (2.0 * height_m)
        mu_h = 0.5 * gauge_pressure_pa * radius / (1.0 - prestretch**-6)
        return cls(rim_radius_m, mu_h, prestretch, gauge_pressure_pa, height_m)

    @cached_property
    def rest(self) -> Meridian:
        """The membrane at rest.

        Raises
        ------
        SolveError
            No equilibrium: the pressure is above the limit that the sheet can hold.
        """
        a, flat = self.rim_radius_m, self.dome_height_m is None
        guess = [self.prestretch, self.dome_height_m or 0.25 * a]
        steps = np.linspace(0.1, 1.0, 10) if flat else [1.0]
        if flat:  # a linear sheet's height under the first of the pressures
            tension = self.mu_h_n_per_m * (1.0 - self.prestretch**-6)
            guess[1] = steps[0] * self.gauge_pressure_pa * a**2 / (4.0 * max(tension, 1e-9))
        for share in steps:
            pressure = share * self.gauge_pressure_pa

            def missed(unknown: np.ndarray, pressure: float = pressure) -> np.ndarray:
                end = self._meridian(unknown[0], unknown[1], pressure, np.inf, 0.0, points=2)
                return np.array([end.r_m[-1] - a, end.z_m[-1]])

            guess = list(_root(missed, np.array(guess), "rest"))
        return self._meridian(guess[0], guess[1], self.gauge_pressure_pa, np.inf, 0.0)

    @property
    def height_m(self) -> float:
        """Height of the apex at rest, m."""
        return float(self.rest.z_m[0])

    def press(
        self,
        depth_m: float,
        ball_radius_m: float = np.inf,
        face_radius_m: float = np.inf,  # of the sharp edge at which the ball or plate ends
    ) -> RubberPress:
        """Press a ball (a plate if the radius is infinite) to `depth_m` below the apex.

        Raises
        ------
        SolveError
            No such equilibrium was found.
        """
        rest, a = self.rest, self.rim_radius_m
        P0 = self.atmospheric_pressure_pa + self.gauge_pressure_pa
        filled = P0 * (self.chamber_volume_m3 + rest.volume_m3)
        span = rest.s_m[-1]

        def missed(depth: float, u: np.ndarray) -> np.ndarray:
            z = self.height_m - depth
            end = self._meridian(u[0], z, u[2], ball_radius_m, u[1] * span, u[3], points=2)
            gas = (self.atmospheric_pressure_pa + u[2]) * (self.chamber_volume_m3 + end.volume_m3)
            left = end.r_m[-1] / a - 1.0, end.z_m[-1] / a, gas / filled - 1.0
            inside = face_radius_m / float(np.interp(u[1] * span, end.s_m, end.r_m)) - 1.0
            # No kink short of the edge, no contact beyond it (Fischer–Burmeister).
            edge = u[3] if np.isinf(inside) else u[3] + inside - np.hypot(u[3], inside)
            return np.array([*left, edge])

        curvature = 2.0 * self.height_m / (a**2 + self.height_m**2) + 1.0 / ball_radius_m
        unknown = np.array([rest.stretches[0, 0], 0.0, self.gauge_pressure_pa, 0.0])
        before, depth, step, taken = unknown, 0.0, min(depth_m, 1e-3), 0.0
        while depth < depth_m:
            way = min(step, depth_m - depth)
            guess = unknown + (way / taken if depth > taken else 0.0) * (unknown - before)
            if depth == 0.0:
                guess[1] = 0.7 * np.sqrt(2.0 * way / curvature) / span
            try:
                found = _root(partial(missed, depth + way), guess, f"{depth + way:.4g} m of depth")
            except SolveError:
                step *= 0.5
                if step < 1e-5:
                    raise
                continue
            before, unknown, depth, taken, step = unknown, found, depth + way, way, 2.0 * way
        stretch, share, gauge, kink = unknown
        edge = share * span
        meridian = self._meridian(
            stretch, self.height_m - depth_m, gauge, ball_radius_m, edge, kink
        )
        radius = float(np.interp(edge, meridian.s_m, meridian.r_m))
        tension = float(np.interp(edge, meridian.s_m, meridian.tensions_n_per_m[:, 0]))
        upward = sin(asin(radius / ball_radius_m) + kink)
        force = np.pi * radius**2 * gauge + 2.0 * np.pi * radius * tension * upward
        return RubberPress(meridian, radius, gauge - self.gauge_pressure_pa, force)

    def _reference(self, s: float) -> tuple[float, float]:
        """Radius at arc length s of the sheet or dome before it deforms, and its slope."""
        if self.dome_height_m is None:
            return s, 1.0
        R = (self.rim_radius_m**2 + self.dome_height_m**2) / (2.0 * self.dome_height_m)
        return R * sin(s / R), cos(s / R)

    @property
    def _span(self) -> float:
        if self.dome_height_m is None:
            return self.rim_radius_m
        R = (self.rim_radius_m**2 + self.dome_height_m**2) / (2.0 * self.dome_height_m)
        return R * acos(1.0 - self.dome_height_m / R)

    def _tensions(self, l1: Any, l2: Any) -> tuple[Any, Any]:
        closed = (l1 * l2) ** -3
        return self.mu_h_n_per_m * (l1 / l2 - closed), self.mu_h_n_per_m * (l2 / l1 - closed)

    def _meridian(
        self,
        apex_stretch: float,
        apex_z: float,
        pressure: float,
        ball: float,
        contact_s: float,
        kink: float = 0.0,
        points: int = 101,
    ) -> Meridian:
        """Integrate from the apex, on the object up to `contact_s` and free from there.

        There its slope changes by `kink`, rad, at the edge of the object. Of each of the two parts
        so many points are returned, from its begin to its end.
        """
        lam, mu_h = self.prestretch, self.mu_h_n_per_m

        def slopes(s: float, y: np.ndarray, touching: bool) -> list[float]:
            r, _z, psi, l1, _v = y.tolist()  # Python floats are much faster than array elements
            r0, dr0 = self._reference(s)
            l2 = lam * r / r0
            t1, t2 = self._tensions(l1, l2)
            ds = l1 / lam
            sine, cosine = sin(psi), cos(psi)
            dr = ds * cosine
            dl2 = lam * (dr * r0 - r * dr0) / r0**2
            by_l1 = mu_h * (1.0 / l2 + 3.0 / (l1**4 * l2**3))
            by_l2 = mu_h * (-l1 / l2**2 + 3.0 / (l1**3 * l2**4))
            dl1 = (ds * (t2 - t1) * cosine / r - by_l2 * dl2) / by_l1
            dpsi = -dr / (ball * cosine) if touching else ds * (pressure - t2 * sine / r) / t1
            return [dr, -ds * sine, dpsi, dl1, pi * r**2 * ds * sine]

        start = _START * self._span
        r = apex_stretch / lam * start
        t = self._tensions(apex_stretch, apex_stretch)[0]
        touching = contact_s > start
        psi = -r / ball if touching else 0.5 * pressure * r / t
        y = np.array([r, apex_z, psi, apex_stretch, 0.0])
        pieces = [(start, contact_s, True)] if touching else []
        pieces.append((max(contact_s, start), self._span, False))
        # compiled: its steps take less time than `slopes`
        solver = ode(slopes).set_integrator("dop853", rtol=1e-9, atol=1e-11, nsteps=2000)
        s_all, y_all = [], []
        for begin, end, on_object in pieces:
            solver.set_initial_value(y, begin).set_f_params(on_object)
            at = np.linspace(begin, end, points)
            found = np.array([y, *(solver.integrate(s) for s in at[1:])])
            if not solver.successful():
                raise SolveError("rubber oracle: the integration failed")
            y = found[-1] - ([0.0, 0.0, kink, 0.0, 0.0] if on_object else 0.0)
            s_all.append(at)
            y_all.append(found)
        s, (r, z, _, l1, v) = np.concatenate(s_all), np.concatenate(y_all).T
        reference = np.array([self._reference(at)[0] for at in s])
        stretches = np.stack([l1, lam * r / reference], axis=1)
        tensions = np.stack(self._tensions(*stretches.T), axis=1)
        return Meridian(s, r, z, stretches, tensions, float(v[-1]))


def _root(missed: Callable[[np.ndarray], np.ndarray], guess: np.ndarray, what: str) -> np.ndarray:
    scale = np.where(guess == 0.0, 1.0, np.maximum(np.abs(guess), 1e-6))

    def scaled(unknown: np.ndarray) -> np.ndarray:
        return missed(unknown * scale)

    try:
        with np.errstate(all="ignore"), catch_warnings(action="ignore"):  # of impossible guesses
            found = root(scaled, guess / scale, tol=1e-8).x
            left = float(np.abs(scaled(found)).max())
    except (ArithmeticError, ValueError, SolveError):
        left = np.inf
    if not left < 1e-6:
        raise SolveError(f"rubber oracle: no equilibrium found at {what}")
    return np.asarray(found * scale)
