"""Objects pressed into the exact membrane against the equations of its meridian and conservation."""

from dataclasses import replace

import numpy as np
import pytest

from bubbleviz.errors import SolveError
from bubbleviz.membrane.cap_mesh import EllipsoidalCap, mesh_cap, spherical_cap
from bubbleviz.membrane.forward_model import ForwardModel
from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.rubber import RubberMembrane, inverse_metric
from bubbleviz.membrane.rubber_forward import RubberForward
from bubbleviz.rigid_object import RigidObject, load_object
from bubbleviz.study.accuracy.exact_bubble import Bubble, axial_contact
from bubbleviz.study.rubber_oracle import AxialRubber

A, H, GAUGE, AIR, CHAMBER = 0.045, 0.020, 2500.0, 101_325.0, 3e-4
TENSION = GAUGE * (A**2 + H**2) / (4 * H)
BALL = 0.015  # of the preset


def gas_of(mesh, gauge=GAUGE):
    return Gas(AIR + gauge, CHAMBER + mesh.cap_volume(), mesh.areas)


def dome(nodes, prestretch, slack=None):
    mesh = mesh_cap(spherical_cap(A, H), nodes)
    membrane = RubberMembrane.uniform(mesh, GAUGE, TENSION, prestretch, slack)
    return RubberForward(membrane, gas_of(mesh))


def sheet(nodes, truth):
    """The mesh of a sheet that was flat before it was bulged, from its exact meridian."""
    cap = mesh_cap(spherical_cap(A, H), nodes)
    R = (A**2 + H**2) / (2 * H)
    rest = truth.rest
    angle = np.arctan2(np.hypot(*cap.nodes[:, :2].T), cap.nodes[:, 2] + R - H)
    along = angle / angle.max() * A  # a material circle of the flat sheet for every node
    azimuth = np.arctan2(cap.nodes[:, 1], cap.nodes[:, 0])
    around = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    s = np.concatenate([[0.0], rest.s_m])
    r, z = (
        np.interp(along, s, np.concatenate([[v], w]))
        for v, w in ((0.0, rest.r_m), (rest.z_m[0], rest.z_m))
    )
    z[cap.rim] = 0.0
    mesh = MembraneMesh(np.column_stack([r[:, None] * around, z]), cap.triangles, cap.rim)
    flat = replace(mesh, nodes=np.column_stack([along[:, None] * around / truth.prestretch, 0 * z]))
    gauge = truth.gauge_pressure_pa
    membrane = RubberMembrane(mesh, gauge, inverse_metric(flat), truth.mu_h_n_per_m)
    return RubberForward(membrane, gas_of(mesh, gauge))


def at(x=0.0, y=0.0, z=H):
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def plate(half=0.2, thickness=0.01):
    x = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    corners = np.vstack([np.c_[x, np.zeros(4)], np.c_[x, np.full(4, thickness)]])
    sides = [[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]]
    for i in range(4):
        j = (i + 1) % 4
        sides += [[i, j, j + 4], [i, j + 4, i + 4]]
    return RigidObject("plate", corners, np.array(sides))


def force(contact):
    return -contact.nodal_force_n.sum(axis=0)[2]


def assert_equilibrium(contact):
    assert contact.converged
    assert contact.balance_residual < 1e-6
    assert contact.penetration_m < 1e-8
    assert contact.force_balance_n < 1e-6
    assert contact.contact_pressure_pa.min() >= 0.0


# -- against the equations of the meridian ------------------------------------------------------


@pytest.mark.parametrize(("depth", "ball"), [(0.003, np.inf), (0.009, np.inf), (0.008, BALL)])
def test_dome_pressed_by_plate_and_ball(depth, ball):
    """Stiff rubber (λ = 1.2) on presses to 45 % of the dome's height; the error falls with h²."""
    exact = AxialRubber.dome(A, H, 1.2, GAUGE).press(depth, ball)
    errors = []
    for nodes in (400, 1200):
        obj = load_object("sphere") if np.isfinite(ball) else plate()
        contact = dome(nodes, 1.2).press(obj, at(z=H - depth))
        assert_equilibrium(contact)
        errors.append(
            (
                force(contact) / exact.force_n - 1.0,
                contact.gas_pressure_change_pa / exact.gas_pressure_change_pa - 1.0,
            )
        )
    print(depth, ball, errors)
    assert np.abs(errors[1]).max() < 0.015
    assert np.abs(errors[0]).max() < 0.08
