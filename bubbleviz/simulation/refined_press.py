"""Presses into the exact membrane on a mesh made finer where an object touches, most at its edges.

The forward model holds nodes. Where an edge of the object lies between them it cuts into the
membrane, so that on an even mesh the contact is smaller than the object by half a triangle, and
nodes catch on the edge, which is then no longer without friction. Here edges have a radius, and
the mesh is fine enough to slide over them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.refine import refinement
from bubbleviz.membrane.rubber_model.object_surface import MOST_TURN_RAD, ObjectSurface
from bubbleviz.membrane.rubber_model.rubber_contact import RubberContact
from bubbleviz.membrane.rubber_model.rubber_forward import PressStart, RubberForward
from bubbleviz.membrane.rubber_model.rubber_membrane import RubberMembrane
from bubbleviz.rigid_object import RigidObject

EDGE_RADIUS_M = 5e-4
"""Of objects' edges: those of printed and machined parts, about as thick as the rubber is."""

_LEVELS = 4  # how often triangles are cut at most


class RefinedPress(NamedTuple):
    """A press and the mesh it was found on."""

    mesh: MembraneMesh
    contact: RubberContact


def refined_press(
    # the membrane on a mesh whose nodes are on the facets of `mesh`, which it may move a little
    rubber_on: Callable[[MembraneMesh], RubberMembrane],
    gas_on: Callable[[MembraneMesh], Gas],  # the gas behind it
    mesh: MembraneMesh,  # to begin with
    obj: RigidObject,
    T_B_O: np.ndarray,  # (4, 4)
) -> RefinedPress:
    """Press an object; the contact may not have converged."""

    def forward_on(mesh: MembraneMesh) -> RubberForward:
        rubber = rubber_on(mesh)
        return RubberForward(rubber, gas_on(rubber.mesh), EDGE_RADIUS_M)

    surface = ObjectSurface(obj, EDGE_RADIUS_M)
    forward = forward_on(mesh)
    contact = forward.press(obj, T_B_O, quick=True)
    for level in range(_LEVELS):
        cut = _coarse(forward.mesh, contact, surface, T_B_O, everywhere=level == 0)
        if not cut.any():
            break
        finer = refinement(mesh, cut)
        mesh, forward = finer.mesh, forward_on(finer.mesh)
        near = PressStart(
            finer.values(contact.displacement_3d_m), finer.values(contact.contact_pressure_pa)
        )
        contact = forward.press(obj, T_B_O, near, quick=True)
    if not contact.converged:
        contact = forward.press(obj, T_B_O)
    return RefinedPress(forward.mesh, contact)


def _coarse(
    mesh: MembraneMesh,
    found: RubberContact,
    surface: ObjectSurface,
    T_B_O: np.ndarray,
    everywhere: bool,
) -> np.ndarray:
    """Touching triangles (m,) bool that are too large for the edge they lie on, or all that touch.

    With those beside them, for a contact grows as its edge is resolved.
    """
    pressed = MembraneMesh(mesh.deformed(found.displacement_3d_m), mesh.triangles, mesh.rim)
    cut = (found.contact_pressure_pa > 0.0)[mesh.triangles].any(axis=1)
    if not everywhere:
        cut &= surface.turn_along(pressed, T_B_O, 2.0 * mesh.edge_length) > MOST_TURN_RAD
    beside = np.zeros(len(mesh.nodes), bool)
    beside[mesh.triangles[cut]] = True
    chosen: np.ndarray = beside[mesh.triangles].any(axis=1)
    return chosen
