"""Robust orthogonal fits of a sphere and of an ellipsoid to a cloud of membrane points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.errors import InputError
from bubbleviz.membrane import EllipsoidalCap
from bubbleviz.recordings import robust_sigma, tukey_weights

_LARGEST_STEP = 0.1  # of the smallest semi-axis: farther away the linearisation is of no use

_COARSE_POINTS = 5_000  # for all fits but the last, which uses every point
_STEPS, _TOLERANCE = 30, 1e-3  # the latter over σ, a tenth of the noise of 10⁴ points' mean


@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid with axes parallel to the frame's; a sphere has three equal semi-axes."""

    centre_m: np.ndarray  # (3,), m, in the frame of the points
    semi_axes_m: np.ndarray  # (3,), m

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Signed orthogonal distance of points (k, 3), positive outside, m; shape (k,).

        To first order in distance over radius of curvature. A membrane differs from an ellipsoid by
        a millimetre or so, for which the error of this approximation is far below the noise.
        """
        _, radius, slope = self._scaled(points)
        return (radius - 1.0) * radius / slope

    def normals(self, points: np.ndarray) -> np.ndarray:
        """Unit outward normals of the family of similar ellipsoids at points; (k, 3)."""
        gradient = self._scaled(points)[0] / self.semi_axes_m
        return gradient / np.linalg.norm(gradient, axis=1, keepdims=True)

    def derivatives(self, points: np.ndarray, *, sphere: bool) -> np.ndarray:
        """Derivatives of the distances by the centre and the radius (k, 4), or semi-axes (k, 6)."""
        scaled, radius, slope = self._scaled(points)
        by_radius = ((2.0 * radius - 1.0) / slope / radius)[:, None]
        by_slope = ((radius**2 - radius) / slope**3)[:, None] / self.semi_axes_m**2
        gradient = (by_radius - by_slope) * scaled / self.semi_axes_m
        axes = (2.0 * by_slope - by_radius) * scaled**2 / self.semi_axes_m
        sizes = axes.sum(axis=1, keepdims=True) if sphere else axes
        return np.concatenate([-gradient, sizes], axis=1)

    def moved(self, step: np.ndarray) -> Ellipsoid:
        """Ellipsoid after a step (4,) or (6,) in the parameters of `derivatives`."""
        return Ellipsoid(self.centre_m + step[:3], np.abs(self.semi_axes_m + step[3:]))

    @property
    def cap_above_rim(self) -> EllipsoidalCap:
        """The part above the rim plane z = 0. Raises InputError: it does not reach the plane."""
        ax, ay, c = (float(x) for x in self.semi_axes_m)
        centre_height = float(self.centre_m[2]) / c
        if not -1.0 < centre_height < 1.0:
            raise InputError(
                "contact-free depth: the fitted dome does not cross the rim plane z = 0; correct "
                "camera.position_m and camera.quaternion_xyzw in the sensor file, or give that of "
                "this camera"
            )
        at_rim = float(np.sqrt(1.0 - centre_height**2))
        return EllipsoidalCap.of((ax * at_rim, ay * at_rim), c * (1.0 + centre_height), c)

    def _scaled(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points divided by the semi-axes a, |x/a| (1 on the surface) and |x/a²| in 1/m."""
        scaled, tiny = (points - self.centre_m) / self.semi_axes_m, np.finfo(float).tiny
        radius, slope = (
            np.sqrt(np.einsum("ij,ij->i", each, each))
            for each in (scaled, scaled / self.semi_axes_m)
        )
        return scaled, np.maximum(radius, tiny), np.maximum(slope, tiny)


def fit_sphere(points: np.ndarray) -> Ellipsoid:
    """Robust fit of a sphere to points (k, 3) in m; outliers have no weight.

    Raises InputError: too few points, or no sphere fits them (a flat membrane, depth in a wrong
    unit).
    """
    if len(points) < 20:
        raise InputError(
            f"contact-free depth: only {len(points)} usable points on the membrane; uncover the "
            "camera, or check the depth images"
        )
    centre, radius = _algebraic_sphere(_subsample(points))
    return _fit(points, Ellipsoid(centre, np.full(3, radius)), sphere=True)


def fit_ellipsoid(points: np.ndarray, sphere: Ellipsoid | None = None) -> Ellipsoid:
    """Robust fit of an ellipsoid to points (k, 3) in m, from their sphere; outliers have no weight.

    Raises InputError: as `fit_sphere`.
    """
    return _fit(points, sphere or fit_sphere(_subsample(points)), sphere=False)


def _fit(points: np.ndarray, surface: Ellipsoid, *, sphere: bool) -> Ellipsoid:
    """Robust least squares, twice on few points and then on all, at the last fit's spread."""
    few = _subsample(points)
    for some in (few, few, points):
        surface = refitted(some, surface, sphere=sphere)
        if surface.semi_axes_m.max() > 20.0 * float(np.ptp(few, axis=0).max()):
            raise InputError(
                "contact-free depth: too flat, no dome fits; inflate the membrane, or choose frames"
                " in which nothing touches it"
            )
    return surface


def refitted(points: np.ndarray, surface: Ellipsoid, *, sphere: bool) -> Ellipsoid:
    """The surface fitted to other points (k, 3) nearby, as a sphere or with three semi-axes.

    By iteratively reweighted least squares at the spread of their distances from the start.
    """
    distance = surface.distance(points)
    sigma = max(robust_sigma(distance, center=0.0), 1e-9)
    for _ in range(_STEPS):
        J, weights = surface.derivatives(points, sphere=sphere), tukey_weights(distance, sigma)
        # by the pseudo-inverse, as a part of a dome may leave a semi-axis open
        normal, gradient = J.T * weights @ J, J.T @ (weights * distance)
        step = -np.linalg.lstsq(normal, gradient, rcond=None)[0]
        cut = _LARGEST_STEP * surface.semi_axes_m.min() / max(np.abs(step).max(), 1e-300)
        surface = surface.moved(min(1.0, cut) * step)
        if np.abs(J @ step).max() < _TOLERANCE * sigma:
            break
        distance = surface.distance(points)
    return surface


def _subsample(points: np.ndarray) -> np.ndarray:
    return points[:: max(1, len(points) // _COARSE_POINTS)]


def _algebraic_sphere(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Sphere by least squares of x² + y² + z² = 2 c·x + k, over the central 80 % of the points."""
    middle = np.median(points, axis=0)
    far = np.linalg.norm(points - middle, axis=1)
    local = points[far <= np.quantile(far, 0.8)] - middle
    rows = np.column_stack([2.0 * local, np.ones(len(local))])
    solution = np.linalg.lstsq(rows, np.sum(local**2, axis=1), rcond=None)[0]
    centre = solution[:3]
    radius = float(np.sqrt(max(solution[3] + centre @ centre, 1e-12)))
    return middle + centre, radius
