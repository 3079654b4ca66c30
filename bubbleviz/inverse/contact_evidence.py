"""Which connected parts of an estimated pressure are contact, each by evidence of its own."""

from __future__ import annotations

import numpy as np

from bubbleviz.inverse.contact_problem import ContactPressure
from bubbleviz.inverse.detection import universal_threshold
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.mesh_graph import connected_parts

MISPLACED_LOAD = 0.1
"""Share of the load that the exact membrane misplaces on a real sensor while it is being loaded: in
the one real press, single nodes far from the contact carry up to 0.08 of it. The depth camera's
temporal filter mixes images of a moving membrane, which no shape in equilibrium explains."""


def evident(mesh: MembraneMesh, contact: ContactPressure) -> np.ndarray:
    """Nodes (n,) bool of the parts that are contact; the part with the largest load always is one.

    Another one has to carry more than the model's error could put there, and more than noise puts
    at any of the n nodes.
    """
    nodes, load = contact.nodes, mesh.areas * contact.pressure
    touching = contact.pressure > 0.0
    count, part = connected_parts(mesh.rings, touching)
    if count < 2:
        return touching
    own = part == np.arange(count)[:, None]  # (count, s)
    loads, rows = own @ load[nodes], own * mesh.areas[nodes]
    covariance = contact.covariance[: len(nodes), : len(nodes)]
    sigma = np.sqrt(np.einsum("ki,ij,kj->k", rows, covariance, rows))
    evident = loads >= MISPLACED_LOAD * loads.sum()
    evident &= loads >= universal_threshold(sigma, len(mesh.free))
    evident[np.argmax(loads)] = True
    touching[nodes] = evident[part]
    return touching
