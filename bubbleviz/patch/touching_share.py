"""How much of its cell a node of a contact covers."""

from __future__ import annotations

import numpy as np

from bubbleviz.membrane.mesh import MembraneMesh


def touching_share(mesh: MembraneMesh, contact_pressure_pa: np.ndarray) -> np.ndarray:
    """Share (n,) of each node's cell that touches, 0 to 1; the edge is where it is one half.

    A node touches as soon as the object reaches a part of its cell, and carries the load of that
    part alone. What its whole cell would carry is taken from the nodes beside it that no free node
    is next to; on a sharp edge it carries a line load on top, and all of its cell counts.

    Parameters
    ----------
    mesh : MembraneMesh
    contact_pressure_pa : (n,) array
        Contact pressure at the nodes: load over area.
    """
    touching = contact_pressure_pa > 0.0
    a, b = mesh.triangles.ravel(), np.roll(mesh.triangles, -1, axis=1).ravel()
    a, b = np.concatenate([a, b]), np.concatenate([b, a])
    inner = touching.copy()
    inner[a[~touching[b]]] = False
    whole = np.zeros(len(touching))
    np.maximum.at(whole, a, np.where(inner[b], contact_pressure_pa[b], 0.0))
    share = touching.astype(float)
    edge = touching & ~inner & (whole > 0.0)
    share[edge] = np.minimum(contact_pressure_pa[edge] / whole[edge], 1.0)
    return share
