"""The membrane under an object against the forward model, and sliding seen in a depth image."""

import numpy as np
import pytest

from bubbleviz.inverse.scales import Scales
from bubbleviz.membrane.forward_model import ForwardModel
from bubbleviz.membrane.mesh import triangles_across
from bubbleviz.membrane.refine import refine
from bubbleviz.pipeline import Pipeline
from bubbleviz.pose.contact_points import contact_points
from bubbleviz.pose.object_model import ObjectModel
from bubbleviz.pose.observability import Directions
from bubbleviz.pose.pressed_membrane import PressedMembrane
from bubbleviz.pose.rigid_motion import motion_between, moved
from bubbleviz.pose.sliding import Sliding
from bubbleviz.sensor import load_sensor
from bubbleviz.simulation.synthetic_source import SyntheticSource
from bubbleviz.study.presses import made


@pytest.fixture(scope="module")
def pipeline():
    return Pipeline.of(load_sensor("pico_flexx_75mm"))


def seen(pipeline, name, T):
    """Contact and estimate of a noise-free image, and the image."""
    source = SyntheticSource(pipeline.model.sensor, made(name), T[None], sharp=True)
    frame = source[0]
    result = pipeline.process(frame, frozenset({"estimate", "patch"}))
    contact = contact_points(pipeline.mesh, result.estimate, result.patch)
    return contact, result.estimate, frame.depth_m


def pressed_of(pipeline, name):
    own, mesh = pipeline.estimator, refine(pipeline.mesh)
    return PressedMembrane(mesh, own.gas.behind(mesh), own.scales, ObjectModel(made(name)))


def pose(x=0.003, z=0.038):
    T = np.eye(4)
    T[:3, 3] = [x, -0.004, z]
    return T


def test_it_is_the_forward_model_in_other_words(pipeline):
    T = pose()
    contact, _, _ = seen(pipeline, "cylinder", T)
    model = pipeline.model
    mesh, gas, tension = model.mesh, model.gas, model.tension_n_per_m
    expected = ForwardModel(mesh, tension, gas).press(made("cylinder"), T).displacement_m
    membrane = PressedMembrane(mesh, gas, Scales.of(mesh, tension), ObjectModel(made("cylinder")))
    found = membrane.press(T, contact).displacement_m
    found = np.where(found == 0.0, expected, found)  # it stays at 0 far around
    assert np.count_nonzero(found != expected) > 0.1 * len(found)
    assert np.abs(expected).max() > 8e-3
    # nodes are pressed there, points of the object here: they differ by the edge's place in a facet
    assert np.sqrt(np.mean((found - expected) ** 2)) < 0.025 * np.abs(expected).max()


def test_sliding_is_pressing_anew_close_by(pipeline):
    T = pose()
    contact, _, _ = seen(pipeline, "cylinder", T)
    membrane = pressed_of(pipeline, "cylinder")
    motion = np.array([4e-4, -2e-4, 0.0, 0.0, 0.0, 0.02])
    press = membrane.press(T, contact)
    (slid,) = membrane.slid(press, motion[None], contact.center).T
    anew = membrane.press(moved(T, motion, contact.center), contact).displacement_m
    change = np.linalg.norm(anew - press.displacement_m)
    assert change > 1e-3
    assert np.linalg.norm(slid - anew) < 0.4 * change


def test_what_slides_far_away_no_longer_touches(pipeline):
    T = pose()
    contact, _, _ = seen(pipeline, "cylinder", T)
    membrane = pressed_of(pipeline, "cylinder")
    press = membrane.press(T, contact)
    far = np.array([[0.05, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.6, 0.0]])
    assert np.isfinite(membrane.slid(press, far, contact.center)).all()


def test_lifting_is_the_derivative_of_pressing(pipeline):
    T = pose()
    contact, _, _ = seen(pipeline, "cylinder", T)
    membrane = pressed_of(pipeline, "cylinder")
    motion = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    press = membrane.press(T, contact)
    (lifted,) = membrane.lifted(press, motion[:, None], contact.center).T
    anew = membrane.press(moved(T, -1e-5 * motion, contact.center), contact).displacement_m
    slope = (press.displacement_m - anew) / 1e-5
    assert np.median(lifted[lifted > 0.9]) == pytest.approx(1.0, abs=0.02)
    assert np.linalg.norm(lifted - slope) < 0.15 * np.linalg.norm(slope)


def test_no_contact_no_displacement(pipeline):
    contact, _, _ = seen(pipeline, "cylinder", pose())
    membrane = pressed_of(pipeline, "cylinder")
    press = membrane.press(pose(z=0.2), contact)
    assert not press.displacement_m.any()
    assert not membrane.slid(press, np.full((2, 6), 1e-4), contact.center).any()


@pytest.mark.parametrize("turn", [-0.12, 0.12])
def test_a_flat_face_that_turned_is_turned_back(pipeline, turn):
    T = pose()
    contact, _, depth = seen(pipeline, "cross", T)
    unit = np.eye(6)
    unit[3:, 3:] /= contact.radius_m
    open_ = Directions(unit, np.zeros(6), np.array([False, False, True, True, True, False]))
    sliding = Sliding(pipeline.estimator.observer, pressed_of(pipeline, "cross"))
    at, steps = moved(T, np.array([0.0, 0.0, 0.0, 0.0, 0.0, turn]), contact.center), []
    for _ in range(4):
        step = sliding.step(depth, contact, at, open_, 1e2 * np.eye(6), np.zeros(6))
        steps.append(step.motion)
        at = moved(at, step.motion, contact.center)
    assert step.ended
    left = motion_between(T, at, contact.center)
    assert abs(left[5]) < 0.25 * abs(turn)
    assert np.linalg.norm(left[:2]) < 4e-4
    assert np.allclose(np.array(steps)[:, 2:5], 0.0)


def test_what_holds_close_by_is_not_looked_at_again(pipeline, monkeypatch):
    T = pose()
    contact, _, depth = seen(pipeline, "cross", T)
    unit = np.eye(6)
    unit[3:, 3:] /= contact.radius_m
    open_ = Directions(unit, np.zeros(6), np.array([False, False, True, True, True, False]))
    pressed, looks = pressed_of(pipeline, "cross"), []
    press = pressed.press
    monkeypatch.setattr(pressed, "press", lambda *a: looks.append(a) or press(*a))
    sliding = Sliding(pipeline.estimator.observer, pressed)
    for shift in (0.0, 1e-4, 4e-3):
        at = moved(T, np.array([shift, 0.0, 0.0, 0.0, 0.0, 0.0]), contact.center)
        sliding.step(depth, contact, at, open_, 1e2 * np.eye(6), np.zeros(6))
    assert len(looks) == 2


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
