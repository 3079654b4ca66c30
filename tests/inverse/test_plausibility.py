"""Which images are refused as implausible for the membrane."""

from dataclasses import replace

import numpy as np
import pytest

from bubbleviz.camera import Misfit
from bubbleviz.inverse import (
    GAS_NOISE,
    contradicts_measured_gas,
    reason_against_fit,
    reason_against_gas,
)
from bubbleviz.membrane import Gas
from tests.inverse.conftest import CAMERA, GAUGE, SENSOR, estimator, first


@pytest.mark.parametrize(
    ("deviations", "clumping", "regional", "white", "explained"),
    [
        (1.0, 1.0, 1.0, True, True),
        (4.5, 1.0, 1.0, True, True),
        (5.5, 1.0, 1.0, True, False),  # more than five deviations are not noise
        (5.5, 1.0, 1.0, False, False),
        (2.0, 5.0, 1.0, True, True),
        (2.0, 7.0, 1.0, True, False),  # six times what white noise leaves in squares of blocks
        (2.0, 7.0, 1.0, False, True),
        (1.2, 50.0, 9.5, True, True),  # smaller than the noise, whatever its shape
        (1.0, 1.0, 10.5, False, False),  # a square is off by more than ten
    ],
)
def test_a_misfit_is_noise_up_to_a_size_and_a_shape(
    deviations, clumping, regional, white, explained
):
    small, large = (Misfit(rms, deviations, clumping, regional) for rms in (1e-4, 0.03))
    assert (reason_against_fit(small, white, 0.1) == "") is explained
    assert "mm from any shape" in reason_against_fit(large, white, 0.1)


def image(depth_m):
    return np.full((CAMERA.intrinsics.height, CAMERA.intrinsics.width), depth_m, np.float32)


@pytest.mark.parametrize("depth_m", [0.11, 0.14])
def test_a_plane_that_is_no_pressed_dome_is_refused(depth_m):
    """The first would compress the gas further than a dome pressed flat does."""
    found = first(estimator(), image(depth_m))
    assert found.status == "implausible"
    assert not found.displacement_m.any() and np.isnan(found.gas_pressure_change_pa)


def test_a_plane_across_the_dome_is_a_large_plate():
    """29 mm deep: it carries the pressure of the gas, by the volume of the cap that is gone.

    And more, as the image shows the plane up to its edges, where the cap has ended.
    """
    solver, radius, depth = estimator(), (0.075**2 + 0.05**2) / 0.1, 0.029
    found, gas = first(solver, image(0.125)), solver.bubble.gas
    gone = np.pi * depth**2 * (radius - depth / 3.0)
    assert found.status == "ok"
    pressure = gas.P0 * gas.V0 / (gas.V0 - gone) - gas.P0
    assert 1.0 <= found.gas_pressure_change_pa / pressure <= 1.2
    area = np.pi * (2.0 * radius * depth - depth**2)
    assert 1.0 <= -found.force_n[2] / ((GAUGE + pressure) * area) <= 1.2


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_gas_pressure_off_by_more_than_its_errors_contradicts_the_shape(sign):
    """A twentieth of the gauge pressure, or five deviations: 10 Pa, 2 % of p_v and the zero."""
    gas = Gas.of(SENSOR.pneumatics, estimator().mesh)

    def contradicted(off_pa, measured_pa, gas=gas, gauge_sigma_pa=0.0):
        asked_pa = measured_pa + sign * off_pa
        return contradicts_measured_gas(asked_pa, measured_pa, gas, GAUGE, gauge_sigma_pa)

    assert not contradicted(0.99 * 0.05 * GAUGE, 100.0) and contradicted(0.0505 * GAUGE, 100.0)
    five = 5.0 * np.hypot(GAS_NOISE * gas.P0, 0.02 * 4000.0)
    assert five > 0.05 * GAUGE
    assert not contradicted(0.99 * five, 4000.0) and contradicted(1.01 * five, 4000.0)
    assert not contradicted(900.0, 100.0, replace(gas, zero_sigma_pa=200.0))
    stiffness = {"gauge_sigma_pa": 0.3 * GAUGE}  # as uncertain as the gauge pressure
    assert not contradicted(500.0, 1000.0, **stiffness) and contradicted(600.0, 1000.0, **stiffness)


def test_gas_pressures_from_deflated_to_pressed_flat_are_plausible():
    mesh, pneumatics = estimator().mesh, SENSOR.pneumatics
    gas = Gas.of(pneumatics, mesh)
    lowest = -pneumatics.gauge_pressure_pa
    highest = gas.P0 * mesh.cap_volume() / pneumatics.chamber_volume_m3
    for change, believed in (
        (1.01 * lowest, False), (0.99 * lowest, True), (0.0, True),
        (0.99 * highest, True), (1.01 * highest, False), (np.inf, False),
    ):  # fmt: skip
        assert (reason_against_gas(change, gas) == "") is believed
    without_limits = Gas(gas.P0, gas.V0, gas.dV_du)
    assert reason_against_gas(1.01 * lowest, without_limits) == ""
    assert reason_against_gas(1.01 * highest, without_limits) == ""
