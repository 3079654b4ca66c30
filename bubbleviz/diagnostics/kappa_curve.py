"""Patch area, and IoU with a known truth, as functions of the patch threshold κ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.camera.membrane_view import MembraneView
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.patch.patch_finder import areas_above, mean_pressure
from bubbleviz.result import Estimate

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
