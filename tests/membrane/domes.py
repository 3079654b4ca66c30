"""Domes to press into, and a plate to press with."""

import numpy as np

from bubbleviz.membrane import Gas, RubberMembrane, mesh_cap, spherical_cap
from bubbleviz.rigid_object import RigidObject

A, H, GAUGE, AIR, CHAMBER = 0.045, 0.020, 2500.0, 101_325.0, 3e-4
"""Rim radius and height of the dome, m; gauge and atmospheric pressure, Pa; gas behind it, m³."""
TENSION = GAUGE * (A**2 + H**2) / (4 * H)
CAP = spherical_cap(A, H)


def gas_of(mesh, gauge=GAUGE):
    return Gas(AIR + gauge, CHAMBER + mesh.cap_volume(), mesh.areas, -gauge, AIR)


def dome(nodes, prestretch=1.2, slack=None):
    """The membrane, and the gas behind it."""
    mesh = mesh_cap(CAP, nodes)
    return RubberMembrane.uniform(mesh, GAUGE, TENSION, prestretch, slack), gas_of(mesh)


def pose(x=0.0, y=0.0, z=H, twist=0.0):
    c, s = np.cos(twist), np.sin(twist)
    T = np.eye(4)
    T[:2, :2] = [[c, -s], [s, c]]
    T[:3, 3] = x, y, z
    return T


def force(contact):
    """Of the object on the membrane, into the sensor, N."""
    return -contact.nodal_force_n.sum(axis=0)[2]


def unbalanced_n(membrane, contact):
    """Sum of the forces of contact, gas, springs and f_rest on the nodes that move, (3,), N."""
    x = membrane.mesh.nodes + contact.displacement_3d_m
    gauge = membrane.gauge_pressure_pa + contact.gas_pressure_change_pa
    return (contact.nodal_force_n - membrane.residual(x, gauge))[membrane.moving].sum(axis=0)


def plate(half=0.2, thickness=0.01):
    x = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    corners = np.vstack([np.c_[x, np.zeros(4)], np.c_[x, np.full(4, thickness)]])
    sides = [[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]]
    for i in range(4):
        j = (i + 1) % 4
        sides += [[i, j, j + 4], [i, j + 4, i + 4]]
    return RigidObject("plate", corners, np.array(sides))
