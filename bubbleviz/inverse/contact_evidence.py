"""Which connected parts of an estimated pressure are contact, each by evidence of its own."""

from __future__ import annotations

import numpy as np

from bubbleviz.inverse.contact_problem import ContactPressure
from bubbleviz.inverse.detection import universal_threshold
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.mesh_graph import connected_parts

MISPLACED_LOAD = 0.15
"""Share of the largest contact's load that the exact membrane misplaces on a real sensor while it
is being loaded: in the one real press, single nodes far from the contact carry up to 0.14 of it in
frames that are solved by themselves; the rest is margin. The depth camera's temporal filter mixes
images of a moving membrane, which no shape in equilibrium explains."""


def _substantial(mesh: MembraneMesh, pressure: np.ndarray) -> np.ndarray:
    """Nodes (n,) bool of the parts of a pressure (n,) that carry more than the misplaced load."""
    touching = pressure > 0.0
    count, part = connected_parts(mesh.rings, touching)
    loads = np.bincount(part, (mesh.areas * pressure)[touching], minlength=count)
    touching[touching] = (loads >= MISPLACED_LOAD * loads.max(initial=0.0))[part]
    return touching


def evident(mesh: MembraneMesh, contact: ContactPressure) -> np.ndarray:
    """Nodes (n,) bool of the parts that are contact; the part with the largest load always is one.

    Another one has to be substantial, and to carry more than noise puts at any of the n nodes.
    """
    found = _substantial(mesh, contact.pressure)
    count, part = connected_parts(mesh.rings, found)
    if count < 2:
        return found
    nodes = np.flatnonzero(found)
    own = part == np.arange(count)[:, None]  # (count, nodes)
    loads, rows = own @ (mesh.areas * contact.pressure)[nodes], own * mesh.areas[nodes]
    where = np.searchsorted(contact.nodes, nodes)
    covariance = contact.covariance[np.ix_(where, where)]
    sigma = np.sqrt(np.einsum("ki,ij,kj->k", rows, covariance, rows))
    kept = [
        load >= universal_threshold(each, len(mesh.free))
        for load, each in zip(loads, sigma, strict=True)
    ]
    kept[np.argmax(loads)] = True
    found[nodes] = np.array(kept)[part]
    return found
