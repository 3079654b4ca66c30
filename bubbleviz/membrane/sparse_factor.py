"""Factorised tangent stiffness, with a fill-reducing order found once."""

from __future__ import annotations

import threading
from functools import partial
from typing import Literal, NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

# Sparse factorisation of symmetric matrices.


class _Dropped(threading.local):
    """Factors of this thread that were dropped in another one."""

    def __init__(self) -> None:
        self.factors: list[SuperLU] = []


_DROPPED = _Dropped()


def symmetric_lu(
    matrix: sparse.csc_array[np.float64],  # (n, n) sparse
    # of elimination, as in `splu`; "NATURAL" where the rows have one that is good
    order: Literal["NATURAL", "MMD_AT_PLUS_A"] = "MMD_AT_PLUS_A",
) -> SuperLU:
    """Factorise a symmetric matrix that needs no pivoting, as a positive definite one.

    Takes a fraction of the time of `splu` as it is, whose order (COLAMD) knows no symmetry.

    Raises RuntimeError: the matrix is singular.
    """
    _DROPPED.factors.clear()
    return splu(
        matrix,
        permc_spec=order,
        diag_pivot_thresh=0.0,  # no pivoting: keeps the symmetric order
        relax=1,  # a mesh fills little: supernodes made larger by zeros cost more than they save
        panel_size=1,
        options={"SymmetricMode": True},
    )


def elimination_order(pattern: sparse.csc_array) -> np.ndarray:
    """Order (n,) of the rows of a symmetric pattern of 3×3 blocks that fills little."""
    nodes = pattern[::3][:, ::3].astype(bool).astype(float)
    diagonal = sparse.diags_array(np.full(nodes.shape[0], float(pattern.shape[0])))
    order = np.argsort(symmetric_lu((nodes + diagonal).tocsc()).perm_c)
    return (3 * order[:, None] + np.arange(3)).ravel()


def condensed(
    matrix: sparse.csc_array,  # (n, n), symmetric, of 3×3 blocks
    vector: np.ndarray,  # (n,)
    kept: np.ndarray,  # (k,) int, rows; not all
) -> np.ndarray:
    """Schur complement (1 + k, 1 + k) of [[0, vᵀ], [v, K]] onto its first row and the kept ones.

    It is the product of the ends of the factors L and U if these rows are eliminated last. SuperLU
    does not put others between them, as the first one is coupled to every other row.
    """
    size = len(vector)
    free = np.setdiff1d(np.arange(size), kept)
    free = free[elimination_order(matrix[free][:, free])]
    column = sparse.csc_array((vector, np.arange(size), [0, size]), shape=(size, 1))
    corner = sparse.csc_array(([0.0], [0], [0, 1]), shape=(1, 1))
    both = sparse.block_array([[matrix, column], [column.T.tocsc(), corner]], format="csc")
    order, first = np.concatenate([free, [size], kept]), len(free)
    lu = symmetric_lu(sparse.csc_array(both[order][:, order]), "NATURAL")
    return np.asarray((lu.L[first:, first:] @ lu.U[first:, first:]).toarray())


class Factoriser:
    """Factorises matrices of one symmetric pattern of 3×3 blocks (one a node).

    The order is found once, and for nodes instead of single rows, which takes a third of the time
    of `splu` with its own order (COLAMD).

    Parameters
    ----------
    pattern : sparse array
        A matrix of that pattern, in CSC with sorted indices; its values do not matter.
    rows : int array, optional
        Places of its unknowns in the vectors that are solved for; the others stay 0.
    """

    def __init__(self, pattern: sparse.csc_array, rows: np.ndarray | None = None) -> None:
        data = np.arange(1.0, pattern.nnz + 1.0)
        numbered = sparse.csc_array((data, pattern.indices, pattern.indptr), shape=pattern.shape)
        self._order = elimination_order(numbered)
        permuted = numbered[self._order][:, self._order].tocsc()
        permuted.sort_indices()
        self._places = permuted.data.astype(np.int64) - 1
        self._indices, self._indptr = permuted.indices, permuted.indptr
        self._rows = self._order if rows is None else rows[self._order]

    def factor(self, data: np.ndarray) -> Factor:
        """Factorise the matrix of the pattern with these data (nnz,).

        Raises RuntimeError: the matrix is singular.
        """
        shape = (len(self._order), len(self._order))
        matrix = sparse.csc_array((data[self._places], self._indices, self._indptr), shape=shape)
        return Factor(symmetric_lu(matrix, "NATURAL"), self._rows)


class Factor:
    """A sparse factorised matrix, whose unknowns are the `rows` of vectors in their order.

    SciPy releases the memory of a factor (20 MB for 1,000 nodes) only in the thread that made it
    (scipy#15921). One that is dropped in another thread, as by the window's garbage collection, is
    kept for its own thread, which releases it before its next factorisation.
    """

    def __init__(self, lu: SuperLU, rows: np.ndarray) -> None:
        self._lu, self._rows, self._dropped = lu, rows, _DROPPED.factors

    def __del__(self) -> None:
        if self._dropped is not _DROPPED.factors:
            self._dropped.append(self._lu)

    def solve(self, right: np.ndarray, *, transposed: bool = False) -> np.ndarray:
        """K⁻¹ b, or K⁻ᵀ b, for one (3f,) or several (3f, k) right sides."""
        out = np.zeros_like(right)
        solve = partial(self._lu.solve, trans="T") if transposed else self._lu.solve
        out[self._rows] = solve(right.take(self._rows, axis=0))
        return out

    def solve_with(
        self, right: np.ndarray, vector: np.ndarray, weight: float, across: np.ndarray | None = None
    ) -> np.ndarray:
        """(K + w v aᵀ)⁻¹ b by Sherman and Morrison.

        `right` as in `solve`, `vector` and `across` (3f,), a = v where not given.
        """
        across = vector if across is None else across
        both = self.solve(np.column_stack([right, vector]))
        plain, by_vector = both[:, :-1], both[:, -1]
        share = weight * (across @ plain) / (1.0 + weight * (across @ by_vector))
        return (plain - np.outer(by_vector, share)).reshape(right.shape)

    def negative_directions(self) -> int:
        """Number of negative eigenvalues of a symmetric K, by Sylvester's law of inertia."""
        return int(np.count_nonzero(self._lu.U.diagonal() < 0.0))


class FrictionConstraint(NamedTuple):
    """Friction constraint of nodes that are held on planes."""

    stuck: np.ndarray  # (k,) bool, nodes that do not move across their normals but for `back`
    back: np.ndarray  # (k, 3), motion of the stuck ones to where they stick, m
    # (k, 3), of nodes that slip: μ times the direction. Their force across the normal is −drag ×
    # load.
    drag: np.ndarray

    def of(self, nodes: np.ndarray) -> FrictionConstraint:
        """On some of the nodes."""
        return FrictionConstraint(self.stuck[nodes], self.back[nodes], self.drag[nodes])


class NodeBlocks:
    """The 3×3 blocks of a matrix of the pattern that `Factoriser` takes, to hold nodes on planes.

    Parameters
    ----------
    pattern : sparse array
    """

    def __init__(self, pattern: sparse.csc_array) -> None:
        self._pattern = pattern.indices, pattern.indptr
        indptr = pattern.indptr.astype(np.int64)
        count = np.diff(indptr)[::3] // 3  # blocks in each column of them
        self._column = np.repeat(np.arange(len(count)), count)
        within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        starts = indptr[3 * self._column[:, None] + np.arange(3)] + 3 * within[:, None]
        self._places = starts[:, None, :] + np.arange(3)[:, None]  # (block, row, column)
        self._row = pattern.indices[self._places[:, 0, 0]] // 3
        self._diagonal = np.flatnonzero(self._row == self._column)

    def times(self, data: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        """K v for v (f, 3), of the matrix with these data."""
        indices, indptr = self._pattern
        size = len(indptr) - 1
        matrix = sparse.csc_array((data, indices, indptr), shape=(size, size))
        return (matrix @ vectors.ravel()).reshape(-1, 3)

    def shifted(self, data: np.ndarray, share: float) -> np.ndarray:
        """Data of K + s I with s a share of its mean diagonal."""
        data = data.copy()
        places = self._places[self._diagonal][:, [0, 1, 2], [0, 1, 2]]
        data[places] += share * np.abs(data[places]).mean()
        return data

    def added(self, data: np.ndarray, nodes: np.ndarray, blocks: np.ndarray) -> np.ndarray:
        """Data with blocks (k, 3, 3) added on the diagonal at nodes (k,)."""
        data = data.copy()
        data[self._places[self._diagonal[nodes]]] += blocks
        return data

    def held(
        self,
        data: np.ndarray,  # (nnz,), of K
        nodes: np.ndarray,  # (k,) int
        normals: np.ndarray,  # (k, 3), unit; s is of the size of K's diagonal
        grip: FrictionConstraint | None = None,  # of these nodes, without drag where they are stuck
    ) -> np.ndarray:
        """Data of Q K P + s (I − P): K where some nodes only move across their normals.

        P removes from a node's motion the part along its normal, or all of it if it sticks. Q
        removes the same from its force, and adds the friction `drag` times the removed normal part.
        """
        planes = np.broadcast_to(np.eye(3), (len(self._diagonal), 3, 3)).copy()
        lines = normals[:, :, None] * normals[:, None, :]
        if grip is not None:
            lines[grip.stuck] = np.eye(3)
        planes[nodes] -= lines
        forces = planes
        if grip is not None:
            forces = planes.copy()
            forces[nodes] += grip.drag[:, :, None] * normals[:, None, :]
        which = np.zeros(len(planes), bool)
        which[nodes] = True
        some = np.flatnonzero(which[self._row] | which[self._column])
        data = data.copy()
        places = self._places[some]
        data[places] = forces[self._row[some]] @ data[places] @ planes[self._column[some]]
        diagonal = self._places[self._diagonal]
        size = np.abs(data[diagonal[:, [0, 1, 2], [0, 1, 2]]]).mean()
        data[diagonal[nodes]] += size * lines
        return data
