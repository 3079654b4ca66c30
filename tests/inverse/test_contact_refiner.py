"""The contact on a finer mesh: against the meridian's equations, and presses on another mesh."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial import cKDTree

from bubbleviz.api.estimating import patch_options
from bubbleviz.averaging import StillFrames
from bubbleviz.camera import DepthCamera, MembraneView
from bubbleviz.files import preset_names
from bubbleviz.inverse import (
    EstimatorOptions,
    components,
    mesh_limits,
    touching_share,
    without_small,
)
from bubbleviz.membrane import ForwardModel, RubberForward, RubberMembrane, mesh_cap, refined_part
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import Frame
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor import Camera, Membrane, Pneumatics, Sensor, load_sensor
from tests.membrane.domes import CAP, CHAMBER, GAUGE, TENSION, A, H, dome, pose
from tests.oracles.rubber_oracle import AxialRubber

STRETCH = 1.2
RADIUS = (A**2 + H**2) / (2 * H)
BALL = 0.015
NOISE_M = 5e-5
VIEW = {"width": 160, "height": 160, "fx": 110.0, "fy": 110.0, "cx": 79.5, "cy": 79.5}
PRODUCTS = frozenset({"patch", "pixel_mask"})


def pipeline(nodes=500, noise_relative=NOISE_M / 0.065, solver=None):
    sensor = Sensor(
        name="dome",
        membrane=Membrane(rim_radius_m=A, height_m=H, prestretch=STRETCH, nodes=nodes),
        pneumatics=Pneumatics(gauge_pressure_pa=GAUGE, chamber_volume_m3=CHAMBER),
        camera=Camera(**VIEW, position_m=(0.0, 0.0, -0.05), noise_relative=noise_relative),
    )
    return Pipeline.of(sensor, options=EstimatorOptions.named(solver))


def frame_of(mesh, motion, noise_m=NOISE_M, seed=0):
    camera = DepthCamera.of(Camera(**VIEW, position_m=(0.0, 0.0, -0.05)))
    ranges = MembraneView(camera, mesh).range_image(motion)
    noise = noise_m * np.random.default_rng(seed).standard_normal(ranges.shape)
    return Frame(0, 0.0, camera.depth_image(ranges + noise))


@cache
def on_axis(depth):
    """True area of a ball's contact at rest, m², and the surface by the meridian's equations."""
    exact = AxialRubber.dome(A, H, STRETCH, GAUGE).press(depth, BALL)
    return exact.contact_area_m2(RADIUS), exact.surface(A, H)


@cache
def two_balls(membrane="rubber"):
    """A press of two balls by a forward model on a separate mesh, with the true pixels."""
    nodes = 2_000 if membrane == "rubber" else 4_000
    (rubber, gas), balls = dome(nodes, STRETCH), load_object("two_spheres")
    mesh = rubber.mesh
    if membrane == "rubber":
        contact = RubberForward(rubber, gas).press(balls, pose(z=H - 0.005))
        motion = contact.displacement_3d_m
    else:
        contact = ForwardModel(mesh, TENSION, gas).press(balls, pose(z=H - 0.004))
        motion = contact.displacement_m
    assert contact.converged
    share = touching_share(mesh, contact.contact_pressure_pa)
    camera = DepthCamera.of(Camera(**VIEW, position_m=(0.0, 0.0, -0.05)))
    return mesh, motion, MembraneView(camera, mesh).above(motion, share, 0.5)


def test_area_of_small_contacts_on_a_coarse_mesh_equals_the_meridian_solution():
    pipe, base, errors = pipeline(400), pipeline(400, solver="rubber-base"), []
    for depth in (0.002, 0.007):
        area_m2, surface = on_axis(depth)
        areas = []
        for seed in range(2):  # noise of one image changes the area by up to 3 %
            pipe.restart()
            image = frame_of(surface, np.zeros_like(surface.nodes), seed=seed)
            found = pipe.process(image, PRODUCTS)
            own = replace(found.estimate, fine=None)  # equal to that of `base`, see below
            plain = base.process(image, PRODUCTS, estimate=own)
            areas.append([found.patch.area_m2, plain.patch.area_m2])
        errors.append(np.abs(np.mean(areas, axis=0) / area_m2 - 1.0))
    refined, plain = np.transpose(errors)
    assert refined.max() < 0.1
    assert refined.mean() < 0.6 * plain.mean()


def test_area_of_a_small_contact_is_the_same_for_equivalent_estimates():
    """As two warm starts of one frame differ: pressure by 0.1 %, noise by a step of its grid."""
    pipe, differences = pipeline(400), []
    for depth in (0.002, 0.007):
        surface = on_axis(depth)[1]
        pipe.restart()
        image = frame_of(surface, np.zeros_like(surface.nodes))
        estimate = pipe.process(image, frozenset({"estimate"})).estimate
        other = replace(
            estimate,
            contact_pressure_pa=1.001 * estimate.contact_pressure_pa,
            displacement_3d_m=0.9995 * estimate.motion_m,
            resolution_m=1.1 ** (1 / 3) * estimate.resolution_m,
        )
        area, again = (
            pipe.process(image, PRODUCTS, estimate=each).patch.area_m2 for each in (estimate, other)
        )
        differences.append(again / area - 1.0)
    assert np.abs(differences).max() < 0.01


@pytest.mark.parametrize(
    ("membrane", "nodes", "closer"), [("rubber", 400, 0.1), ("linear", 500, 0.05)]
)
def test_the_pixels_of_two_small_contacts_are_closer_to_the_true_ones(membrane, nodes, closer):
    mesh, motion, truth = two_balls(membrane)
    overlaps = []
    for solver in (membrane, f"{membrane}-base"):
        pipe = pipeline(nodes, solver=solver)
        result = pipe.process(frame_of(mesh, motion), PRODUCTS)
        mask = result.patch.pixel_mask
        overlaps.append(np.count_nonzero(mask & truth) / np.count_nonzero(mask | truth))
        if membrane == "linear":
            pressure = result.estimate.contact_pressure_pa
            force = -(pipe.mesh.areas * pressure) @ pipe.mesh.normals
            np.testing.assert_allclose(result.patch.force_n, force, rtol=1e-12, atol=1e-15)
    assert overlaps[0] > overlaps[1] + closer


def test_the_mean_of_images_of_an_object_at_rest_is_refined_as_one_of_its_noise():
    mesh, motion, truth = two_balls()
    frames = [
        replace(frame_of(mesh, motion, 0.01 * 0.065, seed=k), index=k, time_s=k / 30.0)
        for k in range(11)
    ]
    pipe, overlaps = pipeline(500, 0.01), []
    for frame in (frames[5], StillFrames(pipe, frames).applied(frames[5])):
        pipe.restart()
        mask = pipe.process(frame, PRODUCTS).patch.pixel_mask
        overlaps.append(np.count_nonzero(mask & truth) / np.count_nonzero(mask | truth))
    assert overlaps[1] > overlaps[0] + 0.1
    refined, live = pipe.counts["fine_contact"], StillFrames(pipe)
    *_, last = map(live.applied, frames)
    assert last.images == 6 and not pipe.process(last, PRODUCTS).estimate.fine
    assert pipe.counts["fine_contact"] == refined  # live, the rate counts


def test_a_smooth_error_of_the_model_does_not_blur_the_contact():
    mesh, motion, _ = two_balls()
    frame = frame_of(mesh, motion)
    v, u = np.indices(frame.depth_m.shape) / 79.5 - 1.0
    saddle = replace(frame, depth_m=frame.depth_m + 2e-4 * (u**2 - v**2))
    pipe = pipeline(400)
    exact, off = pipe.process(frame, PRODUCTS), pipeline(400).process(saddle, PRODUCTS)
    assert off.patch.edge_half_width_m < 0.55 * (0.5 * pipe.mesh.edge_length)
    assert off.patch.area_m2 == pytest.approx(exact.patch.area_m2, rel=0.1)


@pytest.mark.parametrize("solver", ["paper", "fast", "linear-base", "rubber-base"])
def test_some_solvers_use_the_mesh_of_the_sensor(solver):
    _, surface = on_axis(0.007)
    pipe = pipeline(solver=solver)
    pipe.process(frame_of(surface, np.zeros_like(surface.nodes)), PRODUCTS)
    assert "fine_contact" not in pipe.counts


def test_refinement_keeps_force_and_pressure_of_the_estimate():
    _, surface = on_axis(0.005)
    image = frame_of(surface, np.zeros_like(surface.nodes))
    fine, coarse = (pipeline(solver=s).process(image, PRODUCTS) for s in (None, "rubber-base"))
    np.testing.assert_array_equal(fine.patch.force_n, coarse.patch.force_n)
    np.testing.assert_array_equal(
        fine.estimate.contact_pressure_pa, coarse.estimate.contact_pressure_pa
    )
    there = fine.estimate.fine
    load = there.mesh.areas @ there.contact_pressure_pa
    whole = pipeline().mesh.areas @ coarse.estimate.contact_pressure_pa
    assert load == pytest.approx(whole, rel=0.03)


def test_parts_of_a_refined_patch_add_up_and_small_ones_can_be_removed():
    mesh, motion, _ = two_balls()
    pipe = pipeline(400)
    result = pipe.process(frame_of(mesh, motion), PRODUCTS)
    parts = components(pipe.mesh, result.estimate, result.patch)
    assert len(parts) == 2
    assert sum(part.area_m2 for part in parts) == pytest.approx(result.patch.area_m2, rel=1e-6)
    between = 0.5 * (parts[0].area_m2 + parts[1].area_m2)
    one = without_small(pipe.mesh, result.estimate, result.patch, between)
    assert one.area_m2 == pytest.approx(parts[0].area_m2, rel=1e-6)
    pixels = pipe.model.view.patch_pixels(result.estimate, one)
    assert 0 < np.count_nonzero(pixels) < 0.7 * np.count_nonzero(result.patch.pixel_mask)
    assert not (pixels & ~result.patch.pixel_mask).any()
    whole, fine = result.patch.level, result.patch.fine_level
    away, node = cKDTree(pipe.mesh.nodes).query(result.estimate.fine.mesh.nodes)
    own = away < 1e-9
    assert np.count_nonzero(own) > 50
    np.testing.assert_array_equal(whole[node[own]], fine[own])
    assert (np.delete(whole, node[own]) <= fine.min()).all()
    assert one.node_mask.any()
    assert not (one.node_mask & ~result.patch.node_mask).any()


@pytest.mark.parametrize(("relative", "kappa"), [(0.02, None), (NOISE_M / 0.065, 2.0)])
def test_noisy_camera_and_threshold_of_the_paper_use_the_mesh_of_the_sensor(relative, kappa):
    _, surface = on_axis(0.007)
    pipe = pipeline(800, relative)
    image = frame_of(surface, np.zeros_like(surface.nodes), relative * 0.065)
    estimate = pipe.process(image, PRODUCTS, patch_options(kappa)).estimate
    assert estimate.status == "ok"
    assert "fine_contact" not in pipe.counts
    if kappa is not None:  # also after the contact was refined for the other threshold
        estimate = pipe.process(image, PRODUCTS, estimate=estimate).estimate
        assert estimate.fine is not None
    assert pipe.unfiltered_patch(estimate, kappa).fine_level is None


@pytest.mark.parametrize("name", preset_names("sensors"))
@pytest.mark.parametrize("solver", [None, "linear"])
def test_single_images_of_shipped_sensors_are_not_refined(name, solver):
    pipe = Pipeline.of(load_sensor(name), options=EstimatorOptions.named(solver))
    assert not mesh_limits(pipe.estimator)


def test_without_contact_nothing_is_refined():
    mesh = mesh_cap(CAP, 4_000)
    result = pipeline().process(frame_of(mesh, np.zeros_like(mesh.nodes)), PRODUCTS)
    assert result.estimate.status == "no_contact"
    assert result.estimate.fine is None
    assert result.patch.area_m2 == 0.0


def test_the_same_rubber_on_finer_triangles_has_the_same_energy_and_forces():
    """Of shapes that are linear on the coarse ones; with other stress-free triangles each."""
    mesh = mesh_cap(CAP, 200)
    random = np.random.default_rng(0)
    usual = RubberMembrane.uniform(mesh, GAUGE, 70.0, STRETCH)
    uneven = usual.inverse * random.uniform(0.9, 1.1, (len(mesh.triangles), 1, 1))
    rubber = RubberMembrane(mesh, GAUGE, uneven, usual.mu_h)
    everywhere = np.ones(len(mesh.triangles), bool)
    finer = refined_part(mesh, everywhere, random.random(len(mesh.triangles)) < 0.4)
    same = rubber.on(finer.mesh, finer.parent)
    x = mesh.nodes + 5e-4 * random.standard_normal(mesh.nodes.shape)
    fine_x = finer.values(x)
    assert same.energy(fine_x) == pytest.approx(rubber.energy(x), rel=1e-9)
    assert same.volume(fine_x) == pytest.approx(rubber.volume(x), rel=1e-9)
    moved = 1e-4 * random.standard_normal(mesh.nodes.shape)
    work = np.sum(rubber.force(x) * moved)
    assert np.sum(same.force(fine_x) * finer.values(moved)) == pytest.approx(work, rel=1e-9)


def test_submesh_ends_in_fixed_nodes_and_covers_its_triangles():
    mesh = mesh_cap(CAP, 300)
    inside = np.hypot(*mesh.nodes[mesh.triangles].mean(axis=1)[:, :2].T) < 0.6 * A
    chosen = np.hypot(*mesh.nodes[mesh.triangles].mean(axis=1)[:, :2].T) < 0.3 * A
    finer = refined_part(mesh, inside, chosen)
    assert finer.mesh.facet_areas.sum() == pytest.approx(mesh.facet_areas[inside].sum())
    areas = np.bincount(finer.parent, finer.mesh.facet_areas, minlength=len(inside))
    np.testing.assert_allclose(areas[inside], mesh.facet_areas[inside])
    parts = np.bincount(finer.parent, minlength=len(inside))
    assert (parts[chosen] == 4).all()
    assert np.count_nonzero(parts[inside & ~chosen] == 1) > np.count_nonzero(chosen)
    np.testing.assert_allclose(finer.values(mesh.nodes), finer.mesh.nodes, atol=1e-15)
    t = finer.mesh.triangles
    sides = np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1)
    edges, count = np.unique(sides, axis=0, return_counts=True)
    ends = np.zeros(len(finer.mesh.nodes), bool)
    ends[edges[count == 1]] = True
    np.testing.assert_array_equal(finer.mesh.rim, ends)
