"""How far an estimate is from the truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from bubbleviz.camera.triangle_scene import TriangleScene
from bubbleviz.membrane.level_line import level_line
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.patch.touching_share import touching_share
from bubbleviz.pipeline import Pipeline
from bubbleviz.result import Estimate, Patch, Result

if TYPE_CHECKING:
    from bubbleviz.study.truth_bank import Sighting  # the window compares masks without it


@dataclass(frozen=True)
class Errors:
    """Errors of one frame.

    Attributes
    ----------
    iou : float
        Of the patch's pixels, intersection over union.
    iou_best_threshold : float
        Of the one pressure threshold that an oracle picks for this very frame, to judge the rule
        for the patch by.
    iou_on_mesh : float
        Of the true edge, drawn through the nodes of the estimator's mesh: what the mesh allows.
    force_error_relative : float
        Length of the difference of the force vectors over the length of the true one.
    force_excess_relative : float
        |F| over the true one, less 1.
    area_error_relative : float
        Of the patch's area, which is counted on the reference surface.
    edge_in_band : float
        Share of the true edge that lies in the band around the patch's; NaN where it has none.
    cop_error_m : float
        Between centres of pressure; NaN where no contact was found.
    displacement_rms_m : float
        Over the estimator's nodes.
    gas_error_pa : float
        Of p_v.
    """

    iou: float
    iou_best_threshold: float
    iou_on_mesh: float
    force_error_relative: float
    force_excess_relative: float
    area_error_relative: float
    edge_in_band: float
    cop_error_m: float
    displacement_rms_m: float
    gas_error_pa: float


class Judge:
    """Compares estimates on one mesh with truths on others of the same surface.

    Parameters
    ----------
    pipeline : Pipeline
        Whose results are judged.
    """

    def __init__(self, pipeline: Pipeline) -> None:
        self._view = pipeline.model.view

    def displacement_m(self, sighting: Sighting) -> np.ndarray:
        """True displacement (n,) at the estimator's nodes, m."""
        return at_nodes(self._view.mesh, sighting.mesh, sighting.truth.displacement_m)

    def _on_mesh(self, sighting: Sighting, stride: int) -> float:
        """IoU of the true edge drawn by its signed distance from the estimator's nodes."""
        own, mesh, truth = self._view.mesh, sighting.mesh, sighting.truth
        share = touching_share(mesh, truth.contact_pressure_pa) - 0.5
        edge = level_line(mesh.nodes, mesh.corners, share)
        away = cKDTree(np.concatenate([edge[:, 0], edge.mean(axis=1)])).query(own.nodes)[0]
        level = np.where(at_nodes(own, mesh, share) > 0.0, away, -away)
        drawn = self._view.above(at_nodes(own, mesh, truth.displacement_3d_m), level, 0.0)
        return iou(drawn[::stride, ::stride], truth.patch_mask[::stride, ::stride])

    def errors(self, result: Result, sighting: Sighting, stride: int = 1) -> Errors:
        """Errors of a result with an estimate, a patch and its pixels."""
        estimate, patch, truth = result.estimate, result.patch, sighting.truth
        if estimate is None or patch is None or patch.pixel_mask is None:
            raise ValueError("the result lacks the estimate, the patch or its pixels")
        difference = estimate.displacement_m - self.displacement_m(sighting)
        force = float(np.linalg.norm(truth.force_n))
        seen = truth.patch_mask[::stride, ::stride]
        return Errors(
            iou=iou(patch.pixel_mask, seen),
            iou_best_threshold=self._best_iou(estimate, seen),
            iou_on_mesh=self._on_mesh(sighting, stride),
            force_error_relative=float(np.linalg.norm(patch.force_n - truth.force_n)) / force,
            force_excess_relative=float(np.linalg.norm(patch.force_n)) / force - 1.0,
            area_error_relative=patch.area_m2 / truth.patch_area_m2 - 1.0,
            edge_in_band=self._edge_in_band(estimate, patch, seen),
            cop_error_m=float(
                np.linalg.norm(patch.center_of_pressure_m - truth.center_of_pressure_m)
            ),
            displacement_rms_m=float(np.sqrt(np.mean(difference**2))),
            gas_error_pa=abs(estimate.gas_pressure_change_pa - truth.gas_pressure_change_pa),
        )

    def _edge_in_band(self, estimate: Estimate, patch: Patch, seen: np.ndarray) -> float:
        """Share of the pixels beside the edge of a mask that the band covers."""
        edge = ndimage.binary_dilation(seen) ^ ndimage.binary_erosion(seen)
        band = patch.edge_half_width_m
        if np.isnan(band) or not edge.any():
            return np.nan
        inner, outer = (self._view.patch_pixels(estimate, patch, level) for level in (band, -band))
        return float(np.count_nonzero(edge & outer & ~inner) / np.count_nonzero(edge))

    def _best_iou(self, estimate: Estimate, seen: np.ndarray) -> float:
        """Largest IoU over all thresholds of the contact pressure."""
        hits = self._view.hits(estimate.motion_m)
        pressure = estimate.contact_pressure_pa[self._view.mesh.triangles[hits.triangle]]
        values = np.einsum("ij,ij->i", hits.barycentric, pressure)
        order = np.argsort(-values)
        right = np.cumsum(seen.ravel()[hits.ray[order]])
        wrong = np.arange(1, len(order) + 1) - right
        return float(np.max(right / (np.count_nonzero(seen) + wrong), initial=0.0))


def at_nodes(mesh: MembraneMesh, other: MembraneMesh, field: np.ndarray) -> np.ndarray:
    """Field (m, …) of the nodes of another mesh of the same surface, at those of a mesh, (n, …)."""
    found = TriangleScene(other.nodes, other.triangles).closest(mesh.nodes)
    corners = field[other.triangles[found.triangle]]
    values: np.ndarray = np.einsum("ij...,ij->i...", corners, found.barycentric)
    return values


def iou(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of two masks; 1 where both are empty."""
    union = np.count_nonzero(a | b)
    return np.count_nonzero(a & b) / union if union else 1.0
