"""The reference surface: spherical cap, ellipsoidal cap or free form, by cross-validation.

The rim belongs to the housing: its plane is the one of the given sensor's camera pose (from the
drawing), in which only the centre is moved to the fitted dome's. What the cloud's edge says
about its height is reported beside it.

A surface is better than a simpler one when it predicts tiles of pixels that took no part in its
fit better: by more than three standard errors of the difference over the tiles, and by more than
the flat facets of a membrane mesh miss any curved surface by.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bubbleviz.calibration.rest.rest_frames import Samples
from bubbleviz.calibration.robust_statistics import robust_sigma, tukey_weights
from bubbleviz.calibration.surface.cap_fit import (
    Ellipsoid,
    Freedom,
    SurfaceFit,
    fit_ellipsoid,
    fit_sphere,
)
from bubbleviz.calibration.surface.free_form import (
    FOLDS,
    FreeForm,
    fit_free_form,
    fold_of,
    range_residual,
)
from bubbleviz.calibration.surface.rim_height import rim_height
from bubbleviz.calibration.surface.segmentation import away_from_edges, membrane_pixels, outer_edge
from bubbleviz.calibration.tension.bootstrap import tile_numbers, tile_side
from bubbleviz.camera.depth_camera import DepthCamera
from bubbleviz.camera.observer import facet_error
from bubbleviz.errors import InputError
from bubbleviz.membrane.cap_mesh import EllipsoidalCap, mesh_cap
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.progress import Progress, quiet

Name = Literal["sphere", "ellipsoid", "free-form"]
NAMES: tuple[Name, ...] = ("sphere", "ellipsoid", "free-form")
"""From the simplest to the one that can be anything."""

_SCALE = 0.5  # of the rim's smaller semi-axis: what is broader is the cap's business
_STANDARD_ERRORS = 3.0  # a needless freedom costs more than a missed one


@dataclass(frozen=True)
class Fits:
    """The analytic surfaces, in the frame B of the identified sensor.

    Attributes
    ----------
    sphere, cap, ellipsoid : SurfaceFit
        Sphere; ellipsoid with semi-axes along B; ellipsoid with its tilt free.
    rim_height_m, rim_height_sigma_m : float
        Height of the rim above z = 0 by the cloud's edge, and its uncertainty, m.
    """

    sphere: SurfaceFit
    cap: SurfaceFit
    ellipsoid: SurfaceFit
    rim_height_m: float
    rim_height_sigma_m: float


@dataclass(frozen=True)
class Surfaces:
    """All surfaces fitted, and the one chosen.

    Attributes
    ----------
    fits : Fits
    free_form : FreeForm
    camera : DepthCamera
        In B, whose origin lies below the chosen surface's centre.
    membrane, usable : (H, W) bool array
        Pixels that see the membrane; those far enough from its edges to be fitted.
    left_out_rms_m : dict of str to float
        Rms of what each surface misses tiles by that its fit left out, m.
    chosen : {"sphere", "ellipsoid", "free-form"}
    mesh : MembraneMesh
        Of the chosen surface, in B.
    residual_m : (H, W) array
        Measured minus cast range on that mesh, m; NaN where either lacks.
    """

    fits: Fits
    free_form: FreeForm
    camera: DepthCamera
    membrane: np.ndarray
    usable: np.ndarray
    left_out_rms_m: dict[Name, float]
    chosen: Name
    mesh: MembraneMesh
    residual_m: np.ndarray

    @property
    def facet_error_m(self) -> float:
        """Typical distance of the mesh's flat facets from the surface, m."""
        return facet_error(self.mesh)

    @property
    def other_mesh(self) -> MembraneMesh:
        """Mesh of another surface, in B: what differs on it is as uncertain as the shape."""
        if self.chosen == "ellipsoid":
            return self.free_form.mesh
        return mesh_ellipsoid(self.fits.cap.ellipsoid, len(self.mesh.nodes))


def fit_surfaces(
    samples: Samples, nodes: int, force: Name | None = None, progress: Progress = quiet
) -> Surfaces:
    """Fit all surfaces to the mean of contact-free frames and choose one.

    Parameters
    ----------
    samples : Samples
    nodes : int
        Target number of nodes of the mesh.
    force : {"sphere", "ellipsoid", "free-form"}, optional
        The operator's choice, in place of the data's.

    Raises
    ------
    InputError
        No dome in the cloud, or it does not reach the rim plane.
    """
    progress("fitting caps", 0.0)
    statistics = samples.statistics
    membrane, usable = segment_membrane(samples)
    fits, camera = _fit_caps(samples, membrane, usable)
    start = mesh_cap(cap_over_rim(fits.cap.ellipsoid), nodes)
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
        fits, camera = _centred(fits, camera, centred.ellipsoid)
        own = fits.sphere if chosen == "sphere" else fits.cap
        mesh = mesh_cap(cap_over_rim(own.ellipsoid), nodes)
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
    rough = fit_ellipsoid(points[:: max(1, len(points) // 20_000)], np.eye(3)).ellipsoid
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
    return _centred(fits, given, fits.cap.ellipsoid)


def _centred(fits: Fits, camera: DepthCamera, on: Ellipsoid) -> tuple[Fits, DepthCamera]:
    """Fits and camera in a frame moved sideways so that its z axis runs through a centre."""
    shift = on.centre_m * (1.0, 1.0, 0.0)
    T_B_C = camera.T_B_C.copy()
    T_B_C[:3, 3] -= shift

    def moved(fit: SurfaceFit) -> SurfaceFit:
        centre = fit.ellipsoid.centre_m - shift
        return replace(fit, ellipsoid=replace(fit.ellipsoid, centre_m=centre))

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
    facing = np.einsum("ij,ij->i", fits.cap.ellipsoid.normals(points), camera.directions[pixels])
    missed = free_form.left_out_m.ravel()[pixels] * np.abs(facing)
    weights = tukey_weights(missed - np.median(missed), robust_sigma(missed))
    errors = {
        "sphere": _left_out_cap(fits.sphere.ellipsoid, "sphere", points, weights, fold),
        "ellipsoid": _left_out_cap(fits.cap.ellipsoid, "aligned", points, weights, fold),
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
