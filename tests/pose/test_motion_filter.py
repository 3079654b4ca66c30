"""The motion filter against exact motion."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bubbleviz.pose.motion_filter import START_DEVIATION, Motion
from bubbleviz.pose.rigid_motion import motion_between

CENTER = np.array([0.01, 0.0, 0.04])


def test_velocity_is_learned_and_coasted():
    rate = np.array([0.02, -0.01, 0.0, 0.1, 0.0, -0.3])
    truth = Motion(np.eye(4), rate, np.eye(12), CENTER)
    motion = Motion.at_rest(np.eye(4), START_DEVIATION, CENTER)
    precise = np.diag([1e-5] * 3 + [1e-3] * 3)
    information = np.linalg.inv(precise**2)
    for _ in range(40):
        truth, motion = truth.after(1 / 30), motion.after(1 / 30)
        motion = motion.corrected(truth.T_B_O, information)
    assert np.allclose(motion.velocity, rate, atol=2e-2 * np.abs(rate).max() + 1e-3)
    later = motion.after(0.1)
    off = motion_between(truth.after(0.1).T_B_O, later.T_B_O, CENTER)
    assert np.linalg.norm(off[:3]) < 1e-3
    assert np.linalg.norm(off[3:]) < 1e-2
    assert np.all(np.linalg.eigvalsh(later.covariance) > 0.0)


def test_what_is_not_measured_stays_as_uncertain_as_it_was():
    motion = Motion.at_rest(np.eye(4), START_DEVIATION, CENTER)
    seen = np.diag([0.0, 0.0, 1e10, 1e6, 1e6, 0.0])
    after = motion.corrected(motion.T_B_O, seen)
    assert after.covariance[0, 0] == pytest.approx(START_DEVIATION[0] ** 2)
    assert after.covariance[5, 5] == pytest.approx(START_DEVIATION[5] ** 2)
    assert after.covariance[2, 2] < 2e-10


def test_another_centre_is_another_name_for_the_same_motion():
    rotation = Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix()
    T = np.eye(4)
    T[:3, :3] = rotation
    rate = np.array([0.0, 0.01, 0.0, 0.0, 0.0, 0.5])
    here = Motion(T, rate, np.diag(np.arange(1.0, 13.0)), CENTER)
    there = here.about(np.array([0.05, 0.01, 0.02]))
    short = 1e-5
    assert np.allclose(here.after(short).T_B_O, there.after(short).T_B_O, atol=1e-9)
    assert np.allclose(there.about(CENTER).covariance, here.covariance)


def test_coasting_ends():
    moving = Motion(np.eye(4), np.array([0.1, 0, 0, 0, 0, 0.0]), np.eye(12), CENTER)
    assert moving.after(60.0).T_B_O[0, 3] < 0.1
    assert np.allclose(moving.after(-1.0).T_B_O, np.eye(4))
