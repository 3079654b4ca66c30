"""The inverse of the exact membrane: against the meridian's equations and simulated presses."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.ndimage import binary_dilation, binary_erosion

from bubbleviz.camera import DepthCamera, MembraneView, RangeObserver
from bubbleviz.inverse import (
    MODEL_ERROR,
    RIM_SLACK_M,
    Estimator,
    EstimatorOptions,
    PatchFinder,
    RubberBubble,
    touching_share,
)
from bubbleviz.membrane import RubberForward, RubberMembrane, mesh_cap
from bubbleviz.pipeline import Pipeline
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor import Camera, load_sensor
from bubbleviz.simulation import refined_press
from tests.membrane.domes import CAP, GAUGE, TENSION, A, H, gas_of, pose
from tests.oracles.rubber_oracle import AxialRubber
from tests.small_press import changed

BALL = 0.015  # of the preset
NOISE_M = 1e-4
CAMERA = DepthCamera.of(
    Camera(
        width=160, height=160, fx=110.0, fy=110.0, cx=79.5, cy=79.5, position_m=(0.0, 0.0, -0.05)
    )
)


@cache
def estimator(
    nodes=500, prestretch=1.2, slack=RIM_SLACK_M, relative=NOISE_M / 0.065, tension=TENSION
):
    mesh = mesh_cap(CAP, nodes)
    membrane = RubberMembrane.uniform(mesh, GAUGE, tension, prestretch, slack)
    observer = RangeObserver(CAMERA, mesh, relative, block=3)
    return Estimator(observer, RubberBubble(membrane, gas_of(mesh)))


def depth_image_of(mesh, motion, noise_m=0.0, relative=0.0, seed=0):
    """Depth image of a moved mesh, with noise."""
    ranges = MembraneView(CAMERA, mesh).range_image(motion)
    noise = np.random.default_rng(seed).standard_normal(ranges.shape)
    return CAMERA.depth_image(ranges * (1.0 + relative * noise) + noise_m * noise)


@cache
def oracle(depth, ball):
    """A press by the meridian's equations, and its surface."""
    exact = AxialRubber.dome(A, H, 1.2, GAUGE).press(depth, ball)
    return exact, exact.surface(A, H)


@cache
def pressed(name, depth, x=0.008, prestretch=1.2, nodes=1500):
    """A press by the forward model on another, finer mesh."""
    mesh = mesh_cap(CAP, nodes)
    model = RubberForward(RubberMembrane.uniform(mesh, GAUGE, TENSION, prestretch), gas_of(mesh))
    contact = model.press(load_object(name), pose(x, 0.002, H - depth))
    assert contact.converged
    return mesh, contact


def by_noise(estimate):
    """Standard deviation of the force without the model's own error, N."""
    model = MODEL_ERROR * np.linalg.norm(estimate.force_n)
    return np.sqrt(estimate.force_sigma_n**2 - model**2)


def error(estimate, force):
    return np.linalg.norm(estimate.force_n - force) / np.linalg.norm(force)


@pytest.mark.parametrize(("depth", "ball"), [(0.009, BALL), (0.006, np.inf)])
def test_force_and_pressure_equal_the_meridian_solution(depth, ball):
    """Force, gas pressure, pressure under a plate and shape, on two meshes."""
    exact, surface = oracle(depth, ball)
    image = depth_image_of(surface, np.zeros(len(surface.nodes)), NOISE_M)
    for nodes, most in ((400, 0.05), (800, 0.02)):
        solver = estimator(nodes)
        estimate, _ = solver.estimate(image)
        assert estimate.status == "ok"
        assert error(estimate, np.array([0.0, 0.0, -exact.force_n])) < most
        gas = exact.gas_pressure_change_pa
        assert estimate.gas_pressure_change_pa == pytest.approx(gas, rel=most)
        points = solver.mesh.nodes + estimate.displacement_3d_m
        out, inside = np.hypot(*points[:, :2].T), ~solver.mesh.rim
        away = points[:, 2] - np.interp(out, exact.meridian.r_m, exact.meridian.z_m)
        assert np.sqrt(np.mean(away[inside] ** 2)) < 1e-4
    if not np.isfinite(ball):  # a plate carries the gas pressure and nothing else
        under = estimate.contact_pressure_pa[out < 0.7 * exact.contact_radius_m]
        assert np.median(under) == pytest.approx(GAUGE + gas, rel=0.05)


@pytest.mark.parametrize(("noise_m", "relative"), [(NOISE_M, 0.0), (0.0, 0.01)])
@pytest.mark.parametrize("name", ["sphere", "cylinder"])
def test_presses_on_another_mesh(name, noise_m, relative):
    mesh, contact = pressed(name, 0.007, 0.0)
    solver = estimator(relative=relative or NOISE_M / 0.065)
    estimate, _ = solver.estimate(
        depth_image_of(mesh, contact.displacement_3d_m, noise_m, relative)
    )
    assert estimate.status == "ok"
    assert error(estimate, contact.nodal_force_n.sum(axis=0)) < (0.06 if relative else 0.03)


@pytest.mark.long  # in short: on a coarse one, below
def test_two_small_contacts_are_found_on_a_fine_mesh():
    """Steps far from the solution must not explain errors of the linearisation by friction."""
    mesh, contact = pressed("two_spheres", 0.007, 0.0, nodes=4000)
    solver = estimator(2800, relative=5e-5 / 0.065)
    estimate, _ = solver.estimate(depth_image_of(mesh, contact.displacement_3d_m, 5e-5))
    assert estimate.status == "ok"
    assert error(estimate, contact.nodal_force_n.sum(axis=0)) < 0.01


@pytest.mark.parametrize(
    ("depth", "x", "noise_m"),
    [pytest.param(0.0018, 0.0, 5e-5, marks=pytest.mark.long), (0.0012, 0.003, 2e-4)],
)
def test_touches_smaller_than_a_triangle_are_found(depth, x, noise_m):
    """Two of 0.013 N, and one of 0.012 N: the mesh shows less than the gas pressure there."""
    mesh, contact = pressed("two_spheres", depth, x, nodes=4000)
    image = depth_image_of(mesh, contact.displacement_3d_m, noise_m)
    estimate, _ = estimator(600, relative=noise_m / 0.065).estimate(image)
    assert estimate.status == "ok"
    away = np.abs(estimate.force_n - contact.nodal_force_n.sum(axis=0))
    assert (away < np.maximum(1.96 * estimate.force_sigma_n, 0.001)).all()
    assert np.linalg.norm(away) < 0.003


@pytest.mark.parametrize(
    ("depth", "off_pa"), [(0.003, 15.0), pytest.param(0.007, -15.0, marks=pytest.mark.long)]
)
def test_measured_gas_pressure(depth, off_pa):
    """An error of the barometer does not become force: the bulge around the contact reveals it."""
    mesh, contact = pressed("sphere", depth)
    solver, image = estimator(1000), depth_image_of(mesh, contact.displacement_3d_m, NOISE_M)
    true_pa = contact.gas_pressure_change_pa
    estimate, _ = solver.estimate(image, solver.bubble.gas.P0 + true_pa + off_pa)
    assert estimate.status == "ok"
    assert error(estimate, contact.nodal_force_n.sum(axis=0)) < 0.03
    assert abs(estimate.gas_pressure_change_pa - true_pa) < 10.0
    rest = depth_image_of(mesh, np.zeros(len(mesh.nodes)), NOISE_M)
    assert solver.estimate(rest, solver.bubble.gas.P0 + off_pa)[0].status == "no_contact"


@pytest.mark.long  # in short: on the axis, above
def test_sharp_edged_rod_off_the_axis():
    """The ground truth resolves the edge, on which nodes of a uniform mesh catch as by friction."""
    there = pose(0.012, 0.006, H - 0.004)
    start = mesh_cap(CAP, 1000)

    def rubber(mesh):
        return RubberMembrane.uniform(mesh, GAUGE, TENSION, 1.05)

    mesh, contact = refined_press(rubber, gas_of, start, load_object("cylinder"), there)
    assert contact.converged
    force = contact.nodal_force_n.sum(axis=0)
    askew = np.degrees(np.arctan2(force[1], force[0]) - np.arctan2(-0.006, -0.012))
    assert abs(askew) < 3.0  # towards the axis, by symmetry; tens of degrees on an even mesh
    estimate, _ = estimator(800, 1.05).estimate(
        depth_image_of(mesh, contact.displacement_3d_m, NOISE_M)
    )
    assert estimate.status == "ok"
    assert error(estimate, force) < 0.03


@pytest.mark.parametrize(
    "change", [pytest.param({"nodes": 2000}, marks=pytest.mark.long), {"slack": 3 * RIM_SLACK_M}]
)
def test_invariance_to_irrelevant_changes(change):
    mesh, contact = pressed("sphere", 0.007)
    image = depth_image_of(mesh, contact.displacement_3d_m, NOISE_M)
    usual, other = (solver.estimate(image)[0] for solver in (estimator(), estimator(**change)))
    assert error(other, usual.force_n) < 0.03


@pytest.mark.parametrize("depth", [pytest.param(0.008, marks=pytest.mark.long), 0.011])
def test_highly_stretched_rubber_is_solved_from_rest(depth):
    """Close to constant tension it bends to single nodes, which once took all of the pressure."""
    mesh, contact = pressed("sphere", depth, prestretch=1.5)
    solver = estimator(prestretch=1.5)
    estimate, _ = solver.estimate(depth_image_of(mesh, contact.displacement_3d_m, NOISE_M))
    true = contact.nodal_force_n.sum(axis=0)
    assert estimate.status == "ok"
    assert error(estimate, true) < 0.03
    assert estimate.contact_pressure_pa.max() < 2.0 * contact.contact_pressure_pa.max()


def test_the_solution_does_not_depend_on_the_warm_start():
    noise_m, solver = NOISE_M, estimator(1000)
    finder = PatchFinder(solver.mesh, solver.held_pressure_pa, solver.resolution_m)
    image = image_of(0.007, 0.008, noise_m)
    cold, _ = solver.estimate(image)
    area = finder.find(cold).area_m2
    for depth, x in [(0.005, 0.008), (0.007, 0.004)]:
        _, start = solver.estimate(image_of(depth, x, noise_m, seed=1))
        warm, _ = solver.estimate(image, start=start)
        assert error(warm, cold.force_n) < 0.01
        assert abs(finder.find(warm).area_m2 / area - 1.0) < 0.03
    again, _ = solver.estimate(image)
    np.testing.assert_array_equal(again.force_n, cold.force_n)


def test_a_camera_that_is_better_than_its_noise_is_trusted_more():
    noise_m, true = 5e-5, pressed("sphere", 0.007, 0.008)[1].nodal_force_n.sum(axis=0)
    told, right = estimator(1000, relative=0.02), estimator(1000, relative=noise_m / 0.065)
    image = image_of(0.007, 0.008, noise_m)
    estimate, expected = told.estimate(image)[0], right.estimate(image)[0]
    assert error(estimate, true) < 0.02
    grid = 1.1 ** (1.0 / 3.0)  # noise factors that differ by one step of their grid count as equal
    assert expected.resolution_m / grid < estimate.resolution_m < 0.75 * told.resolution_m
    noisy, _ = told.estimate(image_of(0.007, 0.008, 0.02 * 0.065))
    assert (by_noise(estimate) < 0.5 * by_noise(noisy)).all()


def test_contact_below_the_noise_is_not_found_after_a_contact_either():
    """The image with contact has less noise, with which the weak one would be significant."""
    solver = estimator(1000, relative=0.02)
    first, start = solver.estimate(image_of(0.001, 0.008, 5e-5))
    weak = image_of(0.0008, 0.008, 5e-5, seed=1)
    assert first.status == "ok"
    assert solver.estimate(weak)[0].status == "no_contact"
    assert solver.estimate(weak, start=start)[0].status == "no_contact"


def test_a_warm_start_that_fits_worse_than_rest_is_discarded():
    solver = estimator()
    _, far = solver.estimate(image_of(0.011, 0.008, NOISE_M))
    for depth, x in ((0.002, -0.012), (0.0, 0.008)):
        image = image_of(depth, x, NOISE_M, seed=1)
        cold, warm = solver.estimate(image)[0], solver.estimate(image, start=far)[0]
        np.testing.assert_array_equal(warm.displacement_3d_m, cold.displacement_3d_m)
        np.testing.assert_array_equal(warm.contact_pressure_pa, cold.contact_pressure_pa)


def image_of(depth, x, noise_m, seed=0):
    mesh, contact = pressed("sphere", depth, x)
    return depth_image_of(mesh, contact.displacement_3d_m, noise_m, seed=seed)


@pytest.mark.parametrize("measured", [False, pytest.param(True, marks=pytest.mark.long)])
def test_sigma_of_a_light_touch_includes_the_uncertainty_of_the_material(measured):
    """It is solved in one step from rest, where the material makes no difference."""
    mesh, contact = pressed("sphere", 0.0008)
    usual, stiffer = (estimator(800, tension=factor * TENSION) for factor in (1.0, 1.05))
    image = depth_image_of(mesh, contact.displacement_3d_m, NOISE_M)
    gas = usual.bubble.gas.P0 + contact.gas_pressure_change_pa if measured else None
    rubber = usual.bubble
    varied = RubberBubble(rubber.membrane, rubber.gas, [stiffer.bubble.membrane])
    known, a, b = (
        each.estimate(image, gas)[0] for each in (usual, Estimator(usual.observer, varied), stiffer)
    )
    assert known.status == "ok" and b.force_n[2] != a.force_n[2]
    by_material = np.sqrt(a.force_sigma_n[2] ** 2 - known.force_sigma_n[2] ** 2)
    assert by_material == pytest.approx(abs(b.force_n[2] - a.force_n[2]), rel=0.3)


@pytest.mark.long  # in short: of a light touch, above
def test_sigma_includes_the_uncertainty_of_the_material():
    """Against a second solve with the other tension, and the scatter of noisy frames.

    With more noise than the mesh gets wrong, which counts in σ too and does not scatter.
    """
    mesh, contact = pressed("sphere", 0.007)
    noise_m, nodes = 5.0 * NOISE_M, 800
    usual = estimator(nodes, relative=noise_m / 0.065)
    stiffer = estimator(nodes, relative=noise_m / 0.065, tension=1.02 * TENSION)
    image = depth_image_of(mesh, contact.displacement_3d_m, noise_m)
    a, b = usual.estimate(image)[0], stiffer.estimate(image)[0]
    rubber = usual.bubble
    varied = RubberBubble(rubber.membrane, rubber.gas, [stiffer.bubble.membrane])
    unsure = Estimator(usual.observer, varied)
    both = unsure.estimate(image)[0].force_sigma_n[2]
    by_material = np.sqrt(both**2 - a.force_sigma_n[2] ** 2)
    assert by_material == pytest.approx(abs(b.force_n[2] - a.force_n[2]), rel=0.15)
    images = (
        depth_image_of(mesh, contact.displacement_3d_m, noise_m, seed=seed) for seed in range(6)
    )
    forces = np.array([usual.estimate(image)[0].force_n for image in images])
    assert np.all(forces.std(axis=0) < 2.0 * by_noise(a))
    assert forces[:, 2].std() > 0.4 * by_noise(a)[2]


def test_interval_of_the_force_has_the_correlations_of_its_components():
    """Against the magnitudes of forces that scatter with the covariance of the estimate."""
    mesh, contact = pressed("sphere", 0.007)
    solved = estimator().estimate(depth_image_of(mesh, contact.displacement_3d_m, NOISE_M))[0]
    force = np.array([-2.0, 0.0, -2.0])
    covariance = np.diag([0.01, 0.01, 0.01])
    for shared in (0.009, -0.009):  # of x and z
        covariance[0, 2] = covariance[2, 0] = shared
        wrench = block_diag(covariance, np.eye(3))
        estimate = replace(solved, force_n=force, wrench_covariance=wrench)
        drawn = np.random.default_rng(3).multivariate_normal(force, covariance, 4000)
        off = np.abs(np.linalg.norm(drawn, axis=1) - np.linalg.norm(force))
        assert np.mean(off < estimate.force_half_width_n) == pytest.approx(0.95, abs=0.015)


@pytest.mark.parametrize(
    ("name", "least", "held"),
    [("sphere", 0.92, 0.95), pytest.param("cylinder", 0.87, 0.75, marks=pytest.mark.long)],
)
def test_the_patch_overlaps_the_true_contact_and_its_band_holds_the_edge(name, least, held):
    mesh, contact = pressed(name, 0.007, 0.0, nodes=4000)
    solver = estimator(1000)
    estimate, _ = solver.estimate(depth_image_of(mesh, contact.displacement_3d_m, NOISE_M))
    patch = PatchFinder(solver.mesh, solver.held_pressure_pa, solver.resolution_m).find(estimate)
    inside = MembraneView(CAMERA, solver.mesh).above(estimate.motion_m, patch.level, 0.0)
    touching = touching_share(mesh, contact.contact_pressure_pa)
    truth = MembraneView(CAMERA, mesh).above(contact.displacement_3d_m, touching, 0.5)
    assert np.count_nonzero(inside & truth) > least * np.count_nonzero(inside | truth)
    view, band = MembraneView(CAMERA, solver.mesh), patch.edge_half_width_m
    surely, maybe = (view.above(estimate.motion_m, patch.level, each) for each in (band, -band))
    edge = (truth ^ binary_erosion(truth)) | (truth ^ binary_dilation(truth))
    assert np.count_nonzero(edge & maybe & ~surely) > held * np.count_nonzero(edge)
    gas = GAUGE + estimate.gas_pressure_change_pa
    assert patch.threshold_pa == pytest.approx(0.5 * gas)
    np.testing.assert_array_equal(patch.force_n, estimate.force_n)


@pytest.mark.long  # in short: in test_contact_refiner.py
def test_patch_area_equals_the_meridian_solution():
    """Without bias on a mesh as coarse as the contacts are small, at little and at much noise."""
    R = (A**2 + H**2) / (2 * H)
    for noise_m in (0.5 * NOISE_M, 5.0 * NOISE_M):
        solver, errors = estimator(1000, relative=noise_m / 0.065), []
        finder = PatchFinder(solver.mesh, solver.held_pressure_pa, solver.resolution_m)
        for depth in (0.005, 0.006, 0.009, 0.007):
            exact, surface = oracle(depth, BALL)
            image = depth_image_of(surface, np.zeros(len(surface.nodes)), noise_m)
            patch = finder.find(solver.estimate(image)[0])
            errors.append(patch.area_m2 / exact.contact_area_m2(R) - 1)
        assert abs(np.mean(errors)) < 0.08


def test_the_exact_membrane_is_the_default_where_the_prestretch_is_known():
    sensor = load_sensor("pico_flexx_75mm")
    small = {"nodes": 100}
    known = changed(sensor, membrane={"prestretch": 1.2, **small})
    unknown = changed(sensor, membrane=small)
    for each, name, solver in (
        (known, None, "rubber"),
        (unknown, None, "linear"),
        (unknown, "rubber", "rubber"),
        (known, "linear", "linear"),
    ):
        options = EstimatorOptions.named(name)
        assert Pipeline.of(each, options=options).estimator.solver_name == solver
