"""γ0 and the dome's dimensions with 95 % intervals and an error budget."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bubbleviz.calibration.cluster_covariance import cluster_covariances
from bubbleviz.calibration.ellipsoid import Ellipsoid, fit_ellipsoid, fit_sphere
from bubbleviz.calibration.free_form import FreeForm
from bubbleviz.calibration.rest_frames import FrameSamples
from bubbleviz.calibration.surface import SurfaceName, Surfaces
from bubbleviz.camera import facet_error
from bubbleviz.membrane import balance_tension, least_squares_tension
from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import error_of_mean, robust_sigma, tukey_slopes, tukey_weights
from bubbleviz.result import HALF_95
from bubbleviz.wording import decimals_of, rounded

_CLIP = 3.0  # standard deviations beyond which the mean of a pixel ignores samples


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

    @property
    def positive(self) -> tuple[float, float]:
        """Ends of the interval as shown for what cannot be negative."""
        return max(self.low, 0.0), self.high

    def texts(self, most: int) -> tuple[str, str, str]:
        """Value and ends with as many decimals as the interval justifies, `most` at most."""
        decimals = decimals_of(self.half_width, most)
        value, low, high = (rounded(each, decimals) for each in (self.value, *self.positive))
        return value, low, high

    @classmethod
    def normal(cls, value: float, sigma: float, source: str = "") -> Quantity:
        """With a normal error of a standard deviation."""
        return cls(value, value - HALF_95 * sigma, value + HALF_95 * sigma, source)


@dataclass(frozen=True)
class MaterialEstimate:
    """γ0 by Young–Laplace, gauge pressure, and pre-stretch λ where it is determined."""

    # γ0, N/m, of the chosen surface, with the error of the shape alone, at an exact gauge pressure
    of_shape: Quantity
    # `height_m`, and `radius_m` and `rim_radius_m` of a sphere or `semi_axis_x_m` … and
    # `rim_semi_axis_x_m` … of an ellipsoid, m
    dimensions: dict[str, Quantity]
    # standard deviation of γ0 by each source of error of the shape, N/m: `pixels` (noise, and fixed
    # pattern of the camera), `frames` (drift beyond noise), `gas_pressure` (its noise, not its
    # zero), `facets` (of the mesh), `surface` (hidden or unresolved shape: uncertainty of the free
    # form, difference between free form and cap, and, where a cap was chosen, between that and one
    # fitted to the upper half alone) and `statics` (mean tension that shape and pressure do not
    # determine: between that of a soap film and that of an initially flat sheet)
    shape_parts: dict[str, float]
    by_surface: dict[SurfaceName, float]  # γ0 of every surface, N/m
    # γ0 of the mesh by least squares over its nodes instead of the overall balance; smaller where
    # the mean curvature varies, so that no uniform tension fits
    least_squares_n_per_m: float
    gauge: Quantity  # gauge pressure, Pa; γ0's interval includes its error
    prestretch: Quantity | None = None  # λ; None: not determined
    # share of an initially flat sheet in the stress that a rim leaves open; None: not determined
    sheet_share: Quantity | None = None
    why_not: str = "neither levels nor a held press were used"  # to determine λ
    shapes_kind: Literal["press", "levels"] | None = None  # to which the rubber was fitted
    # gauge pressure from the shapes alone, and from the sensor file, Pa, where `gauge` is the
    # weighted mean of both
    gauge_candidates: tuple[Quantity, Quantity] | None = None
    rises_pa: tuple[float, ...] = ()  # gas pressure of every shape over that at rest, Pa
    # robust rms of the changes of range from rest, and of the residuals of the rubber model, m
    change_rms_m: float = np.nan
    unexplained_rms_m: float = np.nan

    @property
    def contradicts_file(self) -> bool:
        """Whether gauge pressures from shapes and file differ by more than their intervals."""
        if self.gauge_candidates is None:
            return False
        shapes, file = self.gauge_candidates
        return abs(shapes.value - file.value) > np.hypot(shapes.half_width, file.half_width)

    @property
    def per_pascal(self) -> float:
        """Derivative of γ0 by the gauge pressure, m; γ0 is proportional to it."""
        return self.of_shape.value / self.gauge.value

    @property
    def stress_sigma(self) -> float:
        """Relative standard deviation of a film's stress at a given gauge pressure, by its shape.

        What the shape leaves open and the noise of the gas pressure are unknowns of the rubber's
        fit themselves.
        """
        parts = self.shape_parts.items()
        own = [part for name, part in parts if name not in ("statics", "gas_pressure")]
        return float(np.linalg.norm(own)) / self.of_shape.value

    @property
    def parts(self) -> dict[str, float]:
        """Standard deviation of γ0 by every source: those of the shape, `gauge_pressure`, N/m."""
        return self.shape_parts | {"gauge_pressure": self.per_pascal * self.gauge.sigma}

    @property
    def tension(self) -> Quantity:
        """γ0, N/m, of the chosen surface."""
        shape, other = self.of_shape, self.per_pascal * self.gauge.half_width
        low, high = (float(np.hypot(end - shape.value, other)) for end in (shape.low, shape.high))
        ends = shape.value - low, shape.value + high
        return Quantity(shape.value, *ends, "shape and gauge pressure")

    def under(self, gauge: Quantity) -> MaterialEstimate:
        """The same estimate for another gauge pressure with its interval."""
        scale, shape = gauge.value / self.gauge.value, self.of_shape
        return replace(
            self,
            of_shape=Quantity(scale * shape.value, scale * shape.low, scale * shape.high),
            shape_parts={name: scale * part for name, part in self.shape_parts.items()},
            by_surface={name: scale * each for name, each in self.by_surface.items()},
            least_squares_n_per_m=scale * self.least_squares_n_per_m,
            gauge=gauge,
        )


def estimate_tension(
    samples: FrameSamples,
    surfaces: Surfaces,
    gauge: Quantity,  # gauge pressure, Pa
    progress: Progress = quiet,
) -> MaterialEstimate:
    """γ0 by Young–Laplace: P R/2 of a sphere, else by force balance over the chosen surface.

    Raises InputError: no tension balances the surface.
    """
    free_form, stride = surfaces.free_form, surfaces.stride
    if surfaces.chosen == "free-form":
        linear = _linear_free_form(free_form)
    else:
        linear = _linear_cap(samples, surfaces)
    now, (tiles, frames) = linear[0], _errors(samples, linear, stride, progress)
    sphere, cap, gas = surfaces.sphere, surfaces.cap, samples.gas_pressure_pa
    by_surface: dict[SurfaceName, float] = {
        "sphere": 0.5 * float(sphere.semi_axes_m[0]),
        "ellipsoid": _cap_numbers(cap)(cap)["tension_m"],
        "free-form": balance_tension(free_form.mesh, 1.0),
    }
    facets = facet_error(surfaces.mesh) / np.sqrt(3.0)  # uniform distribution over ± that
    other: SurfaceName = "ellipsoid" if surfaces.chosen == "free-form" else surfaces.chosen
    # fitted pixels that count as one
    together = max(1.0, samples.statistics.correlated_pixels / stride**2)
    shape = [
        free_form.left_out_rms_m * np.sqrt(max(free_form.tension_variance, 0.0) * together),
        by_surface["free-form"] - by_surface[other],
    ]
    if surfaces.chosen != "free-form":
        shape.append(_upper_half(samples, surfaces) - by_surface[other])
    value = now["tension_m"]
    sheet = surfaces.as_flat_sheet
    excess = 0.0 if sheet is None else value * sheet[1]
    parts = {
        "pixels": float(tiles[0]),
        "frames": float(frames[0]),
        "gas_pressure": value * (0.0 if gas is None else error_of_mean(gas)) / gauge.value,
        "facets": 0.5 * facets,
        "surface": float(np.linalg.norm(shape)),
        "statics": abs(excess) / np.sqrt(12.0),  # uniform distribution from 0 to the excess
    }
    own = Quantity.normal(value + 0.5 * excess, float(np.linalg.norm(list(parts.values()))))
    under_1_pa = MaterialEstimate(
        of_shape=Quantity(value, own.low, own.high),
        dimensions={
            name: Quantity.normal(size, float(np.linalg.norm([facets, *errors])))
            for (name, size), *errors in list(zip(now.items(), tiles, frames, strict=True))[1:]
        },
        shape_parts=parts,
        by_surface=by_surface,
        least_squares_n_per_m=least_squares_tension(surfaces.mesh, 1.0),
        gauge=Quantity.normal(1.0, 0.0),
    )
    return under_1_pa.under(gauge)


def _errors(
    samples: FrameSamples, linear: Linear, stride: int, progress: Progress
) -> list[np.ndarray]:
    """Standard deviations of the quantities by the pixels, and by drift of the frames."""
    now, pixels, influence, residual_m, parameters = linear
    statistics, width = samples.statistics, samples.camera.intrinsics.width
    (row, column), columns = np.divmod(pixels, width), -(-width // stride)
    to_depth = samples.camera.range_per_depth.ravel()[pixels].astype(float)
    noise = np.maximum(statistics.noise_m.ravel()[pixels], statistics.quantum_m)
    covariances = cluster_covariances(
        statistics,
        (row // stride * columns + column // stride, columns, stride),
        samples.depth_m.reshape(len(samples.depth_m), -1),
        pixels,
        np.nan_to_num(statistics.range_m.ravel()[pixels] / to_depth),
        np.nan_to_num(_CLIP * noise / to_depth),
        influence * to_depth[:, None],
        residual_m / to_depth,
        parameters,
        progress,
    )
    return [np.sqrt(np.diag(each)[: len(now)]) for each in covariances]


Linear = tuple[dict[str, float], np.ndarray, np.ndarray, np.ndarray, int]
"""Quantities (γ0 under 1 Pa first), pixels (P,), influence (P, Q), residual range (P,) and count of
fitted parameters."""


def _linear_cap(samples: FrameSamples, surfaces: Surfaces) -> Linear:
    own, sphere = surfaces.chosen_cap, surfaces.chosen == "sphere"
    numbers = _cap_numbers(own, sphere=sphere)
    pixels = np.flatnonzero((surfaces.fitted & np.isfinite(samples.statistics.range_m)).ravel())
    points = surfaces.camera.points_at(samples.statistics.range_m, pixels)
    distance, J = own.distance(points), own.derivatives(points, sphere=sphere)
    sigma = robust_sigma(distance, center=0.0)
    weights, slopes = tukey_weights(distance, sigma), tukey_slopes(distance, sigma)
    facing = np.einsum("ij,ij->i", own.normals(points), surfaces.camera.directions[pixels])
    rows = -np.linalg.solve(J.T @ (J * slopes[:, None]), J.T).T * (weights * facing)[:, None]
    influence = rows @ _gradient(numbers, own, J.shape[1])
    return numbers(own), pixels, influence, distance / facing, rows.shape[1]


def _linear_free_form(free_form: FreeForm) -> Linear:
    residual_m = free_form.residual_m.ravel()[free_form.pixels]
    influence = np.where(np.isnan(residual_m)[:, None], 0.0, free_form.influence)
    now = {
        "tension_m": balance_tension(free_form.mesh, 1.0),
        "height_m": float(free_form.mesh.nodes[:, 2].max()),
    }
    return now, free_form.pixels, influence, np.nan_to_num(residual_m), 2


def _upper_half(samples: FrameSamples, surfaces: Surfaces) -> float:
    """γ0 under 1 Pa, m, of the cap fitted to the upper half of the points alone.

    On a sphere or an ellipsoid this equals γ0 of the full fit, up to noise. An inflated sheet
    differs from either by micrometres, with an error of γ0 of about the difference of the two fits.
    """
    pixels = np.flatnonzero(surfaces.fitted)
    points = surfaces.camera.points_at(samples.statistics.range_m, pixels)
    upper = points[points[:, 2] > np.nanmedian(points[:, 2])]
    refit = fit_sphere(upper) if surfaces.chosen == "sphere" else fit_ellipsoid(upper)
    return _cap_numbers(surfaces.chosen_cap)(refit)["tension_m"]


Numbers = Callable[[Ellipsoid], dict[str, float]]


def _cap_numbers(at: Ellipsoid, *, sphere: bool = False) -> Numbers:
    """Function of caps close to a given one that returns γ0 under 1 Pa, then the dimensions."""
    mesh = at.fine_mesh
    centres, areas = mesh.nodes[mesh.triangles].mean(axis=1), mesh.facet_areas

    def numbers(cap: Ellipsoid) -> dict[str, float]:
        x, y, z = (float(a) for a in cap.semi_axes_m)
        at_rim = float(np.sqrt(max(1.0 - (cap.centre_m[2] / z) ** 2, 0.0)))
        found = {
            # by force balance
            "tension_m": float(areas.sum() / (areas @ cap.curvature(centres))),
            "height_m": float(cap.centre_m[2]) + z,
        }
        if sphere:
            return found | {"radius_m": x, "rim_radius_m": x * at_rim}
        axes = {"semi_axis_x_m": x, "semi_axis_y_m": y, "semi_axis_z_m": z}
        return found | axes | {"rim_semi_axis_x_m": x * at_rim, "rim_semi_axis_y_m": y * at_rim}

    return numbers


def _gradient(numbers: Numbers, at: Ellipsoid, parameters: int) -> np.ndarray:
    """Derivative of the quantities by the parameters, (p, Q), by central differences."""
    columns = []
    for step in 1e-6 * np.eye(parameters):
        up, down = numbers(at.moved(step)), numbers(at.moved(-step))
        columns.append((np.array(list(up.values())) - np.array(list(down.values()))) / 2e-6)
    return np.array(columns)
