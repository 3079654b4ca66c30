"""The oracle of sticking and slipping objects: membrane motion follows from object motion."""

import numpy as np
import pytest
from domes import CAP, GAUGE, TENSION, gas_of

from bubbleviz.membrane import RubberMembrane, mesh_cap
from tests.oracles.dragged_press import DraggedPress, dragged_truths

FRAMES = 12


def rubber(mesh):
    return RubberMembrane.uniform(mesh, GAUGE, TENSION, 1.2)


def simulate(press, frames=FRAMES):
    mesh = mesh_cap(CAP, 200)
    return mesh, list(dragged_truths(rubber, gas_of, mesh, press, frames))


def test_sticking_ball_drags_its_contact():
    mesh, found = simulate(DraggedPress("sphere", 0.004, drag_m=0.001, friction=5.0))
    assert len(found) == FRAMES and len(found[-1].mesh.nodes) > len(mesh.nodes)
    assert np.isnan(found[0].slip_share(1e-6)) and np.isnan(found[0].center_m).all()
    pressed = next(k for k in range(FRAMES) if found[k].T_B_O[0, 3] > 1e-9) - 1
    before, after = found[pressed], found[-1]
    assert before.force_n[2] < -0.5 and np.abs(before.force_n[0]) < 0.02 * -before.force_n[2]
    assert after.force_n[0] > 0.3 * -after.force_n[2]
    held = (after.areas_m2 > 0.0) & (after.slipped_m == 0.0) & (before.areas_m2 > 0.0)
    way = (after.displacement_m - before.displacement_m)[held]
    np.testing.assert_allclose(way[:, :2].mean(axis=0), [0.001, 0.0], atol=5e-5)
    assert after.center_m[0] - before.center_m[0] == pytest.approx(0.001, rel=0.3)
    assert after.slip_share(5e-5) < 0.25


def test_twisted_ball_slips_progressively_at_low_friction():
    _, found = simulate(DraggedPress("sphere", 0.004, twist_rad=np.radians(20.0), friction=0.3))
    shares = np.array([truth.slip_share(5e-5) for truth in found[-5:]])
    assert (np.diff(shares) > -1e-3).all() and shares[0] < 0.1 < 0.3 < shares[-1]
    last = found[-1]
    torque = last.torque_nm(last.center_m)
    assert torque[2] > 5 * np.abs(torque[:2]).max()
    normal = np.maximum(-np.einsum("ij,ij->i", last.nodal_force_n, last.normals), 0.0)
    arm = np.linalg.norm(last.mesh.deformed(last.displacement_m) - last.center_m, axis=1)
    assert 0.5 < torque[2] / (0.3 * normal @ arm) <= 1.0 + 1e-6  # no more than friction bears
