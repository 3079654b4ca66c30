"""Scalars of a contact with friction, against forces added by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.path import Path

from bubbleviz.diagnostics import ShearNumbers, shear_line
from bubbleviz.recordings import Frame
from bubbleviz.result import Estimate, FlowFit, Patch, Result, Slip, Traction

NODES = 5
UNKNOWN = (np.nan, np.nan)
HALF = 1.96 * 0.05
"""Of the 95 % interval at σ = 0.05."""


def dragged(across=(0.6, 0.8, 0.0), sigma=0.05, torque=(0.0, 0.0, 0.0), **changes):
    """Three nodes pressed down with 1 N each, dragged with 1 N in all, of five."""
    normal, along, moved = (np.zeros((NODES, 3)) for _ in range(3))
    normal[:3, 2] = -1.0
    along[:3] = np.array(across) / 3.0
    moved[1] = (3e-4, 4e-4, 0.0)
    moved[4] = 1e-2  # touches nothing
    known = {
        "nodal_force_n": normal + along,
        "friction_n": along,
        "wrench_covariance": np.diag([sigma**2] * 3 + [1e-8] * 3),
        "flow": FlowFit(0.1, 1.0, 2e-5),
    }
    zero = np.zeros(NODES)
    estimate = Estimate("ok", zero, zero, 0.0, 0.0, 0.0, **{**known, **changes})
    patch = Patch(0.0, zero, along.sum(axis=0), np.zeros(3), 1e-4, torque_nm=np.array(torque))
    traction = Traction("ok", 1e4 * normal, 1e4 * along, moved)
    frame = Frame(0, 0.0, np.zeros((1, 1), np.float32))
    return Result(frame, estimate, patch, traction=traction)


def test_force_and_direction_of_a_known_traction():
    found = ShearNumbers.of(dragged())
    assert found.force_n == pytest.approx((math.sqrt(10.0), HALF))
    assert found.normal_n == pytest.approx((3.0, HALF))
    assert found.tangential_n == pytest.approx((1.0, HALF))
    assert found.direction_deg == pytest.approx(
        (math.degrees(math.atan2(0.8, 0.6)), math.degrees(HALF))
    )
    assert found.displacement_m == pytest.approx((5e-4, 1.96 * 2e-5))
    assert np.isnan(found.slip_share).all()


def test_torque_is_about_the_normal_into_the_sensor():
    # right-handed about +z by 10 N·mm, so about −z by minus that
    twisted = ShearNumbers.of(dragged(torque=(0.0, 0.0, 0.01)))
    assert twisted.torque_nm == pytest.approx((-0.01, 1.96e-4))


def test_no_direction_is_shown_if_its_interval_is_too_wide():
    found = ShearNumbers.of(dragged(across=(0.06, 0.08, 0.0)))
    assert np.isnan(found.direction_deg).all() and found.tangential_n[0] == pytest.approx(0.1)


def test_from_depth_alone_forces_are_known_but_no_displacement_or_slip():
    found, with_texture = ShearNumbers.of(dragged(flow=None)), ShearNumbers.of(dragged())
    unknown = {"displacement_m": UNKNOWN, "slip_share": UNKNOWN}
    assert repr(found) == repr(replace(with_texture, **unknown))
    assert found.outline_n is not None
    alone = ShearNumbers.of(dragged(friction_n=np.zeros((NODES, 3))))
    for measure in (alone.tangential_n, alone.direction_deg, alone.torque_nm):
        assert np.isnan(measure).all()
    assert alone.outline_n is None
    doubtful, untouched = dragged(), dragged()
    doubtful = replace(doubtful, estimate=replace(doubtful.estimate, status="not_converged"))
    untouched = replace(untouched, estimate=replace(untouched.estimate, status="no_contact"))
    assert np.isnan(ShearNumbers.of(doubtful).force_n).all()
    assert ShearNumbers.of(untouched).force_n[0] == 0.0


def test_slip_is_a_share_with_its_interval():
    slip = Slip(np.zeros((9, 3)), np.zeros((9, 3)), np.zeros(9, bool), 0.25, 0.05)
    result = replace(dragged(), slip=slip)
    assert ShearNumbers.of(result).slip_share == pytest.approx((0.25, HALF))
    told = shear_line(result)
    assert told.startswith("force 3.16 ± 0.098 N with friction, torque")
    assert told.endswith(", slip 25 ± 9.8 %")


def test_ellipse_contains_95_percent_of_the_tangential_forces():
    root = np.array([[0.05, 0.02, 0.0], [0.0, 0.1, 0.03], [0.01, 0.0, 0.3]])
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = root @ root.T
    found = ShearNumbers.of(dragged(wrench_covariance=covariance))
    np.testing.assert_allclose(found.across_n, [0.6, 0.8])
    drawn = found.across_n + np.random.default_rng(0).standard_normal((20_000, 3)) @ root.T[:, :2]
    inside = Path(found.outline_n).contains_points(drawn)  # the normal is along z
    assert inside.mean() == pytest.approx(0.95, abs=0.01)
