"""The reference surface: spherical cap, ellipsoidal cap or free form, by cross-validation.

The rim plane is that of the given sensor's camera pose (from the design drawing); only its centre
moves to that of the fitted dome. The height of the cloud's edge above it is reported, too.

A surface is better than a simpler one when its error on tiles of pixels left out of the fit is
smaller by more than three standard errors, and by more than the error of the flat facets of a mesh.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy import sparse

from bubbleviz.calibration.dome_checks import check_dome, check_motion
from bubbleviz.calibration.ellipsoid import Ellipsoid, fit_ellipsoid, fit_sphere, refitted
from bubbleviz.calibration.fit_errors import tile_numbers, tile_side
from bubbleviz.calibration.free_form import FreeForm, fit_free_form, fold_of, left_out_errors
from bubbleviz.calibration.rest_frames import (
    FrameSamples,
    away_from_edges,
    membrane_pixels,
    outer_edge,
)
from bubbleviz.calibration.rim import RimPlane, lateral_scale, rim_height, rim_plane
from bubbleviz.camera import DepthCamera, MembraneView, facet_error
from bubbleviz.membrane import (
    MembraneMesh,
    Prestress,
    as_flat_sheet,
    balance_tension,
    mesh_cap,
)
from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import robust_sigma, tukey_weights
from bubbleviz.result import HALF_95
from bubbleviz.wording import decimals_of, rounded

SurfaceName = Literal["sphere", "ellipsoid", "free-form"]
SURFACE_NAMES: tuple[SurfaceName, ...] = ("sphere", "ellipsoid", "free-form")
"""From the simplest to the most general."""

NOT_YET: Any = None  # value of a result whose step was not done
_SCALE = 0.5  # of the rim's smaller semi-axis: the cap alone fits broader shapes
_STANDARD_ERRORS = 3.0  # strict, as overfitting costs more than a surface that is too simple
_PIXELS_A_NODE = 40
"""Pixels fitted per node; larger images are thinned by rows and columns. The error of γ0 due to
their noise is then still at most an eighth of the error due to hidden and unresolved shape (real
press, simulated domes with white noise of 0.1 mm)."""


@dataclass(frozen=True)
class Surfaces:
    """All surfaces fitted, and the one chosen."""

    # in the frame B of the identified sensor
    sphere: Ellipsoid
    cap: Ellipsoid
    free_form: FreeForm
    # height of the cloud's edge above the rim plane z = 0, and its uncertainty, m
    rim_height_m: float
    rim_height_sigma_m: float
    rim_plane: RimPlane | None  # through that edge, if it lies in a plane
    # `fx` and `fy`, pixels, at which that edge has the size of the sensor file's rim; or empty
    focal_by_rim_px: dict[str, Quantity]
    camera: DepthCamera  # in B, whose origin lies below the chosen surface's centre
    # membrane, fitted: (H, W) bool, pixels that see the membrane, and those of them that were
    # fitted: far enough from its edges, and in every `stride`th row and column
    membrane: np.ndarray
    fitted: np.ndarray
    stride: int
    left_out_rms_m: dict[SurfaceName, float]  # rms error on tiles left out of the fit, m
    chosen: SurfaceName
    mesh: MembraneMesh  # of the chosen surface, in B
    # (H, W), measured minus cast range on that mesh, m; NaN where either is missing
    residual_m: np.ndarray
    visible_share: float  # of the dome's area
    motion_m: float  # largest motion of the dome between frames beyond noise, m
    # by `with_tension`: γ0 of the chosen surface under 1 Pa, m, with the error of the shape
    tension_m: Quantity = NOT_YET
    # standard deviation of it by each source of error: `frames` (motion of the dome), `facets` (of
    # the mesh), `surface` (noise and fixed pattern of the pixels, hidden or unresolved shape:
    # uncertainty of the free form, difference between free form and cap, and, where a cap was
    # chosen, between that and one fitted to the upper half alone) and `statics` (mean tension that
    # shape and pressure do not determine: between that of a soap film and that of an initially
    # flat sheet)
    tension_parts_m: dict[str, float] = NOT_YET
    tension_by_surface_m: dict[SurfaceName, float] = NOT_YET  # under 1 Pa, of every surface
    # `height_m`, and `radius_m` and `rim_radius_m` of a sphere or `semi_axis_x_m` … and
    # `rim_semi_axis_x_m` … of an ellipsoid, m
    dimensions: dict[str, Quantity] = NOT_YET
    # stress and excess of tension of an initially flat sheet, see `as_flat_sheet`
    flat_sheet: tuple[Prestress, float] | None = None
    unequal: dict[str, Prestress] = NOT_YET  # under 1 Pa, see `Prestress.unequal`

    @property
    def stress_sigma(self) -> float:
        """Relative standard deviation of a film's stress at a given gauge pressure, by its shape.

        The part of the stress that the shape does not determine is an unknown of the rubber's fit.
        """
        own = [part for name, part in self.tension_parts_m.items() if name != "statics"]
        return float(np.linalg.norm(own)) / self.tension_m.value

    @property
    def chosen_cap(self) -> Ellipsoid:
        """The sphere where it was chosen, else the ellipsoid."""
        return self.sphere if self.chosen == "sphere" else self.cap

    @property
    def other_mesh(self) -> MembraneMesh:
        """The mesh on another fitted surface, in B, to estimate the error by the surface."""
        if self.chosen == "ellipsoid":
            return self.free_form.mesh
        cap, arms = self.cap, self.mesh.nodes
        a, b = arms / cap.semi_axes_m, -cap.centre_m / cap.semi_axes_m
        square, half, rest = np.sum(a * a, axis=1), a @ b, b @ b - 1.0
        length = (-half + np.sqrt(half**2 - square * rest)) / square  # |a t + b| = 1
        return replace(self.mesh, nodes=length[:, None] * arms)


def fit_surfaces(
    samples: FrameSamples,
    nodes: int,  # target number of nodes of the mesh
    force: SurfaceName | None = None,  # use this surface; None: chosen by cross-validation
    progress: Progress = quiet,
) -> Surfaces:
    """Fit all surfaces to the mean of contact-free frames and choose one.

    Raises InputError: no dome in the cloud, or one that ends above the rim plane, moves, is pressed
    in, or is less than half visible.
    """
    progress("fitting caps", 0.0)
    statistics = samples.statistics
    motion_m = check_motion(samples)
    membrane, usable = segment_membrane(samples)
    given = samples.camera
    stride = max(1, int(np.sqrt(usable.sum() / (_PIXELS_A_NODE * nodes))))
    fitted = np.zeros_like(usable)
    fitted[::stride, ::stride] = usable[::stride, ::stride]
    points = given.points_at(statistics.range_m, np.flatnonzero(fitted))
    edge = given.points_at(statistics.range_m, np.flatnonzero(outer_edge(membrane)))
    sphere = fit_sphere(points)
    ellipsoid = fit_ellipsoid(points, sphere)
    caps, camera = _centred((sphere, ellipsoid), given, 1)
    start = mesh_cap(caps[1].cap_above_rim, nodes)
    side = tile_side(int(usable.sum()), statistics.correlation_length_px)
    free_form = fit_free_form(
        start,
        camera,
        statistics.range_m,
        fitted,
        scale_m=_SCALE * float(np.abs(start.nodes[start.rim, :2]).max(axis=0).min()),
        tile_px=side,
        progress=progress,
    )
    squares = _left_out_squares(samples, caps, camera, free_form, side)
    chosen = force or _choose(squares, facet_error(start))
    mesh = free_form.mesh if chosen == "free-form" else start
    if chosen == "sphere":
        caps, camera = _centred(caps, camera, 0)
        mesh = mesh_cap(caps[0].cap_above_rim, nodes)
    height, sigma = rim_height(edge[:, 2])
    residual_m = statistics.range_m - MembraneView(camera, mesh).rest_range
    return Surfaces(
        sphere=caps[0],
        cap=caps[1],
        free_form=free_form,
        rim_height_m=height,
        rim_height_sigma_m=sigma,
        rim_plane=rim_plane(edge, sphere.centre_m, given),
        focal_by_rim_px=_focal_by_rim(edge, samples, ellipsoid),
        camera=camera,
        membrane=membrane,
        fitted=fitted,
        stride=stride,
        left_out_rms_m={name: float(np.sqrt(each.mean())) for name, each in squares.items()},
        chosen=chosen,
        mesh=mesh,
        residual_m=residual_m,
        visible_share=check_dome(samples, mesh, residual_m, camera, membrane),
        motion_m=motion_m,
    )


def _focal_by_rim(edge_m: np.ndarray, samples: FrameSamples, cap: Ellipsoid) -> dict[str, Quantity]:
    found = lateral_scale(edge_m, samples.rim_m, samples.camera, cap)
    if found is None:
        return {}
    focal = {}
    for name, scale, sigma in zip(("fx", "fy"), *found, strict=True):
        value = getattr(samples.camera.intrinsics, name) / scale
        focal[name] = Quantity.normal(float(value), float(value * sigma / scale), "size of the rim")
    return focal


def segment_membrane(samples: FrameSamples) -> tuple[np.ndarray, np.ndarray]:
    """Pixels that see the membrane, and those of them far enough from its edges, (H, W) bool."""
    known = samples.statistics.validity >= samples.statistics.regular_validity
    pixels = np.flatnonzero(known)
    points = samples.camera.points_at(samples.statistics.range_m, pixels)
    rough = fit_ellipsoid(points[:: max(1, len(points) // 20_000)])
    distance = np.full(known.shape, np.nan)
    distance[known] = rough.distance(points)
    membrane = membrane_pixels(distance, known)
    return membrane, away_from_edges(membrane, samples.statistics.correlation_length_px)


Caps = tuple[Ellipsoid, Ellipsoid]
"""Sphere and ellipsoid."""


def _centred(caps: Caps, camera: DepthCamera, on: int) -> tuple[Caps, DepthCamera]:
    """Caps and camera in a frame shifted in x and y so that its z axis contains a cap's centre."""
    shift = caps[on].centre_m * (1.0, 1.0, 0.0)
    sphere, cap = (replace(each, centre_m=each.centre_m - shift) for each in caps)
    return (sphere, cap), camera.shifted(-shift)


def _left_out_squares(
    samples: FrameSamples, caps: Caps, camera: DepthCamera, free_form: FreeForm, side: int
) -> dict[SurfaceName, np.ndarray]:
    """Mean squared error of each surface on tiles left out of its fit, (T,), m².

    All use the same robust weights: those of the free form's errors.
    """
    pixels = np.flatnonzero(np.isfinite(free_form.left_out_m).ravel())
    points = camera.points_at(samples.statistics.range_m, pixels)
    width = samples.camera.intrinsics.width
    tile, fold = tile_numbers(pixels, width, side), fold_of(pixels, width, side)
    facing = np.einsum("ij,ij->i", caps[1].normals(points), camera.directions[pixels])
    missed = free_form.left_out_m.ravel()[pixels] * np.abs(facing)
    weights = tukey_weights(missed - np.median(missed), robust_sigma(missed))
    errors: dict[SurfaceName, np.ndarray] = {"free-form": missed}
    for name, cap in zip(SURFACE_NAMES, caps, strict=False):
        J, distance = cap.derivatives(points, sphere=name == "sphere"), cap.distance(points)
        size = J.shape[1]
        free = sparse.csc_array((size, size))  # no prior
        left_out = left_out_errors(sparse.csr_array(J), distance, weights, fold, free, size - 1)
        errors[name] = left_out(0.0)
    total = np.maximum(np.bincount(tile, weights), 1e-9)
    counted = np.bincount(tile, weights > 0.0) > 0
    return {
        name: (np.bincount(tile, weights * errors[name] ** 2) / total)[counted]
        for name in SURFACE_NAMES
    }


def _choose(squares: dict[SurfaceName, np.ndarray], facet_error_m: float) -> SurfaceName:
    """The simplest surface such that no other is significantly better."""
    chosen: SurfaceName = "sphere"
    for name in SURFACE_NAMES[1:]:
        gain = squares[chosen] - squares[name]
        error = float(gain.std(ddof=1)) / np.sqrt(len(gain)) if len(gain) > 1 else np.inf
        if gain.mean() > max(_STANDARD_ERRORS * error, facet_error_m**2):
            chosen = name
    return chosen


# γ0 and the dome's dimensions with 95 % intervals and an error budget.


@dataclass(frozen=True)
class Quantity:
    """A value with its 95 % interval, in one SI unit."""

    value: float
    low: float
    high: float
    source: str = ""  # what determines it, for reports

    @property
    def half_width(self) -> float:
        return 0.5 * (self.high - self.low)

    @property
    def sigma(self) -> float:
        """Standard deviation of a normal error with this interval."""
        return self.half_width / HALF_95

    def possible(self, least: float = 0.0, most: float = np.inf) -> Quantity:
        """The same cut off at what is possible, as shown and stored."""
        value, low, high = (min(max(x, least), most) for x in (self.value, self.low, self.high))
        return Quantity(value, low, high, self.source)

    def texts(self, most: int) -> tuple[str, str, str]:
        """Value and ends with as many decimals as the interval justifies, `most` at most."""
        decimals = decimals_of(self.half_width, most)
        value, low, high = (rounded(x, decimals) for x in (self.value, self.low, self.high))
        return value, low, high

    def times(self, factor: float) -> Quantity:
        """The same in units smaller by a factor, which is exact."""
        return replace(
            self, value=factor * self.value, low=factor * self.low, high=factor * self.high
        )

    @classmethod
    def normal(cls, value: float, sigma: float, source: str = "") -> Quantity:
        """With a normal error of a standard deviation."""
        return cls(value, value - HALF_95 * sigma, value + HALF_95 * sigma, source)


def with_tension(samples: FrameSamples, surfaces: Surfaces) -> Surfaces:
    """The surfaces with γ0 by Young–Laplace: P R/2 of a sphere, else by force balance.

    Raises InputError: no tension balances the chosen surface.
    """
    free_form, chosen = surfaces.free_form, surfaces.chosen
    # square root of the number of fitted pixels that count as one
    together = float(np.sqrt(max(1.0, samples.statistics.correlated_pixels / surfaces.stride**2)))
    by_surface: dict[SurfaceName, float] = {
        "sphere": 0.5 * float(surfaces.sphere.semi_axes_m[0]),
        "ellipsoid": _cap_tension(surfaces.cap, len(surfaces.mesh.nodes)),
        "free-form": balance_tension(free_form.mesh, 1.0),
    }
    own = _cap_tension(
        surfaces.chosen_cap, len(surfaces.mesh.nodes)
    )  # by the same mesh, also of a sphere
    shape = [free_form.sigma_m[0] * together, by_surface["free-form"] - own]
    sizes, sigmas = {"height_m": float(free_form.mesh.nodes[:, 2].max())}, free_form.sigma_m[1:]
    if chosen != "free-form":
        sizes, sigmas, upper = _of_cap(samples, surfaces)
        shape.append(_cap_tension(upper, len(surfaces.mesh.nodes)) - own)
    facets = facet_error(surfaces.mesh) / np.sqrt(3.0)  # uniform distribution over ± that
    value, sheet = by_surface[chosen], as_flat_sheet(surfaces.mesh)
    excess = 0.0 if sheet is None else value * sheet[1]
    parts = {
        "frames": value * surfaces.motion_m / float(surfaces.sphere.semi_axes_m[0]),
        "facets": 0.5 * facets,
        "surface": float(np.linalg.norm(shape)),
        "statics": abs(excess) / np.sqrt(12.0),  # uniform distribution from 0 to the excess
    }
    interval = Quantity.normal(value + 0.5 * excess, float(np.linalg.norm(list(parts.values()))))
    return replace(
        surfaces,
        tension_m=Quantity(value, interval.low, interval.high),
        tension_parts_m=parts,
        tension_by_surface_m=by_surface,
        dimensions={
            name: Quantity.normal(size, float(np.hypot(facets, together * sigma)))
            for (name, size), sigma in zip(sizes.items(), sigmas.tolist(), strict=True)
        },
        flat_sheet=sheet,
        unequal=Prestress.of(surfaces.mesh, 1.0).unequal(surfaces.mesh, 1.0),
    )


def _cap_tension(cap: Ellipsoid, nodes: int) -> float:
    """γ0 of a cap under 1 Pa, m, over a mesh."""
    return balance_tension(mesh_cap(cap.cap_above_rim, nodes), 1.0)


def _of_cap(
    samples: FrameSamples, surfaces: Surfaces
) -> tuple[dict[str, float], np.ndarray, Ellipsoid]:
    """Dimensions of the chosen cap, m, with σ by errors of single pixels; cap of the upper half.

    The latter is fitted to the upper half of the points alone. If the membrane is a sphere or an
    ellipsoid, its γ0 equals that of the full fit, up to noise. An inflated sheet differs from both
    shapes by micrometres, and the difference of the two fits is about the error of γ0.
    """
    cap, sphere = surfaces.chosen_cap, surfaces.chosen == "sphere"
    pixels = np.flatnonzero((surfaces.fitted & np.isfinite(samples.statistics.range_m)).ravel())
    points = surfaces.camera.points_at(samples.statistics.range_m, pixels)
    distance, J = cap.distance(points), cap.derivatives(points, sphere=sphere)
    sigma = robust_sigma(distance, center=0.0)
    weighted = J.T * tukey_weights(distance, sigma)
    step = 1e-20 * np.eye(len(weighted))  # derivatives by complex steps
    gradient = np.stack([_sizes(cap, each * 1j).imag / 1e-20 for each in step])
    squares = np.sum(gradient * np.linalg.solve(weighted @ J, gradient), axis=0)
    kind = ("radius_m",) if sphere else tuple(f"semi_axis_{axis}_m" for axis in "xyz")
    names = "height_m", *kind, *(f"rim_{name}" for name in kind[:2])
    up = cap.normals(points)[:, 2]  # noise hardly turns normals, but would select points by height
    upper = refitted(points[up > np.median(up)], cap, sphere=sphere)
    values = _sizes(cap, 0.0 * step[0]).tolist()
    return dict(zip(names, values, strict=True)), sigma * np.sqrt(squares), upper


def _sizes(cap: Ellipsoid, step: np.ndarray) -> np.ndarray:
    """Height, radius or semi-axes, and radius or semi-axes of the rim after a step, m."""
    axes = cap.semi_axes_m[: len(step) - 3] + step[3:]
    centre = cap.centre_m[2] + step[2]
    return np.array([centre + axes[-1], *axes, *axes[:2] * np.sqrt(1.0 - (centre / axes[-1]) ** 2)])
