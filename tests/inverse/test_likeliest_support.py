"""The max_evidence support, against the evidence of every support by another formula."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy import sparse
from scipy.stats import multivariate_normal

from bubbleviz.inverse import (
    ContactProblem,
    LinearisedRubber,
    Measurements,
    Nuisances,
    Prior,
    Selection,
    SupportProblem,
)
from bubbleviz.membrane import (
    Factoriser,
    RubberMembrane,
    cotangent_laplacian,
    mesh_cap,
    spherical_cap,
)

NODES = 8
"""In a row, so that their supports can be counted."""
CUT = 0.5 * np.log(2.0)


class Row:
    """Data y = J p + noise of unit deviation, with p smooth on its support."""

    def __init__(self, pressure, blur, seed):
        random, at = np.random.default_rng(seed), np.arange(NODES)
        pixels = np.linspace(-1.0, NODES, 40)
        self.J = np.exp(-0.5 * ((pixels[:, None] - at) / blur) ** 2)
        self.y = self.J @ pressure + random.standard_normal(len(pixels))
        self.smoothness = 0.1 * (2.0 * np.eye(NODES) - np.eye(NODES, k=1) - np.eye(NODES, k=-1))
        self.neighbours = np.abs(at[:, None] - at) == 1

    def problem(self):
        H = self.J.T @ self.J + self.smoothness
        degree = self.neighbours.sum(axis=1)
        return SupportProblem(H, self.smoothness, -self.J.T @ self.y, self.neighbours, degree)

    def evidence(self, support):
        """Log density of the data; −inf where the best pressure on a support pulls somewhere."""
        J, P = self.J[:, support], self.smoothness[np.ix_(support, support)]
        if np.any(np.linalg.solve(J.T @ J + P, J.T @ self.y) <= 0.0):
            return -np.inf
        covariance = np.eye(len(self.y)) + J @ np.linalg.solve(P, J.T)
        cut = np.count_nonzero(np.diff(support))
        return multivariate_normal(None, covariance).logpdf(self.y) - CUT * cut


@pytest.mark.parametrize("seed", range(12))
def test_no_exchange_of_a_node_has_more_evidence(seed):
    row = Row(np.array([0.0, 0, 5, 3, 3, 5, 0, 0]), 1.0, seed)
    chosen, _, _ = row.problem().max_evidence(np.arange(NODES) == 4)
    best = row.evidence(chosen)
    for node in range(NODES):
        other = chosen.copy()
        other[node] ^= True
        assert not other.any() or row.evidence(other) <= best + 1e-5


@pytest.mark.parametrize("seed", range(4))
def test_a_clear_support_is_found_from_any_initial_one(seed):
    row = Row(np.array([0.0, 0, 9, 9, 9, 9, 0, 0]), 0.6, seed)
    supports = [np.array(s, bool) for s in product((0, 1), repeat=NODES) if any(s)]
    max_evidence = max(supports, key=row.evidence)
    for start in ([3], [2, 3], [5, 6], [0, 4], range(NODES)):
        chosen, _, _ = row.problem().max_evidence(np.isin(np.arange(NODES), start))
        np.testing.assert_array_equal(chosen, max_evidence)


@pytest.mark.parametrize("seed", range(4))
def test_averaged_pressure_is_the_mean_over_exchanges_of_a_node(seed):
    row = Row(np.array([0.0, 0, 9, 6, 6, 9, 0, 0]), 0.9, seed)

    def solution(support):
        J, P = row.J[:, support], row.smoothness[np.ix_(support, support)]
        pressure = np.zeros(NODES)
        pressure[support] = np.linalg.solve(J.T @ J + P, J.T @ row.y)
        return pressure

    chosen, _, _ = row.problem().max_evidence(np.arange(NODES) == 4)
    mean = solution(chosen)
    for node in range(NODES):
        other = chosen.copy()
        other[node] ^= True
        odds = np.exp(row.evidence(other) - row.evidence(chosen))
        mean += odds / (1.0 + odds) * (solution(other) - solution(chosen))
    found = row.problem().averaged_pressure(chosen)
    np.testing.assert_allclose(found, mean, rtol=1e-4, atol=1e-4)
    assert np.abs(found - solution(chosen)).max() > 1e-3  # some exchange is likely enough to matter


def test_a_problem_that_cannot_be_solved_has_no_answer():
    problem = replace(Row(np.ones(NODES), 1.0, 0).problem(), hessian=-np.eye(NODES))
    assert not problem.max_evidence(np.arange(NODES) == 4)[2]


def test_a_rim_node_never_touches():
    """It moves slightly and could explain ranges, but carries no pressure."""
    dome = mesh_cap(spherical_cap(0.045, 0.02), 200)
    membrane = RubberMembrane.uniform(dome, 2500.0, 70.0, 1.2)
    rubber = LinearisedRubber(
        membrane,
        Factoriser(membrane.tangent(dome.nodes, 2500.0)),
        dome.nodes,
        np.full(len(dome.nodes), 2500.0),
        0.0,
    )
    rim = int(np.flatnonzero(dome.rim)[0])
    laplacian = abs(cotangent_laplacian(dome).tocsr())
    laplacian.setdiag(0.0)
    beside = laplacian[[rim]].toarray()[0] > 0.0
    free = sparse.diags_array(np.where(dome.rim, 0.0, 1.0))
    smoothness = (1e-7 * free @ cotangent_laplacian(dome) @ free).tocsr()
    prior = Prior(smoothness, np.zeros(len(dome.nodes)), dome.rings)
    jacobian = sparse.csr_array(sparse.eye_array(dome.nodes.size))
    seen = -500.0 * rubber.responses(np.flatnonzero(beside)).sum(axis=1)
    weight = np.full(len(seen), 1e8)
    ranges = Measurements(jacobian, seen, weight, Nuisances.none(len(dome.nodes)))
    problem = ContactProblem(
        rubber, ranges, prior, np.zeros(len(dome.nodes)), np.zeros_like(dome.nodes)
    )
    chosen = problem.max_evidence(Selection(beside | (np.arange(len(beside)) == rim)))
    assert chosen.converged
    assert chosen.support.any()
    assert not (chosen.support & dome.rim).any()
