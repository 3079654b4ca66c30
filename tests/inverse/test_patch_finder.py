"""The contact patch of presses with known contact."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.optimize import least_squares
from scipy.stats import norm

from bubbleviz.camera import DepthCamera, MembraneView
from bubbleviz.inverse import (
    EstimatorOptions,
    PatchFinder,
    area_above,
    components,
    mean_pressure,
    without_small,
)
from bubbleviz.membrane import MembraneMesh, build_mesh, grown
from bubbleviz.pipeline import Pipeline
from bubbleviz.result import Estimate
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor import load_sensor
from bubbleviz.simulation import SyntheticSource
from tests.inverse.conftest import DOME_CAMERA, GAUGE, SENSOR, dome_images, fine_mesh
from tests.membrane.domes import pose
from tests.rubber_renders import rubber_truth

MESH = build_mesh(SENSOR, 2000)


def overlap(a, b):
    return float(np.count_nonzero(a & b) / np.count_nonzero(a | b))


def blurred(profile, width_m, mesh=MESH):
    """Nodal field of a profile of the distance from the apex, blurred over `width_m`."""
    step = 0.0005
    line = np.arange(-0.04, 0.04 + step / 2, step)
    image = gaussian_filter(profile(np.hypot(*np.meshgrid(line, line))), width_m / step)
    middle = len(line) // 2
    r = np.hypot(mesh.nodes[:, 0], mesh.nodes[:, 1])
    return np.interp(r, line[middle:], image[middle, middle:], right=0.0)


def made_up(pressure, gas=0.0):
    return Estimate("ok", np.zeros(len(pressure)), pressure, gas, 0.0, 0.0)


@pytest.mark.parametrize("ridge", [0.0, 10.0])
def test_the_edge_of_a_blurred_disc_is_found_with_and_without_a_ridge(ridge):
    """A disc of radius 18 mm, plain like a ball's or with a line load on its edge like a box's."""
    resolution = 0.003

    def profile(r):
        return GAUGE * (1.05 * (r < 0.018) + ridge * (np.abs(r - 0.018) < 0.0005))

    field = blurred(profile, resolution)
    patch = PatchFinder(MESH, GAUGE, resolution).find(made_up(field))
    ours = abs(np.sqrt(patch.area_m2 / np.pi) - 0.018)
    plain = abs(np.sqrt(area_above(MESH, field, 0.5 * GAUGE) / np.pi) - 0.018)
    assert ours < resolution
    assert not ridge or ours < 0.7 * plain


def test_the_face_between_two_line_loads_is_inside():
    """A flat bar with a line load on its long edges only, more than twice the pressure between."""
    blur, (x, y) = 0.0015, fine_mesh().nodes[:, :2].T
    inside_m = 0.006 - np.abs(y)
    face = 1.05 * norm.cdf(inside_m / blur) + 4.0 * np.exp(-0.5 * (inside_m / blur) ** 2)
    field = GAUGE * face * norm.cdf((0.015 - np.abs(x)) / blur)
    patch = PatchFinder(fine_mesh(), GAUGE, blur).find(made_up(np.where(field > 0.1, field, 0.0)))
    assert (patch.level > 0.0)[(inside_m > blur) & (np.abs(x) < 0.015 - 4.0 * blur)].all()


@pytest.mark.parametrize("changed", ["width", "blur"])
def test_the_area_of_a_small_contact_does_not_jump(changed):
    """A hump of some ten nodes whose width or blur changes by 1 %, while the same nodes touch."""
    r = np.hypot(MESH.nodes[:, 0], MESH.nodes[:, 1])
    finder, areas, touching = PatchFinder(MESH, GAUGE, 0.003), [], []
    for factor in 1.01 ** np.arange(60):
        width = 0.003 * (factor if changed == "width" else 1.5)
        blur = 0.003 if changed == "width" else 0.002 * factor
        hump = 4.0 * GAUGE * np.exp(-((r / width) ** 2))
        hump[hump < GAUGE] = 0.0
        areas.append(finder.find(replace(made_up(hump), resolution_m=blur)).area_m2)
        touching.append(np.count_nonzero(hump))
    assert min(touching) > 0
    same = np.diff(touching) == 0
    assert np.abs(np.diff(np.log(areas)))[same].max() < 0.3


def test_a_node_that_crosses_the_floor_does_not_change_the_area_by_a_jump():
    """At half the gauge pressure, next to a contact of some ten nodes."""
    r = np.hypot(MESH.nodes[:, 0], MESH.nodes[:, 1])
    pressure = np.where(r < 1.6 * MESH.edge_length, GAUGE * np.exp(2.0 - r / 0.003), 0.0)
    beside = np.flatnonzero(r > 1.6 * MESH.edge_length)
    node, areas = beside[np.argmin(r[beside])], []
    for share in (0.4999, 0.5001):
        pressure[node] = share * GAUGE
        areas.append(PatchFinder(MESH, GAUGE, 0.002).find(made_up(pressure.copy())).area_m2)
    assert areas[1] == pytest.approx(areas[0], rel=1e-3)


def test_a_small_contact_beside_a_large_one_is_drawn():
    """Also where it is unlikely, but not impossible, that the nodes between them touch."""
    large = np.hypot(MESH.nodes[:, 0], MESH.nodes[:, 1]) < 3.0 * MESH.edge_length
    touching = np.where(large, 3.0 * GAUGE, 0.0)
    ring = grown(MESH.rings, large)
    small = np.flatnonzero(grown(MESH.rings, ring) & ~ring)[0]
    touching[small] = 0.7 * GAUGE
    averaged = np.where(grown(MESH.rings, touching > 0.0), np.maximum(touching, 1e-6), 0.0)
    estimate = replace(made_up(touching), averaged_pressure_pa=averaged)
    patch = PatchFinder(MESH, GAUGE, 0.003).find(estimate)
    assert len(components(MESH, estimate, patch)) == 2


@pytest.mark.parametrize(("radius", "within"), [(0.006, 0.19), (0.012, 0.1), (0.018, 0.1)])
def test_the_edge_does_not_move_outwards_on_a_mesh_finer_than_the_blur(radius, within):
    """A disc whose pressure rises over several nodes: the nearest one is not yet inside.

    The contour of a narrow one lies outside its edge.
    """
    resolution = 0.003
    mesh = fine_mesh()
    field = blurred(lambda r: 5.0 * GAUGE * (r < radius), resolution, mesh)
    assert mesh.edge_length < 0.8 * resolution
    patch = PatchFinder(mesh, GAUGE, resolution).find(made_up(field))
    assert patch.area_m2 == pytest.approx(np.pi * radius**2, rel=within)


def test_the_band_around_the_edge():
    """As wide as the response; a smaller contact has no area that is certain."""
    resolution = 0.003
    finder = PatchFinder(MESH, GAUGE, resolution)
    for radius, sure in ((0.018, True), (0.002, False)):
        field = blurred(lambda r, radius=radius: 20.0 * GAUGE * (r < radius), resolution)
        patch = finder.find(made_up(field))
        inner, outer = patch.area_interval_m2
        assert inner < patch.area_m2 < outer
        assert (inner > 0.1 * patch.area_m2) is sure
        assert patch.edge_half_width_m == resolution
        if sure:
            widths = np.diff(np.sqrt(np.array([inner, patch.area_m2, outer]) / np.pi))
            assert widths == pytest.approx(resolution, rel=0.25)
    paper = finder.find(made_up(field), kappa=2.0)
    assert np.isnan([*paper.area_interval_m2, paper.edge_half_width_m]).all()


def test_removed_parts_lose_their_band():
    resolution = 0.003
    pressure = np.zeros(len(MESH.nodes))
    for x, radius in ((-0.02, 0.012), (0.03, 0.004)):
        pressure += 5.0 * GAUGE * (np.hypot(MESH.nodes[:, 0] - x, MESH.nodes[:, 1]) < radius)
    estimate = made_up(pressure)
    both = PatchFinder(MESH, GAUGE, resolution).find(estimate)
    one = without_small(MESH, estimate, both, 2e-4)
    alone = np.where(MESH.nodes[:, 0] < 0.01, pressure, 0.0)
    expected = PatchFinder(MESH, GAUGE, resolution).find(
        replace(estimate, contact_pressure_pa=alone)
    )
    assert one.area_m2 == pytest.approx(expected.area_m2, rel=0.02) != both.area_m2
    assert one.area_interval_m2 == pytest.approx(expected.area_interval_m2, rel=0.02)


def test_kappa_is_the_papers_threshold():
    rng = np.random.default_rng(0)
    pressure = 1e4 * rng.random(len(MESH.nodes)) ** 3
    patch = PatchFinder(MESH, GAUGE, 0.003).find(made_up(pressure), kappa=2.0)
    assert patch.threshold_pa == pytest.approx(2 * mean_pressure(MESH, pressure))
    assert np.array_equal(patch.node_mask, pressure > patch.threshold_pa)


def test_no_pressure_and_pressure_everywhere_are_patches_too():
    finder = PatchFinder(MESH, GAUGE, 0.003)
    nothing = finder.find(made_up(np.zeros(len(MESH.nodes))))
    assert (nothing.area_m2, nothing.force_n.tolist()) == (0.0, [0.0, 0.0, 0.0])
    everywhere = finder.find(made_up(np.full(len(MESH.nodes), 5.0 * GAUGE)))
    assert everywhere.area_m2 > 0.9 * MESH.facet_areas.sum()


@pytest.mark.parametrize("name", ["cylinder", "frustum"])
def test_a_flat_face_has_no_holes_where_the_camera_is_better_than_the_mesh(name):
    linear = EstimatorOptions(solver="linear")
    pipeline = Pipeline.of(load_sensor("punyo_oval_d405"), options=linear)
    sensor, there = pipeline.model.sensor, pose(0.006, 0.0, 0.022)
    source = SyntheticSource(sensor, load_object(name), [there], model="linear")
    truth = source.truth(0)
    patch = pipeline.process(source[0], frozenset({"patch", "pixel_mask"})).patch
    assert overlap(patch.pixel_mask, truth.patch_mask) > 0.8
    assert patch.force_n == pytest.approx(truth.force_n, abs=0.1)


def distance_m(center, points, radius_m):
    return np.linalg.norm(points - center, axis=1) - radius_m


def inside_m(points, touching, gap_m):
    """Distance (n,) of points within the edge of a ball's contact, by their gaps to the ball.

    Beside a contact the gap grows with the square of the distance from its edge. Nodes tell the
    edge only to half their distance: one touches as soon as a part of its cell does.
    """
    away = points - points[touching].mean(axis=0)
    radius, angle = np.linalg.norm(away, axis=1), np.arctan2(away[:, 1], away[:, 0])
    waves = [f(n * angle) for n in (1, 2) for f in (np.cos, np.sin)]
    edge = np.stack([np.ones_like(angle), *waves], axis=1)
    near = (gap_m > 2e-5) & (gap_m < 8e-4) & (radius < 0.03)
    root = np.sqrt(gap_m[near, None])
    fitted = np.linalg.lstsq(np.hstack([edge[near], root, root**2]), radius[near], rcond=None)[0]
    return np.where(radius < 0.03, edge @ fitted[: edge.shape[1]] - radius, -1.0)


@pytest.mark.long
@pytest.mark.parametrize(("noise_m", "least"), [(5e-5, 0.9), (1.5e-4, 0.88), (5e-4, 0.85)])
def test_the_patch_on_rubber_of_another_solver(identified, noise_m, least):
    """A ball, pressed 3 to 13 mm into a dome; its place is fitted to the nodes that touch it."""
    truth, radius_m = rubber_truth("dome_ball"), 0.01
    frames = dome_images(truth, truth["nodes_m"], truth["gauge_pressure_pa"], noise_m, 2)
    pipeline = Pipeline.of(load_sensor(identified), frames[0].intrinsics)
    ious = []
    for k, (x, touching) in enumerate(zip(truth["nodes_m"], truth["touching"], strict=True)):
        on = x[touching]
        start = on.mean(axis=0) + np.array([0.0, 0.0, radius_m])
        center = least_squares(distance_m, start, args=(on, radius_m)).x
        mesh = MembraneMesh(x, truth["triangles"], np.zeros(len(x), bool))
        view = MembraneView(DepthCamera.of(DOME_CAMERA), mesh)
        level = inside_m(truth["rest_m"], touching, distance_m(center, x, radius_m))
        seen = pipeline.process(frames[k], frozenset({"patch", "pixel_mask"})).patch.pixel_mask
        ious.append(overlap(seen, view.above(np.zeros(len(x)), level, 0.0)))
    assert np.mean(ious) > least
