"""Robust orthogonal fits of a sphere and of an ellipsoid to a cloud of membrane points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from bubbleviz.calibration.robust_statistics import cauchy_weights, robust_sigma, tukey_weights
from bubbleviz.errors import InputError

Weights = Callable[[np.ndarray, float], np.ndarray]

Freedom = Literal["sphere", "aligned", "tilted"]
"""Centre and one radius; centre and three semi-axes; and their directions too."""

_SEARCH_POINTS = 5_000  # to get near; all of them finish
_SMALL = 1e-7  # m, or rad: a step that ends the iteration


@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid; a sphere is one with equal semi-axes.

    Attributes
    ----------
    centre_m : (3,) array
        m, in the frame of the points.
    semi_axes_m : (3,) array
        m, along the columns of `axes`.
    axes : (3, 3) array
        Rotation whose columns are the directions of the semi-axes.
    """

    centre_m: np.ndarray
    semi_axes_m: np.ndarray
    axes: np.ndarray

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Signed orthogonal distance of points (k, 3), positive outside, m; shape (k,).

        To first order in distance over radius of curvature, far below the noise for the
        millimetre or so by which a membrane differs from an ellipsoid.
        """
        scaled = (points - self.centre_m) @ self.axes / self.semi_axes_m
        radius, slope = self._radius_and_slope(scaled)
        return (radius - 1.0) * radius / slope

    def normals(self, points: np.ndarray) -> np.ndarray:
        """Unit outward normals of the family of similar ellipsoids at points; (k, 3)."""
        scaled = (points - self.centre_m) @ self.axes / self.semi_axes_m
        gradient = scaled / self.semi_axes_m
        return gradient / np.linalg.norm(gradient, axis=1, keepdims=True) @ self.axes.T

    def derivatives(self, points: np.ndarray, freedom: Freedom) -> np.ndarray:
        """Derivatives of the distances with respect to what `freedom` lets move; (k, p).

        Columns: centre (3), radius (1) or semi-axes (3), turn about the semi-axes (3, rad).
        """
        local = (points - self.centre_m) @ self.axes
        scaled = local / self.semi_axes_m
        radius, slope = self._radius_and_slope(scaled)
        by_radius = ((2.0 * radius - 1.0) / slope / radius)[:, None]
        by_slope = ((radius**2 - radius) / slope**3)[:, None] / self.semi_axes_m**2
        gradient = (by_radius - by_slope) * scaled / self.semi_axes_m
        axes = (2.0 * by_slope - by_radius) * scaled**2 / self.semi_axes_m
        parts = [-gradient @ self.axes.T]
        parts.append(axes.sum(axis=1, keepdims=True) if freedom == "sphere" else axes)
        if freedom == "tilted":
            parts.append(np.cross(gradient, local))
        return np.concatenate(parts, axis=1)

    def moved(self, step: np.ndarray, freedom: Freedom) -> Ellipsoid:
        """Ellipsoid after a step (p,) in the parameters of `derivatives`."""
        axes = self.axes
        if freedom == "tilted":
            axes = axes @ Rotation.from_rotvec(step[6:9]).as_matrix()
        sizes = np.abs(self.semi_axes_m + step[3 : 4 if freedom == "sphere" else 6])
        return Ellipsoid(self.centre_m + step[:3], sizes, axes)

    def _radius_and_slope(self, scaled: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """|x/a| (1 on the surface) and |x/a²| in 1/m of points already divided by a; (k,) each."""
        tiny = np.finfo(float).tiny
        radius = np.sqrt(np.einsum("ij,ij->i", scaled, scaled))
        gradient = scaled / self.semi_axes_m
        slope = np.sqrt(np.einsum("ij,ij->i", gradient, gradient))
        return np.maximum(radius, tiny), np.maximum(slope, tiny)

    @property
    def tilt_rad(self) -> float:
        """Angle between the frame's z axis and the semi-axis nearest to it, rad."""
        return float(np.arccos(min(1.0, np.abs(self.axes[2]).max())))


@dataclass(frozen=True)
class SurfaceFit:
    """A fitted surface and how well it explains the points.

    Attributes
    ----------
    ellipsoid : Ellipsoid
    rms_m : float
        Root mean square orthogonal distance of the points the fit kept, m.
    sigma_m : float
        The same from the median absolute distance of all points, m.
    """

    ellipsoid: Ellipsoid
    rms_m: float
    sigma_m: float


def fit_sphere(points: np.ndarray) -> SurfaceFit:
    """Sphere through points (k, 3) in m, with outliers down-weighted to nothing."""
    points = _known(points)
    centre, radius = _algebraic_sphere(_thinned(points))
    return _fit(points, Ellipsoid(centre, np.full(3, radius), np.eye(3)), "sphere")


def fit_ellipsoid(points: np.ndarray, axes: np.ndarray | None = None) -> SurfaceFit:
    """Ellipsoid through points (k, 3) in m, with outliers down-weighted to nothing.

    Parameters
    ----------
    points : (k, 3) array
        m.
    axes : (3, 3) array, optional
        Rotation whose columns the semi-axes shall follow. Where it is not given the tilt is
        fitted too; a cap that shows less than half of the ellipsoid leaves it loose by degrees.

    Raises
    ------
    InputError
        Too few points, or no ellipsoid explains them (a flat membrane, depth in a wrong unit).
    """
    points = _known(points)
    sphere = fit_sphere(_thinned(points)).ellipsoid
    frame = np.eye(3) if axes is None else axes
    aligned = _fit(points, Ellipsoid(sphere.centre_m, sphere.semi_axes_m, frame), "aligned")
    return aligned if axes is not None else _fit(points, aligned.ellipsoid, "tilted")


def _fit(points: np.ndarray, start: Ellipsoid, freedom: Freedom) -> SurfaceFit:
    """Reweighted Gauss–Newton: Cauchy's loss to get near, Tukey's biweight to finish."""
    few = _thinned(points)
    surface = _search(few, start, freedom)
    size = float(np.ptp(few, axis=0).max())
    numbers = np.concatenate([surface.centre_m, surface.semi_axes_m])
    if not np.isfinite(numbers).all() or surface.semi_axes_m.max() > 20.0 * size:
        raise InputError(
            "contact-free cloud: no dome fits it (flat, or hollow); check that the"
            " membrane is inflated and the depth is in metres"
        )
    if len(points) > len(few):
        surface = _descend(points, surface, freedom, tukey_weights, rounds=2)
    now = surface.distance(points)
    sigma = robust_sigma(now, center=0.0)
    kept = tukey_weights(now, sigma) > 0.0
    return SurfaceFit(
        ellipsoid=surface,
        rms_m=float(np.sqrt(np.mean(now[kept] ** 2))) if kept.any() else 0.0,
        sigma_m=sigma,
    )


def _search(points: np.ndarray, surface: Ellipsoid, freedom: Freedom) -> Ellipsoid:
    """Cauchy's loss at the start's scale, then Tukey's at the scale it leads to, twice."""
    surface = _descend(points, surface, freedom, cauchy_weights)
    for _ in range(2):
        surface = _descend(points, surface, freedom, tukey_weights)
    return surface


def _descend(
    points: np.ndarray, surface: Ellipsoid, freedom: Freedom, loss: Weights, rounds: int = 25
) -> Ellipsoid:
    """Levenberg–Marquardt minimisation of a loss of fixed scale."""
    now = surface.distance(points)
    sigma = max(robust_sigma(now, center=0.0), 1e-9)
    damping = 1e-4
    for _ in range(rounds):
        weights = loss(now, sigma)
        step = _step(surface, points, weights, now, freedom, damping)
        trial = surface.moved(step, freedom)
        then = trial.distance(points)
        # Less under these weights is less of the loss, whose majorant they make.
        if np.sum(weights * then**2) <= np.sum(weights * now**2):
            surface, now, damping = trial, then, damping / 5.0
        else:
            damping *= 10.0
        if np.abs(step).max() < _SMALL:
            break
    return surface


def _step(
    surface: Ellipsoid,
    points: np.ndarray,
    weights: np.ndarray,
    distance: np.ndarray,
    freedom: Freedom,
    damping: float,
) -> np.ndarray:
    J = surface.derivatives(points, freedom)
    weighted = J * weights[:, None]
    normal = weighted.T @ J
    normal[np.diag_indices_from(normal)] *= 1.0 + damping
    return -np.linalg.lstsq(normal, weighted.T @ distance, rcond=1e-14)[0]


def _known(points: np.ndarray) -> np.ndarray:
    points = np.asarray(points, float).reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < 20:
        raise InputError(
            f"contact-free cloud: only {len(points)} points; check that the camera sees the"
            " membrane"
        )
    return points


def _thinned(points: np.ndarray) -> np.ndarray:
    return points[:: max(1, len(points) // _SEARCH_POINTS)]


def _algebraic_sphere(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Sphere of least squares in x² + y² + z² = 2 c·x + k, on the central half of the points."""
    middle = np.median(points, axis=0)
    far = np.linalg.norm(points - middle, axis=1)
    local = points[far <= np.quantile(far, 0.8)] - middle
    rows = np.column_stack([2.0 * local, np.ones(len(local))])
    solution = np.linalg.lstsq(rows, np.sum(local**2, axis=1), rcond=None)[0]
    centre = solution[:3]
    radius = float(np.sqrt(max(solution[3] + centre @ centre, 1e-12)))
    return middle + centre, radius
