"""Robust orthogonal fits of a sphere and of an ellipsoid to a cloud of membrane points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from bubbleviz.calibration.robust import robust_sigma, tukey_weights
from bubbleviz.errors import InputError

_MAX_POINTS = 5_000  # parameters by the handful: more correlated points only cost time
_ROUNDS = 20


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
        local = (points - self.centre_m) @ self.axes
        scaled = local / self.semi_axes_m
        radius = np.linalg.norm(scaled, axis=1)
        gradient = np.linalg.norm(scaled / self.semi_axes_m, axis=1)
        return (radius - 1.0) * radius / np.maximum(gradient, np.finfo(float).tiny)

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
    inliers : float
        Share of the points the fit kept (weight above 0).
    """

    ellipsoid: Ellipsoid
    rms_m: float
    sigma_m: float
    inliers: float


def fit_sphere(points: np.ndarray) -> SurfaceFit:
    """Sphere through points (k, 3) in m, with outliers down-weighted to nothing."""
    points = _thinned(points)
    centre, radius = _algebraic_sphere(points)

    def surface(p: np.ndarray) -> Ellipsoid:
        return Ellipsoid(p[:3], np.full(3, p[3]), np.eye(3))

    return _fit(points, surface, np.append(centre, radius), "sphere")


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
    points = _thinned(points)
    start = fit_sphere(points).ellipsoid
    first = np.concatenate([start.centre_m, start.semi_axes_m])
    frame = np.eye(3) if axes is None else axes

    def aligned(p: np.ndarray) -> Ellipsoid:
        return Ellipsoid(p[:3], np.abs(p[3:6]), frame)

    def tilted(p: np.ndarray) -> Ellipsoid:
        return Ellipsoid(p[:3], np.abs(p[3:6]), Rotation.from_rotvec(p[6:9]).as_matrix())

    fit = _fit(points, aligned, first, "ellipsoid")
    if axes is not None:
        return fit
    known = np.concatenate([fit.ellipsoid.centre_m, fit.ellipsoid.semi_axes_m, np.zeros(3)])
    return _fit(points, tilted, known, "ellipsoid")


def _fit(
    points: np.ndarray,
    surface: Callable[[np.ndarray], Ellipsoid],
    start: np.ndarray,
    name: str,
) -> SurfaceFit:
    """Reweighted Gauss–Newton: Cauchy's loss to get near, Tukey's biweight to finish."""
    parameters = start

    def residual(p: np.ndarray) -> np.ndarray:
        return surface(p).distance(points)

    weights = np.ones(len(points))
    for k in range(_ROUNDS):
        now = residual(parameters)
        sigma = max(robust_sigma(now, center=0.0), 1e-9)
        weights = tukey_weights(now, sigma)
        if k == 0:
            found = least_squares(residual, parameters, loss="cauchy", f_scale=sigma, x_scale="jac")
        else:
            found = least_squares(_weighted(residual, np.sqrt(weights)), parameters, x_scale="jac")
        moved = float(np.abs(found.x - parameters).max())
        parameters = found.x
        if moved < 1e-6:  # a micrometre, or a microradian
            break
    ellipsoid = surface(parameters)
    size = float(np.ptp(points, axis=0).max())
    if not np.isfinite(parameters).all() or ellipsoid.semi_axes_m.max() > 20.0 * size:
        raise InputError(
            f"contact-free cloud: no {name} fits it (flat, or not a dome); check that the"
            " membrane is inflated and the depth is in metres"
        )
    now = residual(parameters)
    kept = weights > 0.0
    return SurfaceFit(
        ellipsoid=ellipsoid,
        rms_m=float(np.sqrt(np.mean(now[kept] ** 2))),
        sigma_m=robust_sigma(now, center=0.0),
        inliers=float(kept.mean()),
    )


def _weighted(
    residual: Callable[[np.ndarray], np.ndarray], root: np.ndarray
) -> Callable[[np.ndarray], np.ndarray]:
    def weighted(p: np.ndarray) -> np.ndarray:
        return root * residual(p)

    return weighted


def _thinned(points: np.ndarray) -> np.ndarray:
    points = np.asarray(points, float).reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < 20:
        raise InputError(
            f"contact-free cloud: only {len(points)} points; check that the camera sees the"
            " membrane"
        )
    return points[:: max(1, len(points) // _MAX_POINTS)]


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
