"""Coulomb's law of dry friction at the nodes of a contact, by return mapping.

A node sticks to the place of the object that it touched, its anchor, as long as that takes no more
than μ times the contact force along the normal. Else it slips: the force is at that bound, against
the way s from the anchor across the normal. With the pull q = −t on the object and any weight r > 0
both are one equation (Alart and Curnier), q = q + r s cut to the length μ f_n, whose derivative
Newton's method takes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bubbleviz.membrane.rubber_model.object_surface import Planes
from bubbleviz.membrane.rubber_model.sparse_factor import Grip

_LEAST_SLIP = 1e-6
"""Of |q + r s| over its bound, less 1: a node that only begins to slip does not turn aside, and a
stiffer tangent is singular to rounding."""


class Friction(NamedTuple):
    """Nodes that stick and slip at some place, near an equilibrium or in it."""

    pull: np.ndarray  # (k, 3), of the nodes on the object across its normals by the law, N
    slip: np.ndarray  # (k, 3), s of nodes that slip, m
    grip: Grip  # for a step from here
    # (k, 3, 3), of the pull across the direction of slip, and as the normal turns, N/m
    stiffness: np.ndarray
    start: np.ndarray  # (k, 3), the part of the pull that this stiffness has added so far, N

    @classmethod
    def at(
        cls,
        # (k, 3), from the nodes' anchors to the nodes, m; NaN where they have none
        away: np.ndarray,
        pull: np.ndarray,  # (k, 3), q so far, N
        load: np.ndarray,  # (k,), f_n, N
        planes: Planes,  # the object's, at the nodes
        coefficient: float,  # μ
        weight: float,  # r, N/m
    ) -> Friction:
        """The law."""
        anchored, normal = np.isfinite(away[:, 0]) & (load > 0.0), planes.normal
        plane = np.eye(3) - normal[:, :, None] * normal[:, None, :]
        s = np.einsum("kij,kj->ki", plane, np.where(anchored[:, None], away, 0.0))
        tried = np.einsum("kij,kj->ki", plane, np.where(anchored[:, None], pull, 0.0)) + weight * s
        size, most = np.linalg.norm(tried, axis=1), coefficient * load
        slips = anchored & (size > most)
        way = np.where(slips[:, None], tried, 0.0) / np.where(slips, size, 1.0)[:, None]
        drag = coefficient * way
        pulled = np.where(slips[:, None], load[:, None] * drag, tried)
        # Slip turns the force: q = μ f_n s/|s|, of which |q + r s| − μ f_n = r |s|.
        turning = plane - way[:, :, None] * way[:, None, :]
        beyond = np.maximum(size - most, _LEAST_SLIP * most)
        turning *= np.where(slips, most * weight / np.where(slips, beyond, 1.0), 0.0)[:, None, None]
        bent = np.einsum("ki,kij->kj", pulled, planes.turn)
        return cls(
            pulled,
            np.where(slips[:, None], s, 0.0),
            Grip(anchored & ~slips, np.where((anchored & ~slips)[:, None], -s, 0.0), drag),
            turning - normal[:, :, None] * bent[:, None, :],
            np.einsum("kij,kj->ki", turning, s),
        )
