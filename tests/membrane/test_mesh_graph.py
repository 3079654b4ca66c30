"""Sets of nodes on the graph of a mesh's edges, against SciPy's graphs."""

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from bubbleviz.membrane import (
    adjacency,
    build_mesh,
    connected_parts,
    cotangent_laplacian,
    dense_part,
    grown,
)
from bubbleviz.sensor import load_sensor

MESH = build_mesh(load_sensor("pico_flexx_75mm"), 500)
EDGES = sparse.lil_array((len(MESH.nodes), len(MESH.nodes)))
for a, b, c in MESH.triangles:
    EDGES[a, b] = EDGES[b, c] = EDGES[c, a] = 1.0
EDGES = ((EDGES + EDGES.T) > 0).tocsr()


def random_nodes(share):
    return np.random.default_rng(2).random(len(MESH.nodes)) < share


@pytest.mark.parametrize("share", [0.0, 0.02, 0.3, 0.5, 1.0])
def test_connected_components_equal_those_of_networkx(share):
    mask = random_nodes(share)
    nodes = np.flatnonzero(mask)
    count, part = connected_parts(MESH.rings, mask)
    expected, label = connected_components(EDGES[nodes][:, nodes], directed=False)
    assert count == expected
    assert np.array_equal(part[:, None] == part, label[:, None] == label)


def test_dilation_adds_the_neighbours():
    mask = random_nodes(0.1)
    assert np.array_equal(grown(MESH.rings, mask), mask | (EDGES @ mask.astype(float) > 0.0))


def test_sparse_submatrices_equal_those_by_indexing():
    nodes = np.flatnonzero(random_nodes(0.3))
    laplacian = cotangent_laplacian(MESH)
    assert np.array_equal(dense_part(laplacian, nodes), laplacian[nodes][:, nodes].toarray())
    assert np.array_equal(adjacency(MESH.rings, nodes), EDGES[nodes][:, nodes].toarray())
