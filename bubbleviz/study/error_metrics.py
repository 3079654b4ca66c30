"""How far an estimate is from the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.camera.triangle_scene import TriangleScene
from bubbleviz.diagnostics.overlap import iou
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.pipeline import Pipeline
from bubbleviz.result import Result
from bubbleviz.simulation.truth_bank import Sighting


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Errors of one frame; NaN where there is no answer.

    Attributes
    ----------
    iou : float
        Of the patch's pixels, intersection over union.
    force_error_relative : float
        Length of the difference of the force vectors over the length of the true one.
    force_excess_relative : float
        |F| over the true one, less 1.
    area_error_relative : float
        Of the patch's area, which is counted on the reference surface.
    cop_error_m : float
        Between centres of pressure.
    displacement_rms_m : float
        Over the estimator's nodes.
    gas_error_pa : float
        Of p_v.
    """

    iou: float = np.nan
    force_error_relative: float = np.nan
    force_excess_relative: float = np.nan
    area_error_relative: float = np.nan
    cop_error_m: float = np.nan
    displacement_rms_m: float = np.nan
    gas_error_pa: float = np.nan


def errors_of(pipeline: Pipeline, result: Result, sighting: Sighting, stride: int = 1) -> Errors:
    """Errors of a pipeline's result with an estimate, a patch and its pixels.

    The truth is on another mesh of the same surface; the pixels are every stride-th of its image.
    """
    estimate, patch, truth = result.estimate, result.patch, sighting.truth
    if estimate is None or patch is None or patch.pixel_mask is None:
        raise ValueError("the result lacks the estimate, the patch or its pixels")
    expected = at_nodes(pipeline.mesh, sighting.mesh, truth.displacement_m)
    force = float(np.linalg.norm(truth.force_n))
    away = patch.center_of_pressure_m - truth.center_of_pressure_m
    return Errors(
        iou=iou(patch.pixel_mask, truth.patch_mask[::stride, ::stride]),
        force_error_relative=float(np.linalg.norm(patch.force_n - truth.force_n)) / force,
        force_excess_relative=float(np.linalg.norm(patch.force_n)) / force - 1.0,
        area_error_relative=patch.area_m2 / truth.patch_area_m2 - 1.0,
        cop_error_m=float(np.linalg.norm(away)),
        displacement_rms_m=float(np.sqrt(np.mean((estimate.displacement_m - expected) ** 2))),
        gas_error_pa=abs(estimate.gas_pressure_change_pa - truth.gas_pressure_change_pa),
    )


def at_nodes(mesh: MembraneMesh, other: MembraneMesh, field: np.ndarray) -> np.ndarray:
    """Field (m, …) of the nodes of another mesh of the same surface, at those of a mesh, (n, …)."""
    found = TriangleScene(other.nodes, other.triangles).closest(mesh.nodes)
    corners = field[other.triangles[found.triangle]]
    values: np.ndarray = np.einsum("ij...,ij->i...", corners, found.barycentric)
    return values
