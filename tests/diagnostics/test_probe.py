"""The probe at a pixel, a node or a point, against independent rays and distances."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bubbleviz.diagnostics import Probe
from bubbleviz.pipeline import Pipeline

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


@pytest.mark.parametrize("pixel", PIXELS)
def test_pixel_gives_its_point_and_the_nearest_node(pipeline, result, pixel):
    found = Probe(pipeline.camera, pipeline.mesh).at_pixel(pixel, result)
    assert found is not None and found.pixel == pixel
    depth = float(result.frame.depth_m[pixel])
    point = np.array(SENSOR.camera.position_m) + depth * ray_of(pixel)
    np.testing.assert_allclose(found.point_m, point, atol=1e-7)
    nodes = nodes_of(pipeline, result)
    assert found.node == np.linalg.norm(nodes - point, axis=1).argmin()
    assert found.displacement_m == result.estimate.displacement_m[found.node]
    assert found.pressure_pa == result.estimate.contact_pressure_pa[found.node]
    x, y, z = nodes[found.node] - SENSOR.camera.position_m
    camera = SENSOR.camera
    seen = camera.cy + camera.fy * y / z, camera.cx + camera.fx * x / z
    np.testing.assert_allclose(found.node_pixel, seen, atol=1e-9)


@pytest.mark.parametrize("pixel", PIXELS)
def test_pixel_without_a_return_gives_the_node_nearest_to_its_ray(pipeline, result, pixel):
    depth = result.frame.depth_m.copy()
    depth[pixel] = np.nan
    blind = replace(result, frame=replace(result.frame, depth_m=depth))
    found = Probe(pipeline.camera, pipeline.mesh).at_pixel(pixel, blind)
    assert found is not None and np.isnan(found.point_m).all() and np.isnan(found.depth_m)
    away = nodes_of(pipeline, result) - SENSOR.camera.position_m
    from_ray = np.linalg.norm(np.cross(away, ray_of(pixel)), axis=1)
    assert found.node == from_ray.argmin()


def test_point_of_the_view_gives_its_pixel(pipeline, result):
    probe = Probe(pipeline.camera, pipeline.mesh)
    for pixel in PIXELS:
        point = np.array(SENSOR.camera.position_m) + 0.13 * ray_of(pixel)
        found = probe.at_point(point, result)
        assert found.pixel == pixel
        nodes = nodes_of(pipeline, result)
        assert found.node == np.linalg.norm(nodes - point, axis=1).argmin()
    height, width = result.frame.depth_m.shape
    for outside in ((-1, 5), (height, 5), (5, -1), (5, width)):
        point = np.array(SENSOR.camera.position_m) + 0.13 * ray_of(outside)
        assert probe.at_point(point, result).pixel is None
        assert probe.at_pixel(outside, result) is None


def test_without_an_estimate_the_membrane_is_at_rest(pipeline, result):
    found = Probe(pipeline.camera, pipeline.mesh).at_pixel((30, 40), replace(result, estimate=None))
    np.testing.assert_array_equal(found.node_m, pipeline.mesh.nodes[found.node])
    assert np.isnan([found.displacement_m, found.pressure_pa]).all()


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
