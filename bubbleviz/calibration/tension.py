"""γ0 and the dome's dimensions with 95 % intervals and an error budget."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from bubbleviz.calibration.cluster_covariance import cluster_covariances
from bubbleviz.calibration.ellipsoid import Ellipsoid, fit_ellipsoid, fit_sphere
from bubbleviz.calibration.rest_frames import FrameSamples
from bubbleviz.camera import facet_error
from bubbleviz.membrane import as_flat_sheet, balance_tension, least_squares_tension
from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import robust_sigma, tukey_slopes, tukey_weights
from bubbleviz.result import HALF_95
from bubbleviz.wording import decimals_of, rounded

if TYPE_CHECKING:
    from bubbleviz.calibration.surface import SurfaceName, Surfaces

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

    def possible(self, most: float = np.inf) -> Quantity:
        """The same cut off at what is possible, from 0 to `most`, as shown and stored."""
        value, low, high = (min(max(x, 0.0), most) for x in (self.value, self.low, self.high))
        return Quantity(value, low, high, self.source)

    def texts(self, most: int) -> tuple[str, str, str]:
        """Value and ends with as many decimals as the interval justifies, `most` at most."""
        decimals, cut = decimals_of(self.half_width, most), self.possible()
        return rounded(cut.value, decimals), rounded(cut.low, decimals), rounded(cut.high, decimals)

    def times(self, factor: float) -> Quantity:
        """The same in units smaller by a factor, which is exact."""
        return replace(
            self, value=factor * self.value, low=factor * self.low, high=factor * self.high
        )

    @classmethod
    def normal(cls, value: float, sigma: float, source: str = "") -> Quantity:
        """With a normal error of a standard deviation."""
        return cls(value, value - HALF_95 * sigma, value + HALF_95 * sigma, source)


def with_tension(samples: FrameSamples, surfaces: Surfaces, progress: Progress = quiet) -> Surfaces:
    """The surfaces with γ0 by Young–Laplace: P R/2 of a sphere, else by force balance.

    Raises InputError: no tension balances the chosen surface.
    """
    free_form, stride = surfaces.free_form, surfaces.stride
    if surfaces.chosen == "free-form":
        linear = _linear_free_form(surfaces)
    else:
        linear = _linear_cap(samples, surfaces)
    now, (tiles, frames) = linear[0], _errors(samples, linear, stride, progress)
    sphere, cap = surfaces.sphere, surfaces.cap
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
        free_form.tension_sigma_m * np.sqrt(together),
        by_surface["free-form"] - by_surface[other],
    ]
    if surfaces.chosen != "free-form":
        shape.append(_upper_half(samples, surfaces) - by_surface[other])
    value, sheet = now["tension_m"], as_flat_sheet(surfaces.mesh)
    excess = 0.0 if sheet is None else value * sheet[1]
    parts = {
        "pixels": float(tiles[0]),
        "frames": float(frames[0]),
        "facets": 0.5 * facets,
        "surface": float(np.linalg.norm(shape)),
        "statics": abs(excess) / np.sqrt(12.0),  # uniform distribution from 0 to the excess
    }
    own = Quantity.normal(value + 0.5 * excess, float(np.linalg.norm(list(parts.values()))))
    return replace(
        surfaces,
        tension_m=Quantity(value, own.low, own.high),
        tension_parts_m=parts,
        tension_by_surface_m=by_surface,
        least_squares_m=least_squares_tension(surfaces.mesh, 1.0),
        dimensions={
            name: Quantity.normal(size, float(np.linalg.norm([facets, *errors])))
            for (name, size), *errors in list(zip(now.items(), tiles, frames, strict=True))[1:]
        },
        flat_sheet=sheet,
    )


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


def _linear_free_form(surfaces: Surfaces) -> Linear:
    free_form = surfaces.free_form
    residual_m = surfaces.residual_m.ravel()[free_form.pixels]
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
