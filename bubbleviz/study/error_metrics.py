"""How far an estimate is from the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.camera.triangle_scene import TriangleScene
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.pipeline import Pipeline
from bubbleviz.result import Estimate, Result
from bubbleviz.simulation.synthetic_source import Truth


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
    force_error_relative : float
        Length of the difference of the force vectors over the length of the true one.
    cop_error_m : float
        Between centres of pressure; NaN where no contact was found.
    displacement_rms_m : float
        Over the estimator's nodes.
    gas_error_pa : float
        Of p_v.
    """

    iou: float
    iou_best_threshold: float
    force_error_relative: float
    cop_error_m: float
    displacement_rms_m: float
    gas_error_pa: float


class Judge:
    """Compares estimates on one mesh with truths on another of the same surface.

    Parameters
    ----------
    pipeline : Pipeline
        Whose results are judged.
    truth_mesh : MembraneMesh
    """

    def __init__(self, pipeline: Pipeline, truth_mesh: MembraneMesh) -> None:
        self._view = pipeline.model.view
        scene = TriangleScene(truth_mesh.nodes, truth_mesh.triangles)
        _, triangle, self._barycentric = scene.closest(pipeline.mesh.nodes)
        self._corners = truth_mesh.triangles[triangle]

    def displacement_m(self, truth: Truth) -> np.ndarray:
        """True displacement (n,) at the estimator's nodes, m."""
        return np.einsum("ij,ij->i", truth.displacement_m[self._corners], self._barycentric)

    def errors(self, result: Result, truth: Truth, stride: int = 1) -> Errors:
        """Errors of a result with an estimate, a patch and its pixels."""
        estimate, patch = result.estimate, result.patch
        if estimate is None or patch is None or patch.pixel_mask is None:
            raise ValueError("the result lacks the estimate, the patch or its pixels")
        difference = estimate.displacement_m - self.displacement_m(truth)
        force = np.linalg.norm(truth.force_n)
        seen = truth.patch_mask[::stride, ::stride]
        return Errors(
            iou=iou(patch.pixel_mask, seen),
            iou_best_threshold=self._best_iou(estimate, seen),
            force_error_relative=float(np.linalg.norm(patch.force_n - truth.force_n) / force),
            cop_error_m=float(
                np.linalg.norm(patch.center_of_pressure_m - truth.center_of_pressure_m)
            ),
            displacement_rms_m=float(np.sqrt(np.mean(difference**2))),
            gas_error_pa=abs(estimate.gas_pressure_change_pa - truth.gas_pressure_change_pa),
        )

    def _best_iou(self, estimate: Estimate, seen: np.ndarray) -> float:
        """Largest IoU over all thresholds of the contact pressure."""
        hits = self._view.hits(estimate.motion_m)
        pressure = estimate.contact_pressure_pa[self._view.mesh.triangles[hits.triangle]]
        values = np.einsum("ij,ij->i", hits.barycentric, pressure)
        order = np.argsort(-values)
        right = np.cumsum(seen.ravel()[hits.ray[order]])
        wrong = np.arange(1, len(order) + 1) - right
        return float(np.max(right / (np.count_nonzero(seen) + wrong), initial=0.0))


def iou(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of two masks; 1 where both are empty."""
    union = np.count_nonzero(a | b)
    return np.count_nonzero(a & b) / union if union else 1.0
