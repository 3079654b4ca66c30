"""Lines on the displayed surface."""

import numpy as np
import pytest

from bubbleviz.membrane import mesh_cap, refinement, spherical_cap
from bubbleviz.result import Estimate, FineContact, Patch
from bubbleviz_ui.model.units import Units
from bubbleviz_ui.view3d.layer import Surface

RADIUS_M, SUNK_M = 0.004, 0.003
"""Radius of a circle smaller than the mesh resolves, and shift of the membrane."""


def from_center(points):
    return np.hypot(points[:, 0] - 0.011, points[:, 1] - 0.004)


def test_edge_of_a_refined_patch_is_drawn_at_its_position():
    mesh = mesh_cap(spherical_cap(0.045, 0.02), 200)
    finer = refinement(mesh)
    out = from_center(finer.mesh.nodes)
    zero = np.zeros(len(mesh.nodes))
    down = np.tile([0.0, 0.0, -SUNK_M], (len(mesh.nodes), 1))
    fine = FineContact(finer.mesh, finer.ends, 1e-3, 0.0 * out, finer.values(down), 1e-3)
    estimate = Estimate("ok", zero, zero, 0.0, 0.0, 0.0, displacement_3d_m=down, fine=fine)
    level = RADIUS_M - out
    patch = Patch(0.0, level[: len(zero)], zero[:3], zero[:3], 1e-5, fine_level=level)
    surface = Surface(Units())
    surface.set_mesh(mesh)
    surface.draw(estimate, 1.0)
    error = {}
    for name, pieces in (
        ("fine", surface.edge(estimate, patch)),
        ("coarse", surface.line(patch.level)),
    ):
        ends = pieces.reshape(-1, 3)
        error[name] = np.abs(from_center(ends) - RADIUS_M).mean()
        assert ends[:, 2] == pytest.approx(0.02 - SUNK_M, abs=4e-3)
    assert error["fine"] < 0.6 * error["coarse"]
    band = surface.edge(estimate, patch, (0.001, -0.001)).reshape(-1, 3)
    assert from_center(band).min() < RADIUS_M < from_center(band).max()
