"""The patch by the object ends at the object's edge and requires its pose."""

from dataclasses import replace

import numpy as np
import pytest

from bubbleviz.membrane import ObjectSurface, level_line
from bubbleviz.pipeline import OBJECT_PRODUCTS, Pipeline
from bubbleviz.pose import ObjectPatchFinder
from bubbleviz.result import Pose
from bubbleviz.sensor import load_sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation import DepthNoise, study_object
from tests.membrane.domes import pose
from tests.small_press import HeldPress, changed

RADIUS_M = 0.012  # of the cylinder's flat face


def upright(x=0.003, z=0.042):
    return pose(x, -0.002, z)


@pytest.fixture(scope="module")
def model():
    sensor = load_sensor("pico_flexx_75mm")
    return SensorModel.of(changed(sensor, membrane={"nodes": 1_200, "prestretch": 1.2}))


@pytest.fixture(scope="module")
def source(model):
    noise = DepthNoise(relative=0.005)
    poses = np.repeat(upright()[None], 3, axis=0)
    return HeldPress(model.sensor, study_object("cylinder"), poses, noise, model="linear")


@pytest.fixture(scope="module")
def used_pipeline(model):
    return Pipeline(model)


@pytest.fixture
def pipeline(used_pipeline):
    used_pipeline.restart()
    return used_pipeline


@pytest.fixture(scope="module")
def processed(used_pipeline, source):
    return used_pipeline.process(source[0], frozenset({"patch"}))


def outline(model, processed, T):
    """The patch by a cylinder at a pose, the middle (2,) of its outline, and radii about T."""
    finder = ObjectPatchFinder(model, ObjectSurface(study_object("cylinder")))
    found = finder.find(processed.estimate, processed.patch, Pose("ok", T))
    nodes = model.mesh.deformed(processed.estimate.motion_m)
    pieces = level_line(nodes, model.mesh.corners, found.level)[:, :, :2]
    middles = pieces.mean(axis=1)
    lengths = np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1)
    return found, lengths @ middles / lengths.sum(), np.linalg.norm(middles - T[:2, 3], axis=1)


def test_patch_of_a_flat_face_ends_at_its_edge(model, processed):
    found, _, radius = outline(model, processed, upright())
    assert radius.mean() == pytest.approx(RADIUS_M, abs=4e-4)
    assert np.abs(radius - RADIUS_M).mean() < 0.15 * model.mesh.edge_length
    assert found.area_m2 == pytest.approx(np.pi * RADIUS_M**2, rel=0.1)


def test_patch_ends_at_the_edge_with_outward_leaning_sides(model, processed):
    finder = ObjectPatchFinder(model, ObjectSurface(study_object("frustum")))
    found = finder.find(processed.estimate, processed.patch, Pose("ok", upright(z=0.044)))
    assert found.area_m2 == pytest.approx(0.025**2, rel=0.08)


def test_outline_follows_the_pose_at_a_constant_depth_image(model, processed):
    _, here, _ = outline(model, processed, upright())
    _, there, _ = outline(model, processed, upright(x=0.0045))
    assert there - here == pytest.approx([1.5e-3, 0.0], abs=4e-4)


@pytest.mark.parametrize("status", ["lost", "no_contact", "few_points", "no_data"])
def test_no_object_patch_without_a_pose_of_the_frame(model, processed, status):
    finder = ObjectPatchFinder(model, ObjectSurface(study_object("cylinder")))
    assert finder.find(processed.estimate, processed.patch, Pose(status, upright())) is None


def test_object_patch_on_request_changes_no_pose(pipeline, source):
    poses = []
    for products in (frozenset({"pose"}), OBJECT_PRODUCTS):
        pipeline.restart()
        pipeline.counts.clear()
        pipeline.track(source.obj, upright(x=0.004))
        results = [pipeline.process(source[k], products) for k in range(2)]
        assert [r.object_patch is not None for r in results] == ["object_patch" in products] * 2
        assert pipeline.counts["object_patch"] == 2 * ("object_patch" in products)
        poses.append([r.pose.T_B_O for r in results])
    np.testing.assert_array_equal(*poses)


def test_no_object_patch_when_lost_and_a_new_one_for_the_next_object(pipeline, source):
    pipeline.track(source.obj, upright())
    cylinder = pipeline.process(source[0], OBJECT_PRODUCTS)
    assert cylinder.object_patch is not None
    gone = replace(source[1], depth_m=np.full_like(source[1].depth_m, np.nan))
    lost = pipeline.process(gone, OBJECT_PRODUCTS)
    assert lost.pose.status == "lost" and lost.object_patch is None
    pipeline.track(study_object("sphere"), upright())
    ball = pipeline.process(source[2], OBJECT_PRODUCTS)
    if ball.object_patch is not None:
        assert ball.object_patch.area_m2 < 0.8 * cylinder.object_patch.area_m2
    pipeline.track(None)
    assert pipeline.process(source[2], OBJECT_PRODUCTS).object_patch is None
