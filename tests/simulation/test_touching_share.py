"""The share of a node's cell in contact, against presses with exact contact radius."""

import numpy as np

from bubbleviz.inverse import area_above, touching_share
from bubbleviz.membrane import RubberForward, mesh_cap
from bubbleviz.rigid_object import load_object
from tests.membrane.domes import CAP, GAUGE, A, H, dome, pose
from tests.oracles.rubber_oracle import AxialRubber

DEPTH, BALL = 0.006, 0.015


def exact_area():
    """Of the contact on the surface at rest, m², by the equations of the meridian."""
    press = AxialRubber.dome(A, H, 1.2, GAUGE).press(DEPTH, BALL)
    return press.contact_area_m2((A**2 + H**2) / (2.0 * H))


def pressed(nodes):
    """Mesh and contact pressure of the ball."""
    model = RubberForward(*dome(nodes))
    contact = model.press(load_object("sphere"), pose(z=H - DEPTH))
    return model.mesh, contact.contact_pressure_pa


def test_contact_area_of_a_ball_equals_the_analytic_one():
    """Its edge is anywhere between nodes, so the error vanishes in the mean over several meshes."""
    exact_m2, errors, by_nodes = exact_area(), [], []
    for nodes in (1200, 1400, 1600, 1800, 2000):
        mesh, pressure = pressed(nodes)
        share = touching_share(mesh, pressure)
        np.testing.assert_array_equal(share > 0.0, pressure > 0.0)
        errors.append(area_above(mesh, share, 0.5) / exact_m2 - 1.0)
        by_nodes.append(area_above(mesh, (pressure > 0.0).astype(float), 0.5) / exact_m2 - 1.0)
    assert abs(np.mean(errors)) < 0.04
    assert np.abs(errors).max() < 0.12
    assert np.mean(by_nodes) > 0.15  # every node that touches at all


def test_line_loads_and_contacts_without_interior_count_fully():
    mesh = mesh_cap(CAP, 400)
    out = np.hypot(*mesh.nodes[:, :2].T)
    disc = np.where(out < 0.02, 1.0, 0.0)
    touching = disc > 0.0
    edge = touching & (out > 0.016)
    np.testing.assert_array_equal(touching_share(mesh, np.where(edge, 30.0, disc)), disc)
    few = np.where(out < 1e-6, 7.0, 0.0)
    np.testing.assert_array_equal(touching_share(mesh, few), few > 0.0)
    assert not touching_share(mesh, np.zeros(len(out))).any()


def test_single_nodes_without_load_are_no_hole_in_a_face():
    """As on the flat end of a bar; a hole with a node that only free nodes surround is one."""
    mesh = mesh_cap(CAP, 400)
    out = np.hypot(*mesh.nodes[:, :2].T)
    face = np.where(out < 0.02, 1.0, 0.0)
    whole = touching_share(mesh, face)
    lifted = face.copy()
    lifted[np.flatnonzero(out < 0.012)[::7]] = 0.0
    np.testing.assert_array_equal(touching_share(mesh, lifted), whole)
    ring = np.where(out > 0.01, face, 0.0)
    assert not touching_share(mesh, ring)[out < 0.01].any()
