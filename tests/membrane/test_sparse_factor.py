"""Factorised tangents and their blocks against dense matrices."""

import os
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse

from bubbleviz.membrane import (
    Factoriser,
    NodeBlocks,
    condensed,
    cotangent_laplacian,
    mesh_cap,
    spherical_cap,
)

SHIFT = 0.3


@pytest.fixture(scope="module")
def matrix():
    """Symmetric and positive definite, with a full block wherever nodes of a mesh meet."""
    mesh = mesh_cap(spherical_cap(0.075, 0.05), 60)
    meet = sparse.csc_array(cotangent_laplacian(mesh) != 0.0).astype(float)
    full = sparse.kron(meet, np.ones((3, 3)), format="csc")
    rng = np.random.default_rng(0)
    values = rng.standard_normal(full.shape)
    values = np.where(full.toarray() > 0.0, values + values.T, 0.0)
    values += np.diag(np.abs(values).sum(axis=1) + rng.uniform(1.0, 5.0, len(values)))
    found = sparse.csc_array(values)
    found.sort_indices()
    return found


def dense(matrix, data):
    return sparse.csc_array((data, matrix.indices, matrix.indptr), shape=matrix.shape).toarray()


def test_solutions_equal_those_of_the_dense_matrix(matrix):
    K, rng = matrix.toarray(), np.random.default_rng(1)
    factor = Factoriser(matrix).factor(matrix.data)
    one, some = rng.standard_normal(len(K)), rng.standard_normal((len(K), 4))
    vector = rng.standard_normal(len(K))
    for right in (one, some):
        np.testing.assert_allclose(K @ factor.solve(right), right, atol=1e-9)
        bordered = K + 0.7 * np.outer(vector, vector)
        with_it = factor.solve_with(right, vector, 0.7)
        np.testing.assert_allclose(bordered @ with_it, right, atol=1e-9)
    skew = matrix.copy()
    skew.data = skew.data * rng.uniform(0.9, 1.1, len(skew.data))
    other = Factoriser(matrix).factor(skew.data)
    np.testing.assert_allclose(skew.toarray().T @ other.solve(one, transposed=True), one, atol=1e-9)


@pytest.mark.skipif(sys.platform != "linux", reason="reads the memory of the process in /proc")
def test_factors_dropped_in_another_thread_return_their_memory():
    """SciPy would keep it (scipy#15921): 4 MB of each of these."""
    line = sparse.diags_array([-1.0, 2.1, -1.0], offsets=[-1, 0, 1], shape=(40, 40))
    grid = sparse.kron(sparse.eye_array(40), line) + sparse.kron(line, sparse.eye_array(40))
    matrix = sparse.csc_array(sparse.kron(grid, np.eye(3) + 0.1))
    matrix.sort_indices()
    factoriser, right = Factoriser(matrix), np.ones(matrix.shape[0])
    with ThreadPoolExecutor(1) as thread:
        before = resident_bytes()
        for _ in range(20):
            factor = thread.submit(factoriser.factor, matrix.data).result()
            np.testing.assert_allclose(matrix @ factor.solve(right), right)
            del factor
        assert resident_bytes() - before < 30e6


def resident_bytes():
    pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.parametrize("count", [1, 2])
def test_condensed_matrix_is_the_schur_complement(matrix, count):
    """Also of two that are coupled only by the vector."""
    K = sparse.csc_array(sparse.block_diag([matrix] * count))
    random = np.random.default_rng(3)
    nodes = np.sort(random.permutation(len(K.indptr) // 3)[:20])
    kept, v = (3 * nodes[:, None] + np.arange(3)).ravel(), random.standard_normal(K.shape[0])
    both = np.block([[np.zeros((1, 1)), v[None]], [v[:, None], K.toarray()]])
    ends = np.concatenate([[0], 1 + kept])
    rest = np.setdiff1d(np.arange(len(both)), ends)
    back = np.linalg.solve(both[np.ix_(rest, rest)], both[np.ix_(rest, ends)])
    expected = both[np.ix_(ends, ends)] - both[np.ix_(ends, rest)] @ back
    np.testing.assert_allclose(condensed(K, v, kept), expected, atol=1e-9)


@pytest.mark.parametrize("negative", [0, 1, 5])
def test_negative_eigenvalues_are_counted(matrix, negative):
    lowered = matrix.toarray()
    values = np.linalg.eigvalsh(lowered)
    level = 0.5 * (values[negative - 1] + values[negative]) if negative else 0.0
    found = matrix.copy()
    found.setdiag(found.diagonal() - level)
    found.sort_indices()
    assert Factoriser(matrix).factor(found.data).negative_directions() == negative


def test_products_and_shifts(matrix):
    K, blocks = matrix.toarray(), NodeBlocks(matrix)
    v = np.random.default_rng(2).standard_normal((len(K) // 3, 3))
    np.testing.assert_allclose(blocks.times(matrix.data, v).ravel(), K @ v.ravel())
    expected = K + SHIFT * np.abs(np.diag(K)).mean() * np.eye(len(K))
    np.testing.assert_allclose(dense(matrix, blocks.shifted(matrix.data, SHIFT)), expected)


def test_constrained_nodes_move_only_across_their_normals(matrix):
    K, rng = matrix.toarray(), np.random.default_rng(3)
    nodes = np.array([2, 7, 11])
    normals = rng.standard_normal((3, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    P, N = np.eye(len(K)), np.zeros((len(K), 3))
    for k, (node, normal) in enumerate(zip(nodes, normals, strict=True)):
        N[3 * node : 3 * node + 3, k] = normal
    P -= N @ N.T
    held = dense(matrix, NodeBlocks(matrix).held(matrix.data, nodes, normals))
    rest = held - P @ K @ P  # s N Nᵀ, with s of the size of the diagonal
    size = np.trace(N.T @ rest @ N) / 3.0
    np.testing.assert_allclose(rest, size * N @ N.T, atol=1e-9 * size)
    assert 0.5 < size / np.abs(np.diag(K)).mean() < 2.0
