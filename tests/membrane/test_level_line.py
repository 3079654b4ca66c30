"""Level lines of nodal fields, against fields with known lines."""

import numpy as np
import pytest

from bubbleviz.membrane import build_mesh, level_line
from bubbleviz.sensor import load_sensor

MESH = build_mesh(load_sensor("pico_flexx_75mm"), 1500)
RADIUS_M = float(np.linalg.norm(MESH.nodes[MESH.rim][:, :2], axis=1).max())


@pytest.mark.parametrize("share", [0.05, 0.4, -0.7])
def test_level_line_of_a_linear_field_is_straight(share):
    across = np.array([0.6, 0.8, 0.0])
    pieces = level_line(MESH.nodes, MESH.corners, MESH.nodes @ across, share * RADIUS_M)
    np.testing.assert_allclose(pieces @ across, share * RADIUS_M, atol=1e-12)
    # every end is another's, too, but the two at the rim
    ends = np.round(pieces.reshape(-1, 3), 9)
    _, count = np.unique(ends, axis=0, return_counts=True)
    assert sorted(count)[:3] == [1, 1, 2] and count.max() == 2


def test_the_level_line_of_a_radial_field_is_a_circle():
    radius = np.linalg.norm(MESH.nodes[:, :2], axis=1)
    pieces = level_line(MESH.nodes, MESH.corners, radius, 0.5 * RADIUS_M)
    length = np.linalg.norm(pieces[:, 1, :2] - pieces[:, 0, :2], axis=1).sum()
    assert length == pytest.approx(np.pi * RADIUS_M, rel=5e-3)


def test_a_field_that_does_not_reach_the_level_has_no_line():
    assert level_line(MESH.nodes, MESH.corners, MESH.nodes[:, 0], 1.0).shape == (0, 2, 3)
