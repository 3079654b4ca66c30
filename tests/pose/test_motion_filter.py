"""The motion filter against exact motion."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from bubbleviz.pose import START_DEVIATION, Motion, motion_between, moved, way_at

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


def test_unmeasured_directions_keep_their_uncertainty():
    motion = Motion.at_rest(np.eye(4), START_DEVIATION, CENTER)
    seen = np.diag([0.0, 0.0, 1e10, 1e6, 1e6, 0.0])
    after = motion.corrected(motion.T_B_O, seen)
    assert after.covariance[0, 0] == pytest.approx(START_DEVIATION[0] ** 2)
    assert after.covariance[5, 5] == pytest.approx(START_DEVIATION[5] ** 2)
    assert after.covariance[2, 2] < 2e-10


def test_change_of_centre_describes_the_same_motion():
    rotation = Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix()
    T = np.eye(4)
    T[:3, :3] = rotation
    rate = np.array([0.0, 0.01, 0.0, 0.3, -0.2, 0.5])
    here = Motion(T, rate, np.diag(np.arange(1.0, 13.0)), CENTER)
    there = here.about(np.array([0.05, 0.01, 0.02]))
    short = 1e-5
    assert np.allclose(here.after(short).T_B_O, there.after(short).T_B_O, atol=1e-9)
    assert np.allclose(there.about(CENTER).covariance, here.covariance)


def test_motion_length_is_the_longest_displacement_around():
    rng, radius = np.random.default_rng(0), 0.02
    around = rng.standard_normal((2000, 3))
    around *= radius / np.linalg.norm(around, axis=1, keepdims=True)
    for motion in ([1e-5, 0, 0, 0, 0, 1e-3], [0, 2e-5, 0, 5e-4, 0, 0], [1e-5, 0, 0, 0, 0, 0]):
        T = moved(np.eye(4), np.array(motion, float), np.zeros(3))
        way = np.linalg.norm(around @ T[:3, :3].T + T[:3, 3] - around, axis=1).max()
        assert way == pytest.approx(way_at(radius, np.array(motion, float)), rel=0.01)


def test_coasting_ends():
    moving = Motion(np.eye(4), np.array([0.1, 0, 0, 0, 0, 0.0]), np.eye(12), CENTER)
    assert moving.after(60.0).T_B_O[0, 3] < 0.1
    assert moving.after(-60.0).T_B_O[0, 3] > -0.1


def test_prediction_backward_undoes_that_forward():
    rate = np.array([0.02, -0.01, 0.0, 0.1, 0.0, -0.3])
    start = Motion.at_rest(np.eye(4), START_DEVIATION, CENTER)
    start = replace(start, velocity=rate)
    there = start.after(0.05)
    back = there.after(-0.05)
    np.testing.assert_allclose(back.T_B_O, start.T_B_O, atol=5e-5)
    np.testing.assert_allclose(back.center, CENTER, atol=5e-5)
    # where it was is known no better than where it will be
    assert np.all(np.diag(start.after(-0.05).covariance - start.covariance)[:6] > 0.0)
    np.testing.assert_allclose(
        np.diag(start.after(-0.05).covariance), np.diag(there.covariance), rtol=1e-2
    )


def test_coasting_uncertainty_follows_unknown_acceleration():
    """F P Fᵀ plus the effect of random accelerations: ½ a t² and a t, fully correlated."""
    rng, dt = np.random.default_rng(0), 0.05
    root = rng.standard_normal((12, 12))
    motion = Motion(np.eye(4), np.zeros(6), root @ root.T, CENTER)
    F = np.eye(12)
    F[:6, 6:] = dt * np.eye(6)
    noise = motion.after(dt).covariance - F @ motion.covariance @ F.T
    deviation = np.sqrt(np.diag(noise)[6:]) / dt  # of the acceleration
    assert np.all(deviation > 0.1)
    drawn = deviation * rng.standard_normal((100_000, 6))
    seen = np.cov(np.hstack([0.5 * dt**2 * drawn, dt * drawn]).T)
    scale = np.sqrt(np.outer(np.diag(noise), np.diag(noise)))
    np.testing.assert_allclose(noise / scale, seen / scale, atol=0.02)


def test_correction_equals_the_kalman_update():
    rng = np.random.default_rng(1)
    root, seen = rng.standard_normal((12, 12)), rng.standard_normal((6, 6))
    P, R = root @ root.T, seen @ seen.T + 0.1 * np.eye(6)
    motion = Motion(np.eye(4), rng.standard_normal(6), P, CENTER)
    H = np.eye(6, 12)
    gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    measured = 1e-4 * rng.standard_normal(6)
    T = moved(motion.T_B_O, (gain @ measured)[:6], CENTER)
    after = motion.corrected(T, np.linalg.inv(R))
    turned = np.kron(np.eye(4), T[:3, :3])  # with the object
    covariance = turned @ (np.eye(12) - gain @ H) @ P @ turned.T
    velocity = turned[:6, :6] @ (motion.velocity + (gain @ measured)[6:])
    np.testing.assert_allclose(after.covariance, covariance, atol=1e-8)
    np.testing.assert_allclose(after.velocity, velocity, atol=1e-7)
    np.testing.assert_allclose(after.information, np.linalg.inv(after.covariance[:6, :6]))


def test_unknown_turn_of_a_ball_stays_one_about_its_centre():
    """Whether it turned by its velocity or by a frame: its centre stays known to 0.01 mm."""
    arm, root = np.array([1e-3, 0.0, -0.013]), np.zeros((12, 12))
    root[:3, :3] = 1e-5 * np.eye(3)
    root[:6, 3:6] = 0.3 * np.vstack([np.cross(np.eye(3), arm).T, np.eye(3)])
    turn = np.array([1e-3, 0.0, 0.0, 0.1, -0.3, 0.2])
    start = Motion(np.eye(4), 250.0 * turn, root @ root.T, CENTER + arm)
    seen = moved(np.eye(4), turn, start.center)
    for there in (start.after(1.0 / 250.0), start.corrected(seen, 1e-6 * np.eye(6))):
        np.testing.assert_allclose(there.T_B_O, seen, atol=1e-12)
        ball = (there.T_B_O @ [*CENTER, 1.0])[:3]
        covariance = there.about(ball).covariance
        assert np.sqrt(np.linalg.eigvalsh(covariance[:3, :3]).max()) < 3e-5
        assert np.sqrt(np.linalg.eigvalsh(covariance[3:6, 3:6]).min()) > 0.29


def test_motions_up_to_half_a_turn_are_recovered():
    rng, still = np.random.default_rng(0), np.zeros(3)
    for angle in (0.0, 1e-10, 1e-5, 0.1, 1.5, 3.0, np.pi - 1e-6):
        axis = rng.standard_normal(3)
        vector = angle * axis / np.linalg.norm(axis)
        turned = moved(np.eye(4), np.concatenate([still, vector]), still)
        expected = expm(np.cross(np.eye(3), vector))
        np.testing.assert_allclose(turned[:3, :3], expected, atol=1e-13)
        np.testing.assert_allclose(motion_between(np.eye(4), turned, still)[3:], vector, atol=1e-8)
