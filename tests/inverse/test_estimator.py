"""The inverse of the linear membrane, on presses simulated on another mesh."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from bubbleviz.camera import RangeObserver
from bubbleviz.errors import InputError
from bubbleviz.inverse import (
    GAS_NOISE,
    MAX_NODES,
    ConstantTension,
    Estimator,
    EstimatorOptions,
    Measurements,
    Nuisances,
)
from bubbleviz.membrane import Gas, build_mesh, refinement
from bubbleviz.pipeline import Pipeline
from tests.inverse.conftest import CAMERA, SENSOR, TENSION, estimator, first, press
from tests.oracles.interior_point import interior_point

REST_PA = SENSOR.pneumatics.reference_pressure_pa
SOLVERS = ("linear", "paper")
LINEAR_OR_PAPER = pytest.mark.parametrize("solver", SOLVERS)


def off(estimate, truth):
    """Error of the force over its size."""
    return np.linalg.norm(estimate.force_n - truth.force) / np.linalg.norm(truth.force)


def alike(a, b, share):
    top = np.max(a.contact_pressure_pa)
    return np.max(np.abs(a.contact_pressure_pa - b.contact_pressure_pa)) < share * top


def test_a_deep_press_is_solved_from_rest_on_a_mesh_that_is_finer_there():
    noise, mesh, truth = 3e-4, build_mesh(SENSOR, 600), press("sphere", 0.02)
    for radius in (0.03, 0.02):
        near = np.hypot(mesh.nodes[:, 0] - 0.006, mesh.nodes[:, 1] + 0.004) < radius
        mesh = refinement(mesh, near[mesh.triangles].any(axis=1)).mesh
    observer = RangeObserver(CAMERA, mesh, noise, block=2)
    film = ConstantTension(mesh, TENSION, Gas.of(SENSOR.pneumatics, mesh))
    assert off(first(Estimator(observer, film), truth.depth(noise)), truth) < 0.01


@pytest.mark.parametrize(("name", "x"), [("cylinder", 0.0), ("sphere", 0.003), ("sphere", 0.006)])
def test_a_light_press_is_found_on_a_mesh_that_is_coarser_there(name, x):
    """Contacts of one or two nodes, whose cells are many times those of most nodes."""
    mesh = build_mesh(SENSOR, 300)
    for _ in range(2):
        away = np.hypot(mesh.nodes[:, 0], mesh.nodes[:, 1]) > 0.035
        mesh = refinement(mesh, away[mesh.triangles].all(axis=1)).mesh
    truth = press(name, 4e-4 if name == "cylinder" else 1.2e-3, (x, -0.002))
    observer = RangeObserver(CAMERA, mesh, 1e-3, block=2)
    film = ConstantTension(mesh, TENSION, Gas.of(SENSOR.pneumatics, mesh))
    found = first(Estimator(observer, film), truth.depth(1e-3))
    assert found.status == "ok"
    assert off(found, truth) < 0.2


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_force_and_gas_pressure_of_a_known_press(sphere, noise):
    solver = estimator(1000)
    estimate = first(solver, sphere.depth(noise))
    assert estimate.status == "ok"
    assert np.all(estimate.contact_pressure_pa >= 0.0)
    assert off(estimate, sphere) < 0.005
    assert np.linalg.norm(estimate.force_n - sphere.force) < np.linalg.norm(estimate.force_sigma_n)
    pushed = (solver.mesh.areas * estimate.contact_pressure_pa) @ solver.mesh.normals
    assert estimate.force_n == pytest.approx(-pushed)
    truth = sphere.contact.gas_pressure_change_pa
    assert estimate.gas_pressure_change_pa == pytest.approx(truth, rel=0.005)
    law = solver.bubble.gas.pressure_change(estimate.displacement_m)
    assert estimate.gas_pressure_change_pa == pytest.approx(law, rel=1e-6)
    assert estimate.kkt_residual < 1e-9
    expected = noise * np.nanmedian(sphere.range_m) / 3 if noise else 2e-5  # blocks of 9 pixels
    assert estimate.residual_rms_m == pytest.approx(expected, rel=0.5)


def test_the_paper_linearises_at_the_reference_surface_and_we_at_the_pressed_one(sphere):
    """On the paper's linear ranges a 12 mm press is off by 3 %."""
    ours, paper = (first(estimator(1000, each), sphere.depth(0.0)) for each in SOLVERS)
    assert 0.01 < off(paper, sphere) < 0.05
    assert off(ours, sphere) < 0.3 * off(paper, sphere)


def test_measured_gas_pressure(sphere):
    """The paper takes it as it is; a barometer's error does not become our force."""
    measured = REST_PA + sphere.contact.gas_pressure_change_pa + 15.0
    ours, paper = (first(estimator(1000, s), sphere.depth(0.0), measured) for s in SOLVERS)
    assert ours.status == paper.status == "ok"
    assert REST_PA + paper.gas_pressure_change_pa == pytest.approx(measured)
    assert abs(ours.gas_pressure_change_pa - sphere.contact.gas_pressure_change_pa) < 10.0
    assert off(ours, sphere) < 0.015 and off(paper, sphere) < 0.05


@pytest.mark.parametrize("measured", [False, True])
def test_both_solvers_find_the_same_contact_where_ranges_are_linear(measured):
    truth = press("sphere", 0.005)
    gas = REST_PA + truth.contact.gas_pressure_change_pa if measured else None
    depth = truth.depth(0.002)
    ours, paper = (first(estimator(1000, s, image_error=0.0), depth, gas) for s in SOLVERS)
    assert ours.status == paper.status == "ok"
    assert off(ours, truth) < 0.03 and off(paper, truth) < 0.03
    assert np.max(np.abs(ours.displacement_m - paper.displacement_m)) < 3e-4


@pytest.mark.parametrize("gas_pa", [None, 300.0])
def test_an_interior_point_certifies_the_papers_solution(sphere, gas_pa):
    """Without the L1 term, on the nodes that it has under pressure."""
    solver, depth = estimator(300, "paper"), sphere.depth(0.01)
    estimate = first(solver, depth, None if gas_pa is None else REST_PA + gas_pa)
    mesh, observation = solver.mesh, solver.observer.observe(depth)
    view, nothing = solver.observer.around(mesh.nodes), np.zeros(len(mesh.nodes))
    error, weight = observation.residual_m[view.block], observation.weight[view.block]
    ranges = Measurements(view.jacobian, error, weight, Nuisances.none(len(mesh.nodes)))
    whole = estimate.contact_pressure_pa
    exact = interior_point(solver.bubble, ranges, solver.smoothness, nothing, whole > 0.0, gas_pa)
    assert whole == pytest.approx(exact, abs=0.05 * exact.max())
    assert mesh.areas @ whole == pytest.approx(mesh.areas @ exact, rel=0.005)


def test_frame_whose_warm_start_fails_is_solved_from_rest(sphere):
    """Here it starts from a shape outside the membrane's surroundings."""
    solver = estimator(1000)
    cold, start = solver.estimate(sphere.depth(0.01))
    far = replace(start.state, x=start.state.x + 2.0 * solver.size_m)
    warm, _ = solver.estimate(sphere.depth(0.01), start=replace(start, state=far))
    assert warm.status == "ok"
    np.testing.assert_array_equal(warm.force_n, cold.force_n)


def test_seeking_and_playing_have_the_same_solution():
    """The shape after a press does not depend on how one came to it."""
    played, deepest = estimator(), press("two_legged_toy", 0.012)
    way = [press("two_legged_toy", depth).depth(0.002) for depth in (0.004, 0.006, 0.008, 0.010)]
    start = None
    for frame in [*way, *(deepest.depth(0.002, seed) for seed in range(3))]:
        a, start = played.estimate(frame, start=start)
    for other in (first(played, frame), played.estimate(frame, start=start)[0]):
        assert alike(a, other, 0.01)
        assert np.max(np.abs(a.displacement_m - other.displacement_m)) < 1e-5


def test_solution_that_did_not_converge_is_reported(sphere, monkeypatch):
    monkeypatch.setattr("bubbleviz.inverse.paper.MOST_ITERATIONS", 10)
    estimate = first(estimator(200, "paper"), sphere.depth(0.002))
    assert estimate.status == "not_converged" and np.isnan(estimate.force_n).all()


def test_frames_of_a_held_press_take_few_pivots(sphere):
    """3 to 7 in this case, of some 30 nodes."""
    solver, start = estimator(1000), None
    for seed in range(4):
        estimate, start = solver.estimate(sphere.depth(0.01, seed), None, start)
        assert 0 < estimate.iterations <= 10


@LINEAR_OR_PAPER
def test_noise_alone_is_no_contact_and_costs_no_solve(untouched, solver):
    each = estimator(solver=solver)
    results = [first(each, untouched.depth(0.01, seed)) for seed in range(20)]
    assert {r.status for r in results} == {"no_contact"}
    assert all(r.iterations == 0 and not r.contact_pressure_pa.any() for r in results)
    assert all(not r.force_n.any() for r in results)


@pytest.mark.parametrize("deviations", [-2.0, 2.0])
def test_noise_of_the_gas_sensor_is_no_contact(untouched, deviations):
    solver, measured = estimator(), (1.0 + deviations * GAS_NOISE) * REST_PA
    for seed in range(5):
        assert first(solver, untouched.depth(0.01, seed), measured).status == "no_contact"


def test_missing_pixels_are_ignored(sphere):
    depth = sphere.depth(0.01)
    depth[np.random.default_rng(3).random(depth.shape) < 0.4] = np.nan
    depth[20:40, 30:60] = np.nan
    assert off(first(estimator(), depth), sphere) < 0.03


def test_outliers_do_not_bias_the_estimate(sphere, untouched):
    solver, rng = estimator(), np.random.default_rng(4)
    for truth in (untouched, sphere):
        depth = truth.depth(0.01)
        wild = rng.random(depth.shape) < 0.2
        depth[wild] += rng.uniform(-0.03, 0.03, depth.shape).astype(np.float32)[wild]
        error = np.linalg.norm(first(solver, depth).force_n - truth.force)
        assert error < 0.1 * np.linalg.norm(sphere.force)


@LINEAR_OR_PAPER
def test_too_few_pixels_are_no_data(sphere, solver):
    each, depth = estimator(solver=solver), np.full(sphere.range_m.shape, np.nan, np.float32)
    assert first(each, depth).status == "no_data"
    depth[85, 110:112] = 0.15
    assert first(each, depth).status == "no_data"


def test_an_unknown_solver_is_refused_by_name():
    with pytest.raises(InputError, match="no such solver; choose one of rubber, linear"):
        _ = Pipeline.of(SENSOR, options=EstimatorOptions("gurobi")).estimator


@pytest.mark.parametrize(
    ("name", "instead"), [("osqp", "use paper"), ("osqp-cold", "use"), ("clarabel", "use linear")]
)
def test_removed_solver_names_its_version_and_replacement(name, instead):
    with pytest.raises(InputError, match=rf"{name}: .* in 0\.3.*{instead}"):
        EstimatorOptions.named(name)


@pytest.mark.parametrize("noise", [0.03, 0.08])
def test_more_noise_than_in_the_sensor_file_is_reported(sphere, untouched, noise):
    """The sensor file gives 1 %; a noisier camera must not cause false contact."""
    solver = estimator()
    results = [first(solver, untouched.depth(noise, seed)) for seed in range(5)]
    assert {r.status for r in results} == {"no_contact"}
    assert off(first(solver, sphere.depth(noise)), sphere) < 0.05


@LINEAR_OR_PAPER
@pytest.mark.parametrize(
    "spoil", [lambda d: np.full_like(d, 0.15), lambda d: 1000 * d, lambda d: d + 0.05]
)
def test_an_image_that_no_membrane_explains_is_not_ok(sphere, spoil, solver):
    estimate = first(estimator(solver=solver), spoil(sphere.depth(0.01)))
    assert estimate.status in ("implausible", "no_data", "not_converged")
    assert np.isnan(estimate.force_n).all() and not estimate.displacement_m.any()


@LINEAR_OR_PAPER
@pytest.mark.parametrize("absolute_pa", [0.0, 104.0, -1e5, 2.1e5, np.inf])
def test_an_impossible_gas_pressure_is_refused(sphere, absolute_pa, solver):
    """104 is kilopascals taken for pascals."""
    estimate = first(estimator(solver=solver), sphere.depth(0.0), absolute_pa)
    assert estimate.status == "implausible"


@pytest.mark.parametrize(
    ("off_pa", "status"), [(0.0, "ok"), (-200.0, "implausible"), (200.0, "implausible")]
)
def test_a_wrong_gas_pressure_is_reported(sphere, off_pa, status):
    measured = REST_PA + sphere.contact.gas_pressure_change_pa + off_pa
    assert first(estimator(), sphere.depth(0.01), measured).status == status


@LINEAR_OR_PAPER
def test_a_missing_gas_pressure_is_estimated(sphere, solver):
    a, b = (first(estimator(solver=solver), sphere.depth(0.0), gas) for gas in (np.nan, None))
    assert a.gas_pressure_change_pa == pytest.approx(b.gas_pressure_change_pa)


def test_contact_needs_the_gauge_pressure(sphere):
    """A slack membrane scales the force down, not away: gauge pressure is not the yardstick."""
    usual = estimator()
    film = ConstantTension(usual.mesh, 0.02 * TENSION, Gas.of(SENSOR.pneumatics, usual.mesh))
    estimate = first(Estimator(usual.observer, film), sphere.depth(0.0))
    assert estimate.status == "ok"
    expected = 0.02 * np.linalg.norm(sphere.force)
    assert np.linalg.norm(estimate.force_n) == pytest.approx(expected, rel=0.1)


def test_a_mesh_finer_than_the_noise_can_use_is_refused():
    """Before anything is computed on it."""
    mesh = SimpleNamespace(nodes=np.zeros((MAX_NODES + 1, 3)))
    with pytest.raises(InputError, match="identify the sensor again, with 1000 nodes"):
        Estimator(SimpleNamespace(mesh=mesh), SimpleNamespace())


def test_correlated_noise_that_should_be_white_is_not_trusted(sphere):
    """The camera filters over 8 pixels, but the sensor file declares white noise."""
    noise = gaussian_filter(np.random.default_rng(0).standard_normal((171, 224)), 6)
    depth = sphere.depth(0.0)
    small, large = (depth * (1 + s * noise / noise.std()).astype(np.float32) for s in (5e-4, 0.01))
    assert first(estimator(), small).status == "ok"
    assert first(estimator(), large).status == "implausible"


@pytest.mark.parametrize("measured", [False, True])
def test_sigma_includes_the_uncertainty_of_the_tension(sphere, measured):
    """Against a second solve with the other tension."""
    usual, image = estimator(), sphere.depth(0.002)
    gas_pa = REST_PA + sphere.contact.gas_pressure_change_pa if measured else None

    def solved(tension, model_error=0.0):
        gas = Gas.of(SENSOR.pneumatics, usual.mesh)
        film = ConstantTension(usual.mesh, tension, gas, model_error)
        return first(Estimator(usual.observer, film), image, gas_pa)

    known, unsure, stiffer = solved(TENSION), solved(TENSION, 0.05), solved(1.05 * TENSION)
    np.testing.assert_array_equal(unsure.force_n, known.force_n)
    by_tension = np.sqrt(unsure.force_sigma_n[2] ** 2 - known.force_sigma_n[2] ** 2)
    assert by_tension == pytest.approx(abs(stiffer.force_n[2] - known.force_n[2]), rel=0.1)
