"""Scalars of a contact with friction, against forces added by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.path import Path

from bubbleviz.diagnostics import ShearEllipse, ShearNumbers
from bubbleviz.result import Slip, Traction

NODES = 5
UNKNOWN = (np.nan, np.nan)
HALF = 1.96 * 0.05
"""Of the 95 % interval at σ = 0.05."""


def traction(status="ok", across=(0.6, 0.8, 0.0), sigma=0.05):
    """Three nodes pressed down with 1 N each, dragged with 1 N in all, of five."""
    normal, along = np.zeros((NODES, 3)), np.zeros((NODES, 3))
    normal[:3, 2] = -1.0
    along[:3] = np.array(across) / 3.0
    moved = np.zeros((NODES, 3))
    moved[1] = (3e-4, 4e-4, 0.0)
    moved[4] = 1e-2  # touches nothing
    positions = np.array([[0.01, 0, 0], [-0.01, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0]])
    force = normal + along
    return Traction(
        status, force, normal, along, 1e4 * force, positions, moved, np.zeros(3),
        np.diag([sigma**2] * 3 + [1e-8] * 3), 2e-5,
    )  # fmt: skip


def test_force_and_direction_of_a_known_traction():
    found = ShearNumbers.of(traction())
    assert found.force_n == pytest.approx((math.sqrt(10.0), HALF))
    assert found.normal_n == pytest.approx((3.0, HALF))
    assert found.tangential_n == pytest.approx((1.0, HALF))
    assert found.direction_deg == pytest.approx(
        (math.degrees(math.atan2(0.8, 0.6)), math.degrees(HALF))
    )
    assert found.displacement_m == pytest.approx((5e-4, 1.96 * 2e-5))
    assert np.isnan(found.slip_share).all()


def test_torque_is_about_the_normal_into_the_sensor():
    twisted = traction(across=(0.0, 0.0, 0.0))
    twisted.nodal_force_n[0, 1] = 0.5  # at x = 10 mm
    twisted.nodal_force_n[1, 1] = -0.5
    twisted.tangential_force_n[:2] = twisted.nodal_force_n[:2] * (0.0, 1.0, 0.0)
    # right-handed about +z by 10 N·mm, so about −z by minus that
    assert ShearNumbers.of(twisted).torque_nm == pytest.approx((-0.01, 1.96e-4))


def test_no_direction_is_shown_if_its_interval_is_too_wide():
    found = ShearNumbers.of(traction(across=(0.06, 0.08, 0.0)))
    assert np.isnan(found.direction_deg).all() and found.tangential_n[0] == pytest.approx(0.1)


def test_from_depth_alone_forces_are_known_but_no_displacement_or_slip():
    found, with_texture = ShearNumbers.of(traction("depth_alone")), ShearNumbers.of(traction())
    unknown = {"displacement_m": UNKNOWN, "slip_share": UNKNOWN}
    assert repr(found) == repr(replace(with_texture, **unknown))
    assert ShearEllipse.of(traction("depth_alone")) is not None
    frictionless = replace(traction("depth_alone"), tangential_force_n=np.zeros((NODES, 3)))
    alone = ShearNumbers.of(frictionless)
    for measure in (alone.tangential_n, alone.direction_deg, alone.torque_nm):
        assert np.isnan(measure).all()
    assert ShearEllipse.of(frictionless) is None
    assert np.isnan(ShearNumbers.of(traction("not_converged")).force_n).all()
    assert ShearNumbers.of(traction("no_contact")).force_n[0] == 0.0


def test_slip_is_a_share_with_its_interval():
    slip = Slip(np.zeros((9, 3)), np.zeros((9, 3)), np.zeros(9, bool), 0.25, 0.05)
    assert ShearNumbers.of(traction(), slip).slip_share == pytest.approx((0.25, HALF))


def test_the_parts_of_a_traction_add_up_to_it():
    whole = traction()
    normal, along = whole.parts_pa
    np.testing.assert_allclose(normal + along, whole.traction_pa)
    np.testing.assert_allclose(along[:3], np.tile([2000.0, 8000.0 / 3.0, 0.0], (3, 1)))


def test_ellipse_contains_95_percent_of_the_tangential_forces():
    root = np.array([[0.05, 0.02, 0.0], [0.0, 0.1, 0.03], [0.01, 0.0, 0.3]])
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = root @ root.T
    whole = replace(traction(), wrench_covariance=covariance)
    ellipse = ShearEllipse.of(whole)
    np.testing.assert_allclose(ellipse.force_n, [0.6, 0.8])
    drawn = whole.force_n + np.random.default_rng(0).standard_normal((20_000, 3)) @ root.T
    inside = Path(ellipse.outline_n).contains_points(drawn[:, :2])  # the normal is along z
    assert inside.mean() == pytest.approx(0.95, abs=0.01)
