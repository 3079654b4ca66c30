"""Diagnostics of one frame: images, κ curve, patch parts, probed points, statistics."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from bubbleviz.camera import DepthCamera, MembraneView
from bubbleviz.inverse import Component, areas_above, components, mean_pressure
from bubbleviz.membrane import MembraneMesh
from bubbleviz.recordings import SeenColour
from bubbleviz.result import Estimate, Result

if TYPE_CHECKING:
    from bubbleviz.pipeline import Pipeline, Product
    from bubbleviz.sensor_model import SensorModel


# Patch area, and IoU with a known truth, as functions of the patch threshold κ.


KAPPAS = np.geomspace(0.1, 100.0, 61)  # thresholds as multiples of the mean contact pressure (V-C)


@dataclass(frozen=True)
class KappaCurve:
    """Patches of one frame at many thresholds."""

    kappa: np.ndarray  # (k,), multiples of the mean contact pressure, rising
    area_m2: np.ndarray  # (k,), area of the patch on the reference surface
    # (k − 1,), area whose pressure lies between one threshold and the next
    histogram_m2: np.ndarray
    # (k,), intersection over union of the patch's pixels with the true ones; None without a truth
    iou: np.ndarray | None = None

    def area_at(self, kappa: float) -> float:
        """Area at a threshold of the curve's range, m², between its points by log κ."""
        return float(np.interp(np.log(kappa), np.log(self.kappa), self.area_m2))


def kappa_curve(
    mesh: MembraneMesh,
    estimate: Estimate,
    truth: np.ndarray | None = None,  # (H, W) bool, true pixels of the patch
    view: MembraneView | None = None,  # needed to compare with the truth
) -> KappaCurve:
    """Curve of an estimate; of zeros without contact pressure."""
    pressure = estimate.contact_pressure_pa
    levels = KAPPAS * mean_pressure(mesh, pressure)
    areas = np.zeros(len(KAPPAS))
    if pressure.any():
        areas = np.array(areas_above(mesh, pressure, levels))
    iou = None
    if truth is not None and view is not None:
        iou = _ious(view, estimate, truth, levels)
    histogram = np.zeros(len(KAPPAS) - 1)
    if pressure.any():
        histogram, _ = np.histogram(pressure, levels, weights=mesh.areas)
    return KappaCurve(KAPPAS, areas, histogram, iou)


def _ious(
    view: MembraneView, estimate: Estimate, truth: np.ndarray, levels: np.ndarray
) -> np.ndarray:
    """IoU of the pixels above each level, from one cast of all rays."""
    hits = view.hits(estimate.motion_m)
    corners = estimate.contact_pressure_pa[view.mesh.triangles[hits.triangle]]
    seen = np.einsum("ij,ij->i", hits.barycentric, corners)
    right = np.sort(seen[truth.ravel()[hits.ray]])
    everything = np.sort(seen)
    hit = len(right) - np.searchsorted(right, levels, "right")
    found = len(everything) - np.searchsorted(everything, levels, "right")
    union = found + np.count_nonzero(truth) - hit
    return np.divide(hit, union, out=np.ones(len(levels)), where=union > 0)


OUTERMOST = 0.5  # per cent of the pixels at either end that colours need not tell apart


@dataclass(frozen=True)
class Inspection:
    """The requested diagnostics of a frame."""

    # (H, W) image by name: z-depth, change and residual of the range and its σ in m; `used` bool;
    # `flow`, length of the motion in the colour image in pixels, by blocks
    images: dict[str, np.ndarray] = field(default_factory=dict)
    # between them lie all but the outermost values of each image
    ends: dict[str, tuple[float, float]] = field(default_factory=dict)
    colour: SeenColour | None = None
    # why there is no image of the flow, in a few words; empty where the reference says it
    no_flow: str = ""
    reference: str = ""  # what shear is measured against, in words; empty where nobody asked for it
    kappa_curve: KappaCurve | None = None
    # parts of the patch, those too, that are left out for their size
    components: tuple[Component, ...] = ()


def inspection(
    pipeline: Pipeline,
    result: Result,
    looks: frozenset[Product],
    kappa: float | None = None,
    truth: np.ndarray | None = None,
) -> Inspection:
    """Some of `pipeline.LOOKS` at a result; those that lack a product are left out.

    Parameters are those of `Pipeline.look`, and the κ of the result's patch.
    """
    images: dict[str, np.ndarray] = {}
    curve, parts, colour, why = None, tuple[Component, ...](), None, ""
    estimate = result.estimate
    for look in sorted(looks):
        if look == "kappa_curve":
            if estimate is not None:
                view = pipeline.model.view if truth is not None else None
                curve = kappa_curve(pipeline.mesh, estimate, truth, view)
        elif look == "components":
            if estimate is not None:
                whole = pipeline.whole_patch(estimate, kappa)
                parts = components(pipeline.mesh, estimate, whole)
        elif look == "colour_image":
            texture = result.texture  # has it decoded
            colour = SeenColour.of(result.frame) if texture is None else texture.colour
        else:
            name = look.removesuffix("_image")
            image = _image(name, result, pipeline.model)
            if image is not None:
                images[name] = image
            elif name == "flow":
                why = _no_flow(pipeline, result)
    ends = {name: _ends(image) for name, image in images.items()}
    return Inspection(images, ends, colour, why, kappa_curve=curve, components=parts)


def _image(name: str, result: Result, model: SensorModel) -> np.ndarray | None:
    """Image (H, W) of a name of `Inspection.images`, at full resolution."""
    depth, estimate, flow = result.frame.depth_m, result.trusted_estimate, result.flow
    if name == "depth":
        return depth
    if name == "flow":
        return None if flow is None or not len(flow.pixel) else flow.lengths_px()
    if name == "noise":
        if model.pixels is None:
            return model.sensor.camera.noise_relative * model.view.rest_range
        return np.where(model.pixels.mask, model.pixels.noise_m, np.nan)
    measured = model.range_image(depth)
    if name == "change":
        return measured - model.view.rest_range
    if name == "used":
        return np.isfinite(measured) & np.isfinite(model.view.rest_range)
    return None if estimate is None else measured - model.view.range_image(estimate.motion_m)


def _no_flow(pipeline: Pipeline, result: Result) -> str:
    if result.flow is not None:
        return result.flow.problem or "none of the texture could be matched"
    if result.frame.find_colour is None:
        return result.frame.no_colour
    return "" if pipeline.flow_of is None else "no colour image at this time"


def _ends(image: np.ndarray) -> tuple[float, float]:
    """Range of almost all values of an image, by some ten thousand of them."""
    values = image.ravel()[:: max(1, image.size // 10_000)].astype(float)
    values = values[np.isfinite(values)]
    if not len(values):
        return 0.0, 1.0
    low, high = np.percentile(values, [OUTERMOST, 100.0 - OUTERMOST])
    return float(low), float(high)


# Probe: a pixel of the depth image with its point in 3-D and the nearest node.


Pixel = tuple[int, int]  # row and column
CLOSE_PX = 4  # how far a pixel may be from the one whose residual stands for it; chosen


@dataclass(frozen=True)
class Probed:
    pixel: Pixel | None  # row and column; None for a place outside the image
    point_m: np.ndarray  # (3,), measured point in B; NaN where the pixel has no return
    depth_m: float  # z-depth; NaN where the pixel has no return
    node: int  # nearest node of the membrane
    node_m: np.ndarray  # (3,), where it is now, in B
    node_pixel: tuple[float, float]  # row and column at which the camera sees it
    # displacement_m, pressure_pa: u and p_c of the node; NaN without an estimate
    displacement_m: float
    pressure_pa: float
    unexplained_pa: float  # pressure at the node without evidence of contact, 0 where there is none
    residual_m: float  # measured less modelled range of the pixel; NaN where the result has none


class Probe:
    """Finds places in results of one camera and membrane."""

    def __init__(self, camera: DepthCamera, mesh: MembraneMesh) -> None:
        self._camera, self._mesh = camera, mesh

    def at_pixel(self, pixel: Pixel, result: Result) -> Probed | None:
        """Place that a pixel sees; None outside the image.

        Its node is the one nearest to the measured point, or to the ray where there is no return.
        """
        height, width = result.frame.depth_m.shape
        row, column = pixel
        if not (0 <= row < height and 0 <= column < width):
            return None
        nodes = self._nodes(result)
        point = self._point(pixel, result)
        away = nodes - (point if np.isfinite(point).all() else self._camera.center)
        if not np.isfinite(point).all():
            ray = self._camera.directions[row * width + column]
            away = away - np.outer(away @ ray, ray)
        return self._probed(pixel, result, nodes, int(np.argmin(np.sum(away**2, axis=1))))

    def at_point(self, point_m: np.ndarray, result: Result) -> Probed:
        """Place at a point (3,) in B, on the drawn membrane or in the cloud."""
        nodes = self._nodes(result)
        node = int(np.argmin(np.sum((nodes - point_m) ** 2, axis=1)))
        row, column = (round(c) for c in self._seen_at(point_m))
        height, width = result.frame.depth_m.shape
        inside = 0 <= row < height and 0 <= column < width
        return self._probed((row, column) if inside else None, result, nodes, node)

    def _probed(self, pixel: Pixel | None, result: Result, nodes: np.ndarray, node: int) -> Probed:
        estimate = result.trusted_estimate
        unexplained = None if estimate is None else estimate.unexplained_pressure_pa
        return Probed(
            pixel=pixel,
            point_m=self._point(pixel, result) if pixel else np.full(3, np.nan),
            depth_m=float(result.frame.depth_m[pixel]) if pixel else np.nan,
            node=node,
            node_m=nodes[node],
            node_pixel=self._seen_at(nodes[node]),
            displacement_m=float(estimate.displacement_m[node]) if estimate else np.nan,
            pressure_pa=float(estimate.contact_pressure_pa[node]) if estimate else np.nan,
            unexplained_pa=0.0 if unexplained is None else float(unexplained[node]),
            residual_m=_residual(pixel, result) if pixel else np.nan,
        )

    def _nodes(self, result: Result) -> np.ndarray:
        if result.estimate is None:
            return self._mesh.nodes
        return self._mesh.deformed(result.estimate.motion_m)

    def _point(self, pixel: Pixel, result: Result) -> np.ndarray:
        """Measured point of a pixel in B, (3,), m."""
        depth = result.frame.depth_m
        index = np.array([pixel[0] * depth.shape[1] + pixel[1]])
        return self._camera.points(depth, index)[0]

    def _seen_at(self, point_m: np.ndarray) -> tuple[float, float]:
        """Row and column at which the camera sees a point in B."""
        T = self._camera.T_B_C
        u, v = self._camera.intrinsics.project((point_m - T[:3, 3]) @ T[:3, :3])
        return float(v), float(u)


def _residual(pixel: Pixel, result: Result) -> float:
    """Residual of the pixel, or of one close by in its row where the cloud is thinned, m."""
    residual, pixels, depth = result.cloud_residual_m, result.cloud_pixels, result.frame.depth_m
    if residual is None or pixels is None or not len(pixels) or not np.isfinite(depth[pixel]):
        return np.nan
    wide = depth.shape[1]
    next_one = int(np.searchsorted(pixels, pixel[0] * wide + pixel[1]))
    beside = np.clip([next_one - 1, next_one], 0, len(pixels) - 1)
    row, column = np.divmod(pixels[beside], wide)
    off = np.where(row == pixel[0], np.abs(column - pixel[1]), wide)
    nearest = int(np.argmin(off))
    return float(residual[beside[nearest]]) if off[nearest] <= CLOSE_PX else np.nan


# Mean, spread and extremes of a quantity over some frames.


@dataclass(frozen=True)
class Statistics:
    """Of the frames in which a quantity is known; in its unit, NaN where there are too few."""

    mean: float
    standard_deviation: float  # of a single frame, with n − 1 in the denominator
    minimum: float
    maximum: float
    frames: int  # in which it is known


def statistics(values: np.ndarray) -> Statistics:
    """Statistics of an array (n,); NaN is unknown."""
    known = values[np.isfinite(values)]
    if not known.size:
        return Statistics(np.nan, np.nan, np.nan, np.nan, 0)
    spread = float(known.std(ddof=1)) if known.size > 1 else np.nan
    return Statistics(
        float(known.mean()), spread, float(known.min()), float(known.max()), known.size
    )
