"""Poses as numbers and text."""

import numpy as np
import pytest

from bubbleviz.errors import InputError
from bubbleviz.files import angles_of_pose, checked_pose, pose_of_angles

QUARTER = np.pi / 2


def test_angles_rotate_about_fixed_x_then_y_then_z():
    T = pose_of_angles(np.array([0.1, 0.2, 0.3]), np.array([QUARTER, 0.0, QUARTER]))
    # y turns to z about x, and z stays where it is about z
    np.testing.assert_allclose(T @ [0.0, 1.0, 0.0, 1.0], [0.1, 0.2, 1.3, 1.0], atol=1e-12)
    # x stays about x, and turns to y about z
    np.testing.assert_allclose(T @ [1.0, 0.0, 0.0, 1.0], [0.1, 1.2, 0.3, 1.0], atol=1e-12)


def test_angles_of_a_pose_round_trip():
    angles = np.array([0.3, -0.7, 2.9])
    np.testing.assert_allclose(angles_of_pose(pose_of_angles(np.zeros(3), angles)), angles)


@pytest.mark.parametrize(
    ("place", "number", "says"),
    [
        ((0, 3), np.nan, "not a finite 4×4 matrix"),
        ((0, 0), 2.0, "not a rotation"),
        ((0, 0), -1.0, "not a rotation"),  # a mirror image
        ((2, 3), 35.0, "metres"),
    ],
)
def test_a_matrix_that_is_no_pose_is_refused(place, number, says):
    pose = np.eye(4)
    pose[place] = number
    with pytest.raises(InputError, match=says):
        checked_pose(pose)
