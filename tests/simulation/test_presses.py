"""Objects, presses and ground truths shared by studies and tests."""

import numpy as np
import pytest

from benchmarks.edge import EDGE_OBJECTS
from bubbleviz.membrane import TriangleScene, refinement
from bubbleviz.sensor import load_sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation import (
    GRID_OBJECTS,
    HELD_OUT_OBJECTS,
    DepthNoise,
    InflatedRubber,
    LinearPresses,
    Press,
    TruthBank,
    presses,
    study_object,
)
from tests.oracles.round_sheet import resting, round_sheet, rubber_on

ONE = DepthNoise(relative=0.01)
DEPTH_M = 0.012


@pytest.fixture(scope="module")
def sensor():
    return load_sensor("pico_flexx_75mm")


@pytest.fixture(scope="module")
def bank(sensor):
    return TruthBank(LinearPresses.of(SensorModel.of(sensor), 1_500), 7)


@pytest.mark.parametrize("name", GRID_OBJECTS + HELD_OUT_OBJECTS)
def test_presses_have_their_depth_and_are_reproducible(name, bank):
    press = Press(name, 0.004, False)
    pose = press.pose(bank.mesh, 3)
    assert np.array_equal(pose, press.pose(bank.mesh, 3))
    assert not np.allclose(pose, press.pose(bank.mesh, 4))
    obj = study_object(name)
    assert np.linalg.norm(pose[:2, 3]) <= 0.008
    assert np.arccos(pose[2, 2]) <= 0.15
    # lifted by its depth it touches: no vertex is under the sphere, and one is within 0.4 mm
    vertices = obj.vertices @ pose[:3, :3].T + pose[:3, 3] + [0.0, 0.0, press.depth_m]
    radius = (0.075**2 + 0.05**2) / 0.1
    gap = np.linalg.norm(vertices - [0.0, 0.0, 0.05 - radius], axis=1) - radius
    assert -2e-4 < gap.min() < 4e-4


VOLUMES_MM3 = {
    "cross": (2 * 40 * 10 - 10**2) * 20,
    "ring": np.pi * (16**2 - 9**2) * 30,
    "rounded_cross": (2 * 40 * 12 - 12**2) * 30,
    "unequal_balls": 4 / 3 * np.pi * (7**3 + 11**3),
    "ell": (26 * 12 + 14 * 12) * 30,
    "thin_bar": 36 * 8 * 30,
    "small_nut": (18**2 * np.sqrt(3) / 2 - np.pi * 4**2) * 30,
}
"""Of these rounded edges and corners take some per cent away."""


@pytest.mark.parametrize("name", ["cross", *EDGE_OBJECTS])
def test_objects_of_the_study_are_watertight_with_their_volume(name):
    obj = study_object(name)
    name = obj.name
    a, b, c = (obj.vertices[obj.triangles[:, k]] for k in range(3))
    edges = np.sort(obj.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert np.all(np.unique(edges, axis=0, return_counts=True)[1] == 2)
    volume = np.einsum("ij,ij->", np.cross(a, b), c) / 6.0
    lost = 1.0 - volume / (1e-9 * VOLUMES_MM3[name])
    assert abs(lost) < 1e-5 if name == "cross" else 0.0 < lost < 0.06


def test_held_out_objects_are_marked():
    marked = {
        p.object_name for p in presses(GRID_OBJECTS + HELD_OUT_OBJECTS, (0.01,)) if p.held_out
    }
    assert marked == {"cross", "cylinder", "hex_nut"}


def test_noise_differs_between_frames_and_is_reproducible(bank):
    sighting = bank.simulate(Press("sphere", 0.012, False))
    first, again, second = (bank.frame(sighting.range_m, ONE, k).depth_m for k in (0, 0, 1))
    assert np.array_equal(first, again, equal_nan=True)
    assert not np.array_equal(first, second, equal_nan=True)


def test_cached_ground_truth_equals_the_computed_one(sensor, tmp_path, bank):
    press = Press("sphere", DEPTH_M, False)
    model = SensorModel.of(sensor)
    first, kept = (
        TruthBank(LinearPresses.of(model, 1_500), 7, tmp_path).simulate(press) for _ in range(2)
    )
    fresh = bank.simulate(press)
    for one in (first, kept):
        assert np.array_equal(one.range_m, fresh.range_m, equal_nan=True)
        assert np.array_equal(one.truth.force_n, fresh.truth.force_n)
        assert np.array_equal(one.mesh.triangles, fresh.mesh.triangles)


@pytest.fixture(scope="module")
def sheets():
    """One sheet inflated by two solvers that share no code."""
    exact = round_sheet(0.045, 110.0, 1.15, 2500.0)
    ours = InflatedRubber.oval_sheet((0.045, 0.045), 110.0, 1.15, 2500.0)
    return {"by its equations": exact, "by our membrane": ours}


@pytest.mark.parametrize("kind", ["by its equations", "by our membrane"])
def test_another_mesh_of_an_inflated_sheet_is_on_its_surface(kind, sheets):
    """And a finer one of the same facets is in equilibrium, as stiff as the sheet."""
    sheet, rest = sheets[kind], sheets[kind].rest
    other = resting(sheet, 300)
    assert len(other.nodes) < 0.2 * len(rest.nodes)
    away = TriangleScene(rest.nodes, rest.triangles).closest(other.nodes).point - other.nodes
    assert np.linalg.norm(away[~other.rim], axis=1).max() < 1e-6
    fine = rubber_on(
        sheet, refinement(rest, rest.nodes[rest.triangles].mean(axis=1)[:, 0] > 0.03).mesh
    )
    moved = TriangleScene(rest.nodes, rest.triangles).closest(fine.mesh.nodes).point
    assert np.linalg.norm(moved - fine.mesh.nodes, axis=1).max() < 5e-5
    load = sheet.gauge_pressure_pa * fine.mesh.areas.mean()
    assert np.abs(fine.rest_force[fine.mesh.free]).max() < 1e-6 * load
    assert fine.mean_tension == pytest.approx(sheet.tension_n_per_m, rel=2e-3)


def test_sheet_equals_the_meridian_solution(sheets):
    """In γ0 and height."""
    exact, ours = sheets.values()
    assert ours.tension_n_per_m == pytest.approx(exact.tension_n_per_m, rel=3e-3)
    heights = [each.rest.nodes[:, 2].max() for each in (ours, exact)]
    assert heights[0] == pytest.approx(heights[1], rel=3e-3)
