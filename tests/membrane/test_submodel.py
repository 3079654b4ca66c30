"""Part of a membrane with the rest condensed, against the full model; compliant gas."""

import numpy as np
import pytest
from domes import GAUGE, A, H, dome

from bubbleviz.membrane import Gas, HeldPressure, Submodel

PLACE = np.array([0.01, 0.0, H])


def full_model_motion(membrane, gas, forces, loaded, added):
    """Motions of all nodes under small nodal forces, by the full tangent with gas.

    `added` (c, 9, 9) is the stiffness of triangles with nodes `loaded` (c, 3).
    """
    rest, row = membrane.mesh.nodes, 3 * np.arange(len(membrane.mesh.nodes))[:, None] + np.arange(3)
    whole, own = np.zeros((rest.size, rest.size)), row[membrane.moving].ravel()
    for nodes, stiffness in zip(loaded, added, strict=True):
        whole[np.ix_(row[nodes].ravel(), row[nodes].ravel())] += stiffness
    K = membrane.tangent(rest, GAUGE).toarray() + whole[np.ix_(own, own)]
    g = membrane.volume_gradient(rest)[membrane.moving].ravel()
    K += gas.at(0.0)[1] * np.outer(g, g)
    motion = np.zeros_like(rest)
    motion[membrane.moving] = np.linalg.solve(K, forces[membrane.moving].ravel()).reshape(-1, 3)
    return motion


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("reach_m", [0.3 * A, 0.6 * A, 3.0 * A])
def test_submodel_responds_to_small_forces_like_the_full_model(reach_m, held):
    membrane, gas = dome(300)
    if held:
        gas = HeldPressure(0.0)
    part = Submodel(membrane, PLACE, reach_m)
    nodes = part.ends[:, 0]
    inside = np.linalg.norm(part.mesh.nodes - PLACE, axis=1) < 0.2 * A
    forces = np.where(inside[:, None], [1e-4, 2e-4, -1e-3], 0.0)
    loaded = np.flatnonzero(inside[part.mesh.triangles].any(axis=1))
    added = np.random.default_rng(1).uniform(-10.0, 30.0, (len(loaded), 9, 9))  # not symmetric
    tangent, missed = part.linearised(part.mesh.nodes, forces, loaded, added, gas)
    everywhere = np.zeros_like(membrane.mesh.nodes)
    everywhere[nodes] = np.where(part.mesh.rim[:, None], 0.0, forces)
    corners = nodes[part.mesh.triangles[loaded]]
    exact = full_model_motion(membrane, gas, everywhere, corners, added)[nodes]
    assert inside.sum() > 5
    np.testing.assert_allclose(tangent.moved(missed[None])[0], exact, atol=1e-9 * H)


def test_refined_submodel_moves_like_the_coarse_one():
    membrane, gas = dome(600)
    motions = []
    for finer_m in (0.0, 0.3 * A):
        part = Submodel(membrane, PLACE, 0.7 * A, finer_m)
        own = np.flatnonzero(part.ends[:, 0] == part.ends[:, 1])
        areas = part.mesh.areas * (np.linalg.norm(part.mesh.nodes - PLACE, axis=1) < 0.2 * A)
        forces = -100.0 * areas[:, None] * part.mesh.normals
        none, nothing = np.zeros(0, int), np.zeros((0, 9, 9))
        tangent, missed = part.linearised(part.mesh.nodes, forces, none, nothing, gas)
        whole = np.full(membrane.mesh.nodes.shape, np.nan)
        whole[part.ends[own, 0]] = tangent.moved(missed[None])[0][own]
        motions.append(whole)
        np.testing.assert_array_equal(part.mesh.nodes[own], membrane.mesh.nodes[part.ends[own, 0]])
    there = np.isfinite(motions[0][:, 0])
    assert (there == np.isfinite(motions[1][:, 0])).all()
    off = np.linalg.norm((motions[1] - motions[0])[there], axis=1).max()
    assert off < 0.1 * np.linalg.norm(motions[0][there], axis=1).max()


@pytest.mark.parametrize("give", [0.0, 1e-9, 3e-8])
@pytest.mark.parametrize("growth", [-4e-5, 0.0, 6e-5])
def test_compliant_gas_obeys_boyle(growth, give):
    gas = Gas(103_000.0, 5e-4, np.zeros(1))
    change, stiffness = gas.at(growth, give)
    assert (gas.P0 + change) * (gas.V0 + growth + give * change) == pytest.approx(gas.P0 * gas.V0)
    step = 1e-9
    slope = (gas.at(growth - step, give)[0] - gas.at(growth + step, give)[0]) / (2.0 * step)
    assert stiffness == pytest.approx(slope, rel=1e-6)


def test_work_on_the_gas_is_the_integral_of_its_pressure():
    for gas in (Gas(103_000.0, 5e-4, np.zeros(1)), HeldPressure(-250.0)):
        way = np.linspace(0.0, -5e-5, 2001)
        work = -np.trapezoid([gas.at(v)[0] for v in way], way)
        assert gas.energy(-5e-5) == pytest.approx(work, rel=1e-6)


def test_no_volume_has_no_finite_pressure():
    gas = Gas(103_000.0, 5e-4, np.zeros(1))
    assert not np.isfinite([gas.at(-5e-4)[0], gas.energy(-5e-4)]).any()
