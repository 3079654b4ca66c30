"""The reference surface: spherical cap, ellipsoidal cap or free form, by cross-validation.

The rim belongs to the housing: its plane is the one of the given sensor's camera pose (from the
drawing), in which only the centre is moved to the fitted dome's. What the cloud's edge says
about its height is reported beside it.

A surface is better than a simpler one when it predicts tiles of pixels that took no part in its
fit better: by more than three standard errors of the difference over the tiles, and by more than
the flat facets of a membrane mesh miss any curved surface by.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from bubbleviz.calibration.errors import tile_numbers, tile_side
from bubbleviz.calibration.free_form import FOLDS, FreeForm, fit_free_form, fold_of, range_residual
from bubbleviz.calibration.rest_frames import Samples
from bubbleviz.calibration.segmentation import (
    away_from_edges,
    membrane_pixels,
    outer_edge,
    rim_height,
)
from bubbleviz.camera import DepthCamera, facet_error
from bubbleviz.errors import InputError
from bubbleviz.membrane import EllipsoidalCap, MembraneMesh, mesh_cap
from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import robust_sigma, tukey_loss, tukey_weights

# Robust orthogonal fits of a sphere and of an ellipsoid to a cloud of membrane points.


Loss = Callable[[np.ndarray], np.ndarray]

Freedom = Literal["sphere", "aligned", "tilted"]
"""Centre and one radius; centre and three semi-axes; and their directions too."""

_SEARCH_POINTS = 5_000  # to get near; all of them finish
_CLOSE = 1e-6  # relative change of the loss that ends a fit: of 10⁴ points, far below their noise


@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid; a sphere is one with equal semi-axes."""

    centre_m: np.ndarray  # (3,), m, in the frame of the points
    semi_axes_m: np.ndarray  # (3,), m, along the columns of `axes`
    axes: np.ndarray  # (3, 3), rotation whose columns are the directions of the semi-axes
    # root mean square orthogonal distance of the points that its fit kept, m
    rms_m: float = np.nan

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


def fit_sphere(points: np.ndarray) -> Ellipsoid:
    """Sphere through points (k, 3) in m, with outliers down-weighted to nothing."""
    points = _known(points)
    centre, radius = _algebraic_sphere(_thinned(points))
    return _fit(points, Ellipsoid(centre, np.full(3, radius), np.eye(3)), "sphere")


def fit_ellipsoid(
    points: np.ndarray,  # (k, 3), m
    # (3, 3), rotation whose columns the semi-axes shall follow. Where it is not given the tilt is
    # fitted too; a cap that shows less than half of the ellipsoid leaves it loose by degrees.
    axes: np.ndarray | None = None,
) -> Ellipsoid:
    """Ellipsoid through points (k, 3) in m, with outliers down-weighted to nothing.

    Raises InputError: too few points, or no ellipsoid explains them (a flat membrane, depth in a
    wrong unit).
    """
    points = _known(points)
    sphere = fit_sphere(_thinned(points))
    frame = np.eye(3) if axes is None else axes
    aligned = _fit(points, Ellipsoid(sphere.centre_m, sphere.semi_axes_m, frame), "aligned")
    return aligned if axes is not None else _fit(points, aligned, "tilted")


def _fit(points: np.ndarray, start: Ellipsoid, freedom: Freedom) -> Ellipsoid:
    """Robust least squares: Cauchy's loss to get near, Tukey's to finish, at its own scale."""
    few = _thinned(points)
    surface = start
    for loss in ("cauchy", tukey_loss, tukey_loss):
        surface = _descend(few, surface, freedom, loss)
    size = float(np.ptp(few, axis=0).max())
    if surface.semi_axes_m.max() > 20.0 * size:
        raise InputError(
            "contact-free cloud: no dome fits it (flat, or hollow); check that the"
            " membrane is inflated and the depth is in metres"
        )
    if len(points) > len(few):
        surface = _descend(points, surface, freedom, tukey_loss)
    now = surface.distance(points)
    kept = tukey_weights(now, robust_sigma(now, center=0.0)) > 0.0
    return replace(surface, rms_m=float(np.sqrt(np.mean(now[kept] ** 2))) if kept.any() else 0.0)


def _descend(
    points: np.ndarray, start: Ellipsoid, freedom: Freedom, loss: Literal["cauchy"] | Loss
) -> Ellipsoid:
    """Least of a loss whose scale is that of the distances at the start."""
    sigma = max(robust_sigma(start.distance(points), center=0.0), 1e-9)
    count = start.derivatives(points[:1], freedom).shape[1]

    def distances(step: np.ndarray) -> np.ndarray:
        return start.moved(step, freedom).distance(points) / sigma

    def slopes(step: np.ndarray) -> np.ndarray:
        return start.moved(step, freedom).derivatives(points, freedom) / sigma

    step = least_squares(
        distances,
        np.zeros(count),
        slopes,
        x_scale=np.r_[np.full(min(count, 6), start.semi_axes_m.max()), np.ones(max(count - 6, 0))],
        ftol=_CLOSE,
        loss=loss,  # type: ignore[arg-type]  # the stub's protocol names its argument
    ).x
    return start.moved(step, freedom)


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


Name = Literal["sphere", "ellipsoid", "free-form"]
NAMES: tuple[Name, ...] = ("sphere", "ellipsoid", "free-form")
"""From the simplest to the one that can be anything."""

_SCALE = 0.5  # of the rim's smaller semi-axis: what is broader is the cap's business
_STANDARD_ERRORS = 3.0  # a needless freedom costs more than a missed one


@dataclass(frozen=True)
class Fits:
    """The analytic surfaces, in the frame B of the identified sensor."""

    # sphere, cap, ellipsoid: sphere; ellipsoid with semi-axes along B; ellipsoid with its tilt free
    sphere: Ellipsoid
    cap: Ellipsoid
    ellipsoid: Ellipsoid
    # rim_height_m, rim_height_sigma_m: height of the rim above z = 0 by the cloud's edge, and its
    # uncertainty, m
    rim_height_m: float
    rim_height_sigma_m: float


@dataclass(frozen=True)
class Surfaces:
    """All surfaces fitted, and the one chosen."""

    fits: Fits
    free_form: FreeForm
    camera: DepthCamera  # in B, whose origin lies below the chosen surface's centre
    # membrane, usable: (H, W) bool, pixels that see the membrane; those far enough from its edges
    # to be fitted
    membrane: np.ndarray
    usable: np.ndarray
    # rms of what each surface misses tiles by that its fit left out, m
    left_out_rms_m: dict[Name, float]
    chosen: Name
    mesh: MembraneMesh  # of the chosen surface, in B
    # (H, W), measured minus cast range on that mesh, m; NaN where either lacks
    residual_m: np.ndarray

    @property
    def facet_error_m(self) -> float:
        """Typical distance of the mesh's flat facets from the surface, m."""
        return facet_error(self.mesh)

    @property
    def other_mesh(self) -> MembraneMesh:
        """The mesh moved onto another surface, in B: what differs on it is as uncertain as that."""
        if self.chosen == "ellipsoid":
            return self.free_form.mesh
        cap, arms = self.fits.cap, self.mesh.nodes
        a, b = arms @ cap.axes / cap.semi_axes_m, -cap.centre_m @ cap.axes / cap.semi_axes_m
        square, half, rest = np.sum(a * a, axis=1), a @ b, b @ b - 1.0
        length = (-half + np.sqrt(half**2 - square * rest)) / square  # |a t + b| = 1
        return replace(self.mesh, nodes=length[:, None] * arms)


def fit_surfaces(
    samples: Samples,
    nodes: int,  # target number of nodes of the mesh
    force: Name | None = None,  # the operator's choice, in place of the data's
    progress: Progress = quiet,
) -> Surfaces:
    """Fit all surfaces to the mean of contact-free frames and choose one.

    Raises InputError: no dome in the cloud, or it does not reach the rim plane.
    """
    progress("fitting caps", 0.0)
    statistics = samples.statistics
    membrane, usable = segment_membrane(samples)
    fits, camera = _fit_caps(samples, membrane, usable)
    start = mesh_cap(cap_over_rim(fits.cap), nodes)
    side = tile_side(int(usable.sum()), statistics.correlation_length_px)
    free_form = fit_free_form(
        start,
        camera,
        statistics.range_m,
        usable,
        scale_m=_SCALE * float(np.abs(start.nodes[start.rim, :2]).max(axis=0).min()),
        tile_px=side,
        progress=progress,
    )
    squares = _left_out_squares(samples, fits, camera, free_form, side)
    chosen = force or _choose(squares, facet_error(start))
    mesh, residual = free_form.mesh, free_form.residual_m
    if chosen != "free-form":
        centred = fits.sphere if chosen == "sphere" else fits.cap
        fits, camera = _centred(fits, camera, centred)
        own = fits.sphere if chosen == "sphere" else fits.cap
        mesh = mesh_cap(cap_over_rim(own), nodes)
        residual = range_residual(mesh, camera, statistics.range_m)
    return Surfaces(
        fits=fits,
        free_form=free_form,
        camera=camera,
        membrane=membrane,
        usable=usable,
        left_out_rms_m={name: float(np.sqrt(each.mean())) for name, each in squares.items()},
        chosen=chosen,
        mesh=mesh,
        residual_m=residual,
    )


def mean_points(samples: Samples, camera: DepthCamera, pixels: np.ndarray) -> np.ndarray:
    """Points in B of the mean range at flat pixel indices (k,), shape (k, 3), m."""
    ranges = samples.statistics.range_m.ravel()[pixels]
    return camera.center + ranges[:, None] * camera.directions[pixels]


def segment_membrane(samples: Samples) -> tuple[np.ndarray, np.ndarray]:
    """Pixels that see the membrane, and those of them far enough from its edges, (H, W) bool."""
    known = samples.statistics.validity >= samples.statistics.regular_validity
    pixels = np.flatnonzero(known)
    points = mean_points(samples, samples.camera, pixels)
    rough = fit_ellipsoid(points[:: max(1, len(points) // 20_000)], np.eye(3))
    distance = np.full(known.shape, np.nan)
    distance[known] = rough.distance(points)
    membrane = membrane_pixels(distance, known)
    return membrane, away_from_edges(membrane, samples.statistics.correlation_length_px)


def cap_over_rim(ellipsoid: Ellipsoid) -> EllipsoidalCap:
    """The part of a fitted ellipsoid above the rim plane z = 0."""
    ax, ay, c = (float(x) for x in ellipsoid.semi_axes_m)
    sunk = float(ellipsoid.centre_m[2]) / c
    if not -1.0 < sunk < 1.0:
        raise InputError(
            "contact-free cloud: the fitted dome does not reach the rim plane z = 0; correct"
            " camera.position_m in the sensor file"
        )
    at_rim = float(np.sqrt(1.0 - sunk**2))
    return EllipsoidalCap.of((ax * at_rim, ay * at_rim), c * (1.0 + sunk), c)


def mesh_ellipsoid(ellipsoid: Ellipsoid, nodes: int) -> MembraneMesh:
    """Mesh of the part of a fitted ellipsoid above the rim plane, where it lies in B."""
    mesh = mesh_cap(cap_over_rim(ellipsoid), nodes)
    return replace(mesh, nodes=mesh.nodes + ellipsoid.centre_m * (1.0, 1.0, 0.0))


def _fit_caps(
    samples: Samples, membrane: np.ndarray, usable: np.ndarray
) -> tuple[Fits, DepthCamera]:
    """Analytic surfaces, and the camera in B with its origin below the fitted cap's centre."""
    given = samples.camera
    points = mean_points(samples, given, np.flatnonzero(usable))
    edge = mean_points(samples, given, np.flatnonzero(outer_edge(membrane)))
    height, sigma = rim_height(edge[:, 2])
    fits = Fits(
        sphere=fit_sphere(points),
        cap=fit_ellipsoid(points, np.eye(3)),
        ellipsoid=fit_ellipsoid(points),
        rim_height_m=height,
        rim_height_sigma_m=sigma,
    )
    return _centred(fits, given, fits.cap)


def _centred(fits: Fits, camera: DepthCamera, on: Ellipsoid) -> tuple[Fits, DepthCamera]:
    """Fits and camera in a frame moved sideways so that its z axis runs through a centre."""
    shift = on.centre_m * (1.0, 1.0, 0.0)
    T_B_C = camera.T_B_C.copy()
    T_B_C[:3, 3] -= shift

    def moved(fit: Ellipsoid) -> Ellipsoid:
        return replace(fit, centre_m=fit.centre_m - shift)

    fits = replace(
        fits, sphere=moved(fits.sphere), cap=moved(fits.cap), ellipsoid=moved(fits.ellipsoid)
    )
    return fits, DepthCamera(camera.intrinsics, T_B_C)


def _left_out_squares(
    samples: Samples, fits: Fits, camera: DepthCamera, free_form: FreeForm, side: int
) -> dict[Name, np.ndarray]:
    """Mean squared distance from tiles that a fit left out, (T,), m², for every surface.

    All with the same weights: those of the samples about the surface that can be anything.
    """
    pixels = np.flatnonzero(np.isfinite(free_form.left_out_m).ravel())
    points = mean_points(samples, camera, pixels)
    width = samples.camera.intrinsics.width
    tile, fold = tile_numbers(pixels, width, side), fold_of(pixels, width, side)
    facing = np.einsum("ij,ij->i", fits.cap.normals(points), camera.directions[pixels])
    missed = free_form.left_out_m.ravel()[pixels] * np.abs(facing)
    weights = tukey_weights(missed - np.median(missed), robust_sigma(missed))
    errors = {
        "sphere": _left_out_cap(fits.sphere, "sphere", points, weights, fold),
        "ellipsoid": _left_out_cap(fits.cap, "aligned", points, weights, fold),
        "free-form": missed,
    }
    total = np.maximum(np.bincount(tile, weights), 1e-9)
    counted = np.bincount(tile, weights > 0.0) > 0
    return {
        name: (np.bincount(tile, weights * errors[name] ** 2) / total)[counted] for name in NAMES
    }


def _left_out_cap(
    surface: Ellipsoid, freedom: Freedom, points: np.ndarray, weights: np.ndarray, fold: np.ndarray
) -> np.ndarray:
    """Distances of points (k,) from the cap fitted without their fold (one step away), m."""
    J, now = surface.derivatives(points, freedom), surface.distance(points)
    weighted = J * weights[:, None]
    matrix, right = weighted.T @ J, weighted.T @ now
    missed = np.empty(len(points))
    for k in range(FOLDS):
        own = fold == k
        rest = matrix - weighted[own].T @ J[own]
        step = -np.linalg.lstsq(rest, right - weighted[own].T @ now[own], rcond=1e-14)[0]
        missed[own] = now[own] + J[own] @ step
    return missed


def _choose(squares: dict[Name, np.ndarray], facet_error_m: float) -> Name:
    """The simplest surface that no other one beats."""
    chosen: Name = "sphere"
    for name in NAMES[1:]:
        gain = squares[chosen] - squares[name]
        error = float(gain.std(ddof=1)) / np.sqrt(len(gain)) if len(gain) > 1 else np.inf
        if gain.mean() > max(_STANDARD_ERRORS * error, facet_error_m**2):
            chosen = name
    return chosen
