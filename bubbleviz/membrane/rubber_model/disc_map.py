"""The harmonic map of a membrane to the unit disc, and orthogonal polynomials there."""

from __future__ import annotations

import numpy as np
from scipy.sparse.linalg import splu
from scipy.special import eval_jacobi

from bubbleviz.errors import InputError
from bubbleviz.membrane.mesh import MembraneMesh, triangles_across
from bubbleviz.membrane.stiffness import cotangent_laplacian


def disc_map(mesh: MembraneMesh) -> np.ndarray:
    """Harmonic map of the nodes to the unit disc, (n, 2).

    The rim goes to the circle by its length, with azimuths kept in the mean, so that all meshes of
    a surface have nearly the same map.

    Raises InputError: triangles are turned over, which badly shaped ones cause.
    """
    loop = _rim_loop(mesh)
    rim = mesh.nodes[loop]
    sides = np.linalg.norm(np.roll(rim, -1, axis=0) - rim, axis=1)
    angle = 2.0 * np.pi * (np.cumsum(sides) - sides) / sides.sum()
    azimuth = np.arctan2(rim[:, 1], rim[:, 0])
    angle += np.angle(np.sum((sides + np.roll(sides, 1)) * np.exp(1j * (azimuth - angle))))
    disc = np.empty((len(mesh.nodes), 2))
    disc[loop] = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    inner = np.setdiff1d(np.arange(len(mesh.nodes)), loop)
    rows = cotangent_laplacian(mesh)[inner]
    disc[inner] = splu(rows[:, inner].tocsc()).solve(-(rows[:, loop] @ disc[loop]))
    edges = disc[mesh.triangles[:, 1:]] - disc[mesh.triangles[:, :1]]
    if not (np.linalg.det(edges) > 0.0).all():
        raise InputError("membrane mesh: triangles too badly shaped; remesh it evenly")
    return disc


def _rim_loop(mesh: MembraneMesh) -> np.ndarray:
    """Nodes of the open boundary in their order, counter-clockwise seen from outside."""
    triangle, corner = np.nonzero(triangles_across(mesh.triangles) < 0)
    starts = mesh.triangles[triangle, (corner + 1) % 3]
    after = np.full(len(mesh.nodes), -1)
    after[starts] = mesh.triangles[triangle, (corner + 2) % 3]
    loop = [int(starts[0])]
    while after[loop[-1]] != loop[0]:
        loop.append(int(after[loop[-1]]))
    return np.array(loop)


def zernike(at: np.ndarray, degree: int) -> np.ndarray:
    """Zernike polynomials up to a degree at points (k, 2) of the unit disc, (k, p).

    Their mean squares over the disc are 1, their mean products 0.
    """
    z = at[:, 0] + 1j * at[:, 1]
    square = np.abs(z) ** 2
    columns = []
    for m in range(degree + 1):
        turn = z**m
        for n in range(m, degree + 1, 2):
            radial = np.sqrt((n + 1.0) * (2.0 if m else 1.0))
            radial = radial * eval_jacobi((n - m) // 2, 0, m, 2.0 * square - 1.0)
            columns += [radial * turn.real, radial * turn.imag] if m else [radial]
    return np.stack(columns, axis=1)
