"""The probe at a pixel or a point, against rays cast by Open3D."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import bubbleviz as bv
from bubbleviz.diagnostics import Probe, profile
from bubbleviz.membrane import TriangleScene
from bubbleviz.pipeline import FrameOptions, Pipeline

sys.path.insert(0, str(Path(__file__).parents[1] / "ui"))
from fakes import FRAMES, DentSource, small_sensor

PIXELS = [(30, 40), (12, 55), (41, 22), (22, 61)]
SENSOR = small_sensor()


@pytest.fixture(scope="module")
def pipeline():
    return Pipeline.of(SENSOR)


@pytest.fixture(scope="module")
def result(pipeline):
    return pipeline.process(DentSource(SENSOR)[FRAMES - 1], frozenset({"estimate"}))


def ray_of(pixel):
    """Direction in B at unit depth; the camera looks along +z and is not turned."""
    camera, (row, column) = SENSOR.camera, pixel
    return np.array([(column - camera.cx) / camera.fx, (row - camera.cy) / camera.fy, 1.0])


def nodes_of(pipeline, result):
    return pipeline.mesh.nodes + result.estimate.displacement_m[:, None] * pipeline.mesh.normals


def met_by(ray, pipeline, result):
    """Corners of the facet that a ray from the camera meets, their weights, and the place."""
    nodes, start = nodes_of(pipeline, result), np.array(SENSOR.camera.position_m)
    found = TriangleScene(nodes, pipeline.mesh.triangles).cast(np.array([[*start, *ray]]))
    corners, place = pipeline.mesh.triangles[found.triangle[0]], start + found.distance[0] * ray
    return corners, np.linalg.solve(nodes[corners].T, place), place


@pytest.mark.parametrize("pixel", PIXELS)
def test_pixel_gives_its_point_and_the_values_on_its_ray(pipeline, result, pixel):
    found = Probe(pipeline.camera, pipeline.mesh).at_pixel(pixel, result)
    assert found is not None and found.pixel == pixel
    depth = float(result.frame.depth_m[pixel])
    point = np.array(SENSOR.camera.position_m) + depth * ray_of(pixel)
    np.testing.assert_allclose(found.point_m, point, atol=1e-7)
    corners, weights, place = met_by(ray_of(pixel), pipeline, result)
    np.testing.assert_allclose(found.membrane_m, place, atol=1e-6)
    assert found.node == corners[weights.argmax()]
    displacement, pressure = result.estimate.displacement_m, result.estimate.contact_pressure_pa
    assert found.displacement_m == pytest.approx(weights @ displacement[corners], abs=1e-6)
    assert found.pressure_pa == pytest.approx(weights @ pressure[corners], abs=1.0)
    np.testing.assert_allclose(found.membrane_pixel, pixel, atol=1e-9)


def test_pressure_is_continuous_and_that_of_the_picture_at_the_edge_of_the_patch(pipeline, result):
    """Beside a node without pressure it is not zero as far as a neighbour has some."""
    pressure, nodes = result.estimate.contact_pressure_pa, nodes_of(pipeline, result)
    corners = pipeline.mesh.triangles
    (edge, *_) = np.flatnonzero((pressure[corners] > 0.0).sum(axis=1) == 1)
    inner = corners[edge][pressure[corners[edge]].argmax()]
    outer = corners[edge][pressure[corners[edge]].argmin()]
    probe = Probe(pipeline.camera, pipeline.mesh)
    for share in (0.0, 0.1, 0.3, 0.6, 1.0):
        point = nodes[outer] + share * (nodes[inner] - nodes[outer])
        found = probe.at_point(point, result)
        assert found.pressure_pa == pytest.approx(share * pressure[inner], abs=1e-6)
        np.testing.assert_allclose(found.membrane_m, point, atol=1e-12)


@pytest.mark.parametrize("pixel", PIXELS)
def test_pixel_without_a_return_gives_the_values_on_its_ray(pipeline, result, pixel):
    depth = result.frame.depth_m.copy()
    depth[pixel] = np.nan
    blind = replace(result, frame=replace(result.frame, depth_m=depth))
    found = Probe(pipeline.camera, pipeline.mesh).at_pixel(pixel, blind)
    assert found is not None and np.isnan(found.point_m).all() and np.isnan(found.depth_m)
    np.testing.assert_allclose(
        found.membrane_m, met_by(ray_of(pixel), pipeline, result)[2], atol=1e-6
    )


def test_pixel_beside_the_membrane_gives_a_place_of_its_rim(pipeline, result):
    away = replace(result, estimate=None)
    found = Probe(pipeline.camera, pipeline.mesh).at_pixel((0, 0), away)
    rim = pipeline.mesh.nodes[pipeline.mesh.rim]
    assert np.linalg.norm(rim - found.membrane_m, axis=1).min() < pipeline.mesh.edge_length


def test_point_of_the_view_gives_its_pixel(pipeline, result):
    probe = Probe(pipeline.camera, pipeline.mesh)
    for pixel in PIXELS:
        point = np.array(SENSOR.camera.position_m) + 0.13 * ray_of(pixel)
        found = probe.at_point(point, result)
        assert found.pixel == pixel
        place = met_by(ray_of(pixel), pipeline, result)[2]
        np.testing.assert_allclose(found.membrane_m, place, atol=1e-6)
    height, width = result.frame.depth_m.shape
    for outside in ((-1, 5), (height, 5), (5, -1), (5, width)):
        point = np.array(SENSOR.camera.position_m) + 0.13 * ray_of(outside)
        assert probe.at_point(point, result).pixel is None
        assert probe.at_pixel(outside, result) is None


def test_without_an_estimate_the_membrane_is_at_rest(pipeline, result):
    found = Probe(pipeline.camera, pipeline.mesh).at_pixel((30, 40), replace(result, estimate=None))
    at_rest = found.barycentric @ pipeline.mesh.nodes[found.nodes]
    np.testing.assert_array_equal(found.membrane_m, at_rest)
    assert np.isnan([found.displacement_m, found.pressure_pa]).all()


def test_errors_of_the_whole_image_are_no_residual(pipeline):
    """As in the misfit of the estimate, which is fitted with them."""
    away = np.eye(4)
    away[2, 3] = 0.2
    frame = bv.simulate(SENSOR, "sphere", away)[0]
    off = replace(frame, depth_m=frame.depth_m + np.float32(5e-4))
    found = []
    for each in (frame, off):
        pipeline.restart()
        result = pipeline.process(each, frozenset({"estimate", "cloud", "residual"}))
        result = pipeline.diagnose(result, frozenset({"residual_image"}))
        image, cloud = result.inspection.images["residual"].ravel(), result.cloud_residual_m
        nodes = pipeline.model.node_residuals(each.depth_m, result.estimate)
        found.append(np.concatenate([image, cloud, nodes]))
    change = np.abs(found[1] - found[0])
    assert np.nanmax(change) < 1e-4


def test_residual_of_the_pixel_or_of_a_close_one(pipeline):
    """Otherwise there is none: in a decimated cloud the next point may be far away."""
    products = frozenset({"estimate", "cloud", "residual"})
    whole = pipeline.process(DentSource(SENSOR)[FRAMES - 1], products)
    probe, wide = Probe(pipeline.camera, pipeline.mesh), SENSOR.camera.width
    assert whole.cloud_pixels is not None and whole.cloud_residual_m is not None
    row, column = PIXELS[0]
    at = int(np.flatnonzero(whole.cloud_pixels == row * wide + column)[0])
    true = whole.cloud_residual_m[at]
    for kept, shown in (([at], [true, true, np.nan]), ([at - 40 * wide], [np.nan] * 3)):
        kept = [max(k, 0) for k in kept]
        thinned = replace(
            whole,
            cloud_m=None,
            cloud_pixels=whole.cloud_pixels[kept],
            cloud_residual_m=whole.cloud_residual_m[kept],
        )
        for off, expected in zip((0, 3, 5), shown, strict=True):
            found = probe.at_pixel((row, column + off), thinned)
            assert found.residual_m == pytest.approx(expected, nan_ok=True)


# -- profile ----------------------------------------------------------------------------------


ENDS = np.array([[-0.03, -0.012, 0.05], [0.05, 0.014, 0.04]])


def heights(nodes, triangles, along):
    """z of a surface below places along the line, by rays from above."""
    across = ENDS[1, :2] - ENDS[0, :2]
    places = ENDS[0, :2] + along[:, None] * across / np.linalg.norm(across)
    rays = np.array([[*place, 1.0, 0.0, 0.0, -1.0] for place in places])
    return 1.0 - TriangleScene(nodes, triangles).cast(rays).distance


def test_profile_follows_membrane_pressure_and_measured_points(pipeline, result):
    mesh, nodes = pipeline.mesh, nodes_of(pipeline, result)
    found = profile(pipeline.camera, mesh, result, ENDS)
    assert found is not None and (np.diff(found.along_m) >= 0.0).all()
    length = np.linalg.norm(np.diff(ENDS[:, :2], axis=0))
    assert found.along_m[0] == 0.0 and found.along_m[-1] == pytest.approx(length)
    # away from the crossings, too, as the membrane is straight between them
    for nodal, along, height in (
        (nodes, found.along_m, found.height_m),
        (mesh.nodes, found.rest_along_m, found.rest_height_m),
    ):
        places = np.linspace(along[0], along[-1], 101)[1:-1]
        expected = heights(nodal, mesh.triangles, places)
        np.testing.assert_allclose(np.interp(places, along, height), expected, atol=1e-6)
    assert (found.rest_height_m.max() - found.height_m.min()) > 0.01
    peak = result.estimate.contact_pressure_pa.max()
    assert 0.3 * peak < found.pressure_pa.max() <= peak


def test_measured_points_of_a_profile_lie_on_the_surface_that_was_seen(pipeline, result):
    """The images have no noise; a pixel is up to 1.3 mm beside the line."""
    untouched = replace(result, frame=DentSource(SENSOR)[0])
    lowest = []
    for shown in (untouched, result):
        found = profile(pipeline.camera, pipeline.mesh, shown, ENDS)
        rest = np.interp(found.measured_along_m, found.rest_along_m, found.rest_height_m)
        assert len(rest) > 15 and (np.diff(found.measured_along_m) >= 0.0).all()
        lowest.append((found.measured_height_m - rest).min())
        if shown is untouched:
            assert np.abs(found.measured_height_m - rest).max() < 1.3e-3
    assert lowest[1] < -0.01 < -0.002 < lowest[0]


def test_profile_without_a_trusted_estimate_has_the_measured_points(pipeline, result):
    unknown = replace(result, estimate=replace(result.estimate, status="implausible"))
    found = profile(pipeline.camera, pipeline.mesh, unknown, ENDS)
    assert np.isnan(found.height_m).all() and np.isnan(found.pressure_pa).all()
    assert len(found.measured_along_m) > 15
    above = np.array([ENDS[0], ENDS[0] + (0.0, 0.0, 0.01)])
    assert profile(pipeline.camera, pipeline.mesh, result, above) is None


@pytest.mark.parametrize("kappa", [None, 1.0])
def test_place_is_in_the_patch_or_outside(pipeline, kappa):
    products = frozenset({"estimate", "patch", "pixel_mask"})
    result = pipeline.process(DentSource(SENSOR)[FRAMES - 1], products)
    patch = pipeline.patch(result.estimate, FrameOptions(kappa), pixel_mask=True)
    result = replace(result, patch=patch)
    mask, probe = result.patch.pixel_mask, Probe(pipeline.camera, pipeline.mesh)
    middle = int(np.argmax(mask.sum(axis=1)))
    row = [probe.at_pixel((middle, column), result) for column in range(10, SENSOR.camera.width)]
    assert [place.in_patch for place in row] == mask[middle, 10:].tolist()
    assert {place.in_patch for place in row} == {True, False}
    unmasked = replace(result, patch=replace(result.patch, pixel_mask=None))
    same = [probe.at_pixel((middle, column), unmasked).in_patch == mask[middle, column]
            for column in range(10, SENSOR.camera.width)]  # fmt: skip
    assert np.mean(same) > 0.95  # by the level lines; the camera's pixels at the edge may differ
    untouched = probe.at_pixel((middle, 20), replace(result, patch=None))
    assert untouched.in_patch is None
