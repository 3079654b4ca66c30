"""Equilibrium of the linear membrane under given contact and gas pressures (Eq. 5).

It offers what `RubberEquilibrium` and `LinearisedRubber` do, for motion along the normals alone.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse.linalg import SuperLU

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.stiffness import cotangent_laplacian
from bubbleviz.membrane.symmetric_lu import symmetric_lu


class LinearEquilibrium:
    """γ0 L u = A (p_v − p_c) on the free nodes of a mesh; those of its rim stay where they are.

    Parameters
    ----------
    mesh : MembraneMesh
    tension_n_per_m : float
        γ0.
    """

    def __init__(self, mesh: MembraneMesh, tension_n_per_m: float) -> None:
        self._mesh, self._stiffness = mesh, tension_n_per_m * cotangent_laplacian(mesh)
        self._factor = symmetric_lu(self._stiffness[mesh.free][:, mesh.free].tocsc())

    def residual(self, x: np.ndarray, pressure: np.ndarray, gas: float) -> np.ndarray:
        """What the forces at the nodes lack of equilibrium, (n, 3), N.

        Parameters
        ----------
        x : (n, 3) array
            Shape, m.
        pressure : (n,) array
            p_c, Pa.
        gas : float
            p_v, Pa.
        """
        mesh = self._mesh
        u = np.einsum("ij,ij->i", x - mesh.nodes, mesh.normals)
        left: np.ndarray = self._stiffness @ u - mesh.areas * (gas - pressure)
        return left[:, None] * mesh.normals

    def linearised(self, x: np.ndarray, pressure: np.ndarray, gas: float) -> LinearResponse:
        """How it moves at a shape; the same at all of them."""
        return LinearResponse(self._mesh, self._factor, x)


class LinearResponse:
    """Motion of a linear membrane under forces.

    Parameters
    ----------
    mesh : MembraneMesh
    factor : SuperLU
        Of γ0 L on the free nodes.
    x : (n, 3) array
        Shape that it was asked for at, m.
    """

    def __init__(self, mesh: MembraneMesh, factor: SuperLU, x: np.ndarray) -> None:
        self._mesh, self._factor, self.x = mesh, factor, x

    def motion(self, force: np.ndarray) -> np.ndarray:
        """Motion (n, 3) under forces (n, 3) in N, m."""
        moved = self._moved(np.einsum("ij,ij->i", force, self._mesh.normals))
        return moved[:, None] * self._mesh.normals

    def pull(self, force: np.ndarray) -> np.ndarray:
        """What unit contact pressures do against forces (n, 3), (n,)."""
        return self._mesh.areas * self._moved(np.einsum("ij,ij->i", force, self._mesh.normals))

    def responses(self, nodes: np.ndarray) -> np.ndarray:
        """Motion under unit pressures from inside at nodes (c,), (3n, c), m/Pa."""
        load = np.zeros((len(self._mesh.nodes), len(nodes)))
        load[nodes, np.arange(len(nodes))] = self._mesh.areas[nodes]
        moved = self._moved(load)
        return (self._mesh.normals[:, :, None] * moved[:, None]).reshape(-1, len(nodes))

    def _moved(self, load: np.ndarray) -> np.ndarray:
        """Displacement along the normals under loads (n, …) along them, of the same shape."""
        moved, free = np.zeros_like(load), self._mesh.free
        moved[free] = self._factor.solve(load[free])
        return moved
