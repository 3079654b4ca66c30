"""Friction of contacts that a depth image alone determines.

A depth image does not show friction, but friction moves the membrane: without it, the estimate
would explain that motion by pressure where nothing touches. Each contact has three unknowns: slides
along two directions across its mean normal, and a spin about it. Each is a traction proportional to
the contact pressure, so that its amplitude is the share of Coulomb's friction that acts.
"""

from __future__ import annotations

import numpy as np

from bubbleviz.membrane.mesh_graph import connected_parts

FRICTION = 1.0
"""Standard deviation of the amplitudes: dry latex on common materials has coefficients of friction
between 0.5 and 1.5. On rubber dragged and twisted by another solver, half and twice of it change
the force by 0.2 % in the median and 2.4 % at most at 1 % of depth noise."""

_LEAST_SHARE = 0.25
"""Share of the largest contact's load from which a contact has amplitudes of its own. While the
real press is being loaded, those of single nodes with a tenth of it fitted what the model misses
there, and the solution alternated between two supports."""


def friction_loads(
    x: np.ndarray, area_vectors: np.ndarray, pressure: np.ndarray, rings: np.ndarray
) -> np.ndarray:
    """Forces on the nodes under a unit of each amplitude, (n, 3, 3 contacts), N.

    Contacts that are small beside the largest have no amplitudes.

    Parameters
    ----------
    x : (n, 3) array
        Shape, m.
    area_vectors : (n, 3) array
        Of its nodes, m².
    pressure : (n,) array
        p_c, Pa; connected nodes under pressure are a contact.
    rings : (d, n) int array
        As of `MembraneMesh`.
    """
    touching = pressure > 0.0
    count, contact = connected_parts(rings, touching)
    nodes = np.flatnonzero(touching)
    load = pressure[nodes] * np.linalg.norm(area_vectors[nodes], axis=1)
    loads = np.bincount(contact, load, minlength=count)
    large = np.flatnonzero(loads >= _LEAST_SHARE * loads.max())
    forces = np.zeros((len(x), 3, 3 * len(large)))
    for k, number in enumerate(large):
        own = nodes[contact == number]
        forces[own, :, 3 * k : 3 * k + 3] = _loads(x[own], area_vectors[own], pressure[own])
    return forces


def _loads(x: np.ndarray, area_vectors: np.ndarray, pressure: np.ndarray) -> np.ndarray:
    """Two slides and a spin of one contact of c nodes, (c, 3, 3), N."""
    area = np.linalg.norm(area_vectors, axis=1, keepdims=True)
    load, normal = pressure * area[:, 0], area_vectors / area
    axis = load @ normal
    axis /= np.linalg.norm(axis)
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first /= np.linalg.norm(first)
    spin = np.cross(axis, x - load @ x / load.sum())
    radius = np.sqrt(load @ (spin**2).sum(axis=1) / load.sum())  # 0 of a single node
    spin /= max(radius, np.finfo(float).tiny)
    slides = np.stack([first, np.cross(axis, first)], axis=1)
    along = np.concatenate([np.broadcast_to(slides, (len(x), 3, 2)), spin[:, :, None]], axis=2)
    along = along - normal[:, :, None] * np.einsum("ci,cij->cj", normal, along)[:, None]
    return load[:, None, None] * along
