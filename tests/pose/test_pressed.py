"""The membrane under an object against the forward model, and sliding seen in a depth image."""

import numpy as np
import pytest

from bubbleviz.frames.synthetic import SyntheticSource
from bubbleviz.inverse.scales import Scales
from bubbleviz.membrane.build import build_mesh, reference_tension
from bubbleviz.membrane.forward import ForwardModel
from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.mesh import triangles_across
from bubbleviz.pipeline import Pipeline
from bubbleviz.pose.contact import contact_points
from bubbleviz.pose.model import ObjectModel
from bubbleviz.pose.motion import moved
from bubbleviz.pose.pressed import PressedMembrane
from bubbleviz.pose.sliding import Viewer, slide
from bubbleviz.pose.uncertainty import Directions
from bubbleviz.sensor import load_sensor
from bubbleviz.study.presses import made


@pytest.fixture(scope="module")
def pipeline():
    return Pipeline(load_sensor("pico_flexx_75mm"))


def seen(pipeline, name, T):
    """Contact and estimate of a noise-free image, and the image."""
    source = SyntheticSource(pipeline.sensor, made(name), T[None])
    frame = source[0]
    result = pipeline.process(frame, frozenset({"estimate", "patch"}))
    contact = contact_points(pipeline.mesh, result.estimate, result.patch)
    return contact, result.estimate, frame.depth_m


def pressed_of(pipeline, name):
    own = pipeline.estimator
    return PressedMembrane(own.mesh, own.gas, own.scales, ObjectModel(made(name)))


def pose(x=0.003, z=0.038):
    T = np.eye(4)
    T[:3, 3] = [x, -0.004, z]
    return T


def test_it_is_the_forward_model_in_other_words(pipeline):
    T = pose()
    contact, _, _ = seen(pipeline, "cylinder", T)
    mesh = build_mesh(pipeline.sensor)
    gas = Gas.of(pipeline.sensor.pneumatics, mesh)
    tension = reference_tension(pipeline.sensor, mesh)
    expected = ForwardModel(mesh, tension, gas).press(made("cylinder"), T).displacement_m
    membrane = PressedMembrane(mesh, gas, Scales.of(mesh, tension), ObjectModel(made("cylinder")))
    (found,) = membrane.press(T[None], contact)
    assert np.abs(expected).max() > 8e-3
    # nodes are pressed there, points of the object here: they differ by the edge's place in a facet
    assert np.sqrt(np.mean((found - expected) ** 2)) < 0.025 * np.abs(expected).max()


def test_poses_together_are_the_same_as_one_by_one(pipeline):
    T = pose()
    contact, _, _ = seen(pipeline, "cylinder", T)
    membrane = pressed_of(pipeline, "cylinder")
    other = moved(T, np.array([1e-3, 0.0, -5e-4, 0.01, 0.0, 0.1]), contact.center)
    both = membrane.press(np.stack([T, other]), contact)
    alone = membrane.press(other[None], contact)
    assert np.allclose(both[1], alone[0], atol=2e-5)


def test_no_contact_no_displacement(pipeline):
    contact, _, _ = seen(pipeline, "cylinder", pose())
    (found,) = pressed_of(pipeline, "cylinder").press(pose(z=0.2)[None], contact)
    assert not found.any()


@pytest.mark.parametrize("turn", [-0.12, 0.12])
def test_a_flat_face_that_turned_is_turned_back(pipeline, turn):
    T = pose()
    contact, estimate, depth = seen(pipeline, "cross", T)
    unit = np.eye(6)
    unit[3:, 3:] /= contact.radius_m
    open_ = Directions(unit, np.zeros(6), np.array([False, False, True, True, True, False]))
    sight = Viewer(pipeline.estimator.observer).look(depth, estimate, contact)
    membrane = pressed_of(pipeline, "cross")
    off = moved(T, np.array([0.0, 0.0, 0.0, 0.0, 0.0, turn]), contact.center)
    step = slide(membrane, sight, contact, off, open_, 1e2 * np.eye(6))
    assert abs(turn + step.motion[5]) < 0.4 * abs(turn)
    assert np.allclose(step.motion[2:5], 0.0)
    right = membrane.press(np.stack([T, off]), contact)
    misfits = np.sum((sight.residual_m - sight.model(right)) ** 2, axis=1)
    assert misfits[0] < 0.9 * misfits[1]


def test_neighbours_share_the_side(pipeline):
    triangles = pipeline.mesh.triangles
    across = triangles_across(triangles)
    for k in (0, 100, 1000):
        for corner in range(3):
            other = across[k, corner]
            if other >= 0:
                side = set(np.delete(triangles[k], corner))
                assert side <= set(triangles[other])
                assert other != k
    assert (across < 0).any()  # the rim
