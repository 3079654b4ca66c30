"""Diagnostics of one frame: images, κ curve, patch parts, probe, statistics."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from bubbleviz.camera import DepthCamera, MembraneView
from bubbleviz.inverse import Component, areas_above, components, mean_pressure
from bubbleviz.membrane import MembraneMesh, faces_from, level_line
from bubbleviz.recordings import FrameColour
from bubbleviz.result import Estimate, Result

if TYPE_CHECKING:
    from bubbleviz.pipeline import Pipeline, Product
    from bubbleviz.sensor_model import SensorModel


# Patch area, and IoU with the ground truth, as functions of the patch threshold κ.


KAPPAS = np.geomspace(0.1, 100.0, 61)  # thresholds as multiples of the mean contact pressure (V-C)


@dataclass(frozen=True)
class KappaCurve:
    """Patches of one frame at many thresholds."""

    kappa: np.ndarray  # (k,), multiples of the mean contact pressure, rising
    area_m2: np.ndarray  # (k,), area of the patch on the reference surface
    # (k,), intersection over union of the patch's pixels with the true ones; None: no ground truth
    iou: np.ndarray | None = None

    @property
    def histogram_m2(self) -> np.ndarray:
        """Area (k − 1,) whose pressure lies between one threshold and the next."""
        return -np.diff(self.area_m2)

    def area_at(self, kappa: float) -> float:
        """Area at a threshold, m², interpolated in log κ."""
        return float(np.interp(np.log(kappa), np.log(self.kappa), self.area_m2))


def kappa_curve(
    mesh: MembraneMesh,
    estimate: Estimate,
    truth: np.ndarray | None = None,  # (H, W) bool, true pixels of the patch
    view: MembraneView | None = None,  # required with `truth`
) -> KappaCurve:
    """Curve of an estimate; zeros without contact pressure."""
    pressure = estimate.contact_pressure_pa
    levels = KAPPAS * mean_pressure(mesh, pressure)
    areas = np.zeros(len(KAPPAS))
    if pressure.any():
        areas = np.array(areas_above(mesh, pressure, levels))
    iou = None
    if truth is not None and view is not None:
        iou = _ious(view, estimate, truth, levels)
    return KappaCurve(KAPPAS, areas, iou)


def _ious(
    view: MembraneView, estimate: Estimate, truth: np.ndarray, levels: np.ndarray
) -> np.ndarray:
    """IoU of the pixels above each level, from one cast of all rays."""
    hits = view.hits(view.motion_seen(estimate))
    pressure = hits.values(estimate.contact_pressure_pa, view.mesh.triangles)
    in_patch = np.sort(pressure[truth.ravel()[hits.ray]])
    everywhere = np.sort(pressure)
    intersection = len(in_patch) - np.searchsorted(in_patch, levels, "right")
    found = len(everywhere) - np.searchsorted(everywhere, levels, "right")
    union = found + np.count_nonzero(truth) - intersection
    return np.divide(intersection, union, out=np.ones(len(levels)), where=union > 0)


_CLIPPED_PERCENT = 0.5  # per cent of the pixels beyond either end of the colour scale


@dataclass(frozen=True)
class Inspection:
    """The requested diagnostics of a frame."""

    # (H, W) images by name: `depth`, `change` and `residual` of the range, `noise` (its σ), in m;
    # `used`, bool; `flow`, length of the motion in the colour image by blocks, pixels
    images: dict[str, np.ndarray] = field(default_factory=dict)
    # of each colour scale; none for an image without any value
    ends: dict[str, tuple[float, float]] = field(default_factory=dict)
    colour: FrameColour | None = None
    no_flow: str = ""  # why there is no flow image; empty where `reference` says why
    reference: str = ""  # reference frame of shear, as text; empty if not requested
    kappa_curve: KappaCurve | None = None
    components: tuple[Component, ...] = ()  # parts of the patch, including those removed as small


def inspection(
    pipeline: Pipeline,
    result: Result,
    requested: frozenset[Product],
    kappa: float | None = None,
    truth: np.ndarray | None = None,
) -> Inspection:
    """The requested diagnostics that can be computed from this result.

    Parameters as in `Pipeline.diagnose`; κ is that of the result's patch.
    """
    images: dict[str, np.ndarray] = {}
    curve, parts, colour, why = None, tuple[Component, ...](), None, ""
    estimate = result.estimate
    for product in sorted(requested):
        if product == "kappa_curve":
            if estimate is not None:
                view = pipeline.model.view if truth is not None else None
                curve = kappa_curve(pipeline.mesh, estimate, truth, view)
        elif product == "components":
            if estimate is not None:
                patch = pipeline.unfiltered_patch(estimate, kappa)
                parts = components(pipeline.mesh, estimate, patch)
        elif product == "colour_image":
            texture = result.texture  # already decoded
            colour = FrameColour.of(result.frame) if texture is None else texture.colour
        else:
            name = product.removesuffix("_image")
            image = _image(name, result, pipeline.model)
            if image is not None:
                images[name] = image
            elif name == "flow":
                why = _no_flow(pipeline, result)
    ends = {name: found for name, image in images.items() if (found := _ends(image)) is not None}
    return Inspection(images, ends, colour, why, kappa_curve=curve, components=parts)


def _image(name: str, result: Result, model: SensorModel) -> np.ndarray | None:
    """Image (H, W) of `Inspection.images` by name."""
    depth, estimate, flow = result.frame.depth_m, result.trusted_estimate, result.flow
    if name == "depth":
        return depth
    if name == "flow":
        return None if flow is None or not len(flow.pixel) else flow.lengths_px()
    if name == "noise":
        if model.pixels is None:
            return model.sensor.camera.noise_relative * model.view.rest_range
        return np.where(model.pixels.mask, model.pixels.noise_m, np.nan)
    if name == "residual":
        if estimate is None:
            return None
        return model.residuals(depth, estimate, np.arange(depth.size)).reshape(depth.shape)
    measured = model.range_image(depth)
    if name == "change":
        return measured - model.view.rest_range
    return np.isfinite(measured) & np.isfinite(model.view.rest_range)


def _no_flow(pipeline: Pipeline, result: Result) -> str:
    if result.flow is not None:
        return result.flow.problem
    if result.frame.find_colour is None:
        return result.frame.no_colour
    return "" if pipeline.optical_flow is None else "no colour image at this time"


def _ends(image: np.ndarray) -> tuple[float, float] | None:
    """Range of almost all values of an image, from a sample of ten thousand; None without any."""
    values = image.ravel()[:: max(1, image.size // 10_000)].astype(float)
    values = values[np.isfinite(values)]
    if not len(values):
        return None
    low, high = np.percentile(values, [_CLIPPED_PERCENT, 100.0 - _CLIPPED_PERCENT])
    return float(low), float(high)


# Probe: a pixel of the depth image or a point, and the place of the membrane on the same ray.


Pixel = tuple[int, int]  # row and column
_MAX_DISTANCE_PX = 4  # from a pixel to the nearest one of the thinned cloud; chosen


@dataclass(frozen=True)
class Probed:
    """Values of a result at one pixel or point.

    Those of the membrane are linear in a facet between its nodes, as in the pictures.
    """

    pixel: Pixel | None  # row and column; None: outside the image
    point_m: np.ndarray  # (3,), measured point in B; NaN where the pixel has no return
    depth_m: float  # z-depth; NaN where the pixel has no return
    nodes: np.ndarray  # (3,) int, of the facet of the membrane
    barycentric: np.ndarray  # (3,), coordinates of the place in it
    membrane_m: np.ndarray  # (3,), the place in B
    membrane_pixel: tuple[float, float]  # row and column of its projection
    # displacement_m, pressure_pa: u and p_c there; NaN without a trusted estimate
    displacement_m: float
    pressure_pa: float
    residual_m: float  # measured minus modelled range of the pixel; NaN if not computed
    in_patch: bool | None  # None without a trusted patch

    @property
    def node(self) -> int:
        """The node of the facet that is nearest."""
        return int(self.nodes[np.argmax(self.barycentric)])

    def interpolated(self, values: np.ndarray) -> np.ndarray:
        """Value at the place of a nodal field (n, …)."""
        value: np.ndarray = self.barycentric @ values[self.nodes]
        return value


class Probe:
    """Reads values of results at pixels or points, for one camera and membrane."""

    def __init__(self, camera: DepthCamera, mesh: MembraneMesh) -> None:
        self._camera, self._mesh = camera, mesh

    def at_pixel(self, pixel: Pixel, result: Result) -> Probed | None:
        """Values at a pixel, and where its ray meets the membrane; None outside the image."""
        height, width = result.frame.depth_m.shape
        row, column = pixel
        if not (0 <= row < height and 0 <= column < width):
            return None
        camera = self._camera.displaced(result.estimate)
        ray = camera.directions[row * width + column]
        return self._probed(pixel, result, ray, camera.center)

    def at_point(self, point_m: np.ndarray, result: Result) -> Probed:
        """Values at a point (3,) in B, of the drawn membrane or of the cloud."""
        camera = self._camera.displaced(result.estimate)
        row, column = (round(c) for c in _projected(camera, point_m))
        height, width = result.frame.depth_m.shape
        inside = 0 <= row < height and 0 <= column < width
        ray = point_m - camera.center
        return self._probed((row, column) if inside else None, result, ray, point_m)

    def _probed(
        self, pixel: Pixel | None, result: Result, ray: np.ndarray, near_m: np.ndarray
    ) -> Probed:
        estimate, mesh = result.estimate, self._mesh
        camera = self._camera.displaced(estimate)
        nodes_m = mesh.nodes if estimate is None else mesh.deformed(estimate.motion_m)
        triangle, barycentric = _met(nodes_m, mesh.triangles, camera.center, ray, near_m)
        nodes = mesh.triangles[triangle]
        place = barycentric @ nodes_m[nodes]

        def value(field: np.ndarray | None) -> float:
            return np.nan if field is None else float(barycentric @ field[nodes])

        displacement = pressure = inside = None
        if (patch := result.trusted_patch) is not None:
            mask = patch.pixel_mask
            inside = value(patch.level) > 0.0 if mask is None or not pixel else bool(mask[pixel])
        if (trusted := result.trusted_estimate) is not None:
            displacement, pressure = trusted.displacement_m, trusted.contact_pressure_pa
        point = np.full(3, np.nan)
        if pixel:
            index = np.ravel_multi_index(pixel, result.frame.depth_m.shape)
            point = camera.points(result.frame.depth_m, np.array([index]))[0]
        return Probed(
            pixel=pixel,
            point_m=point,
            depth_m=float(result.frame.depth_m[pixel]) if pixel else np.nan,
            nodes=nodes,
            barycentric=barycentric,
            membrane_m=place,
            membrane_pixel=_projected(camera, place),
            displacement_m=value(displacement),
            pressure_pa=value(pressure),
            residual_m=_residual(pixel, result) if pixel else np.nan,
            in_patch=inside,
        )


def _projected(camera: DepthCamera, point_m: np.ndarray) -> tuple[float, float]:
    """Row and column of the projection of a point in B."""
    u, v = camera.project(point_m)
    return float(v), float(u)


# Profile: heights and contact pressure along a line across the membrane.


_PROFILE_SAMPLES = 500  # rays of the camera looked for along a line; pixels are fewer


@dataclass(frozen=True)
class Profile:
    """Section of the membrane by a plane through two points and parallel to the z axis of B.

    Each curve has its distances `…_along_m` from the first point, across z, ascending.
    """

    along_m: np.ndarray  # (k,), where edges of the membrane cross the plane, and the ends
    height_m: np.ndarray  # (k,), z of the estimated membrane; NaN without a trusted estimate
    rest_along_m: np.ndarray  # (r,)
    rest_height_m: np.ndarray  # (r,), z of the membrane at rest
    pressure_pa: np.ndarray  # (k,), p_c; NaN without a trusted estimate
    measured_along_m: np.ndarray  # (m,), of the pixels that see the section
    measured_height_m: np.ndarray  # (m,), z of their measured points


def profile(
    camera: DepthCamera,
    mesh: MembraneMesh,
    result: Result,
    ends_m: np.ndarray,  # (2, 3), two points in B
) -> Profile | None:
    """Profile of a result between two points; None if they are above each other."""
    start, across = ends_m[0], (ends_m[1] - ends_m[0]) * (1.0, 1.0, 0.0)
    length = float(np.linalg.norm(across))
    if not length > 0.0:
        return None
    e = across / length
    estimate = result.trusted_estimate
    unknown = np.full(len(mesh.nodes), np.nan)
    pressure = unknown if estimate is None else estimate.contact_pressure_pa
    rest_along, rest, _ = _section(mesh.nodes, mesh.triangles, start, e, length, unknown)
    along, height, pressures = rest_along, np.full_like(rest, np.nan), np.full_like(rest, np.nan)
    if estimate is not None:
        nodes = mesh.deformed(estimate.motion_m)
        along, height, pressures = _section(nodes, mesh.triangles, start, e, length, pressure)
    seen = (along, height) if estimate is not None else (rest_along, rest)
    camera = camera.displaced(result.estimate)
    measured = _measured(camera, result.frame.depth_m, start, e, *seen)
    return Profile(along, height, rest_along, rest, pressures, *measured)


def _section(
    nodes_m: np.ndarray,
    triangles: np.ndarray,
    start_m: np.ndarray,
    e: np.ndarray,  # (3,), unit vector across z
    length_m: float,
    values: np.ndarray,  # (n,), nodal field
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance along e, z and a nodal field where edges cross the plane of e and z, ascending.

    From 0 to the length, with both ends where the surface reaches them.
    """
    off = (nodes_m - start_m) @ np.array([-e[1], e[0], 0.0])
    both = np.column_stack([nodes_m, values])
    found = level_line(both, triangles.T, off).reshape(-1, 4)
    along = (found[:, :3] - start_m) @ e
    order = np.argsort(along)
    along, (height, value) = along[order], found[order, 2:].T
    if not len(along):
        return along, height, value
    at = np.unique(np.clip(along, 0.0, length_m))
    at = at[(at >= along[0]) & (at <= along[-1])]
    return at, np.interp(at, along, height), np.interp(at, along, value)


def _measured(
    camera: DepthCamera,
    depth_m: np.ndarray,
    start_m: np.ndarray,
    e: np.ndarray,
    along_m: np.ndarray,
    height_m: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Distance along e and z of the measured points of the pixels that see a section."""
    if not len(along_m):
        return along_m, height_m
    at = np.linspace(along_m[0], along_m[-1], _PROFILE_SAMPLES)
    points = start_m + at[:, None] * e
    points[:, 2] = np.interp(at, along_m, height_m)
    column, row = np.round(camera.project(points)).astype(int).T
    height, width = depth_m.shape
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    pixels = np.unique(row[inside] * width + column[inside])
    pixels = pixels[depth_m.ravel()[pixels] > 0.0]  # neither 0 nor NaN
    seen = camera.points(depth_m, pixels)
    seen_along = (seen - start_m) @ e
    order = np.argsort(seen_along)
    return seen_along[order], seen[order, 2]


def _met(
    nodes_m: np.ndarray,
    triangles: np.ndarray,
    origin_m: np.ndarray,
    ray: np.ndarray,
    near_m: np.ndarray,
) -> tuple[int, np.ndarray]:
    """Triangle that a ray meets, nearest to a point, and the coordinates (3,) of the place in it.

    A ray that meets none, beside the rim, gives the edge that it misses least.
    """
    volumes = faces_from(nodes_m - origin_m, triangles) @ ray
    along = volumes.sum(axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):  # triangles in a plane with the ray
        coordinates = volumes / along
    inside = np.clip(coordinates, 0.0, 1.0)
    inside /= inside.sum(axis=1, keepdims=True)
    places = np.einsum("mk,mkx->mx", inside, nodes_m[triangles])
    missed = np.maximum(-coordinates.min(axis=1), 0.0)
    missed[~((places - origin_m) @ ray > 0.0)] = np.inf  # behind the camera
    distance = np.sum((places - near_m) ** 2, axis=1)
    triangle = int(np.lexsort((distance, missed))[0])
    return triangle, inside[triangle]


def _residual(pixel: Pixel, result: Result) -> float:
    """Residual of the pixel, or of the nearest one in its row if the cloud is thinned, m."""
    residual, pixels, depth = result.cloud_residual_m, result.cloud_pixels, result.frame.depth_m
    if residual is None or pixels is None or not len(pixels) or not np.isfinite(depth[pixel]):
        return np.nan
    width = depth.shape[1]
    next_one = int(np.searchsorted(pixels, pixel[0] * width + pixel[1]))
    neighbours = np.clip([next_one - 1, next_one], 0, len(pixels) - 1)
    row, column = np.divmod(pixels[neighbours], width)
    distance = np.where(row == pixel[0], np.abs(column - pixel[1]), width)
    nearest = int(np.argmin(distance))
    near = distance[nearest] <= _MAX_DISTANCE_PX
    return float(residual[neighbours[nearest]]) if near else np.nan


@dataclass(frozen=True)
class Statistics:
    """Statistics over frames in which a quantity is known; NaN if there are too few."""

    mean: float
    standard_deviation: float  # of a single frame, with n − 1 in the denominator
    minimum: float
    maximum: float
    frames: int  # with known values


def statistics(values: np.ndarray) -> Statistics:
    """Statistics of the finite values of an array (n,)."""
    known = values[np.isfinite(values)]
    if not known.size:
        return Statistics(np.nan, np.nan, np.nan, np.nan, 0)
    spread = float(known.std(ddof=1)) if known.size > 1 else np.nan
    return Statistics(
        float(known.mean()), spread, float(known.min()), float(known.max()), known.size
    )
