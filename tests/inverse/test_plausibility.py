"""What is refused as an image of this membrane."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import sparse

from bubbleviz.camera import Misfit, RangeObserver
from bubbleviz.inverse import contradicts_gas, reason_against_fit, reason_against_gas
from bubbleviz.membrane import Gas
from tests.inverse.conftest import CAMERA, SENSOR, estimator, first


@pytest.mark.parametrize(
    ("deviations", "clumping", "white", "explained"),
    [
        (1.0, 1.0, True, True),
        (4.5, 1.0, True, True),
        (5.5, 1.0, True, False),  # more than five deviations are not noise
        (5.5, 1.0, False, False),
        (2.0, 5.0, True, True),
        (2.0, 7.0, True, False),  # six times as much as white noise leaves in squares of blocks
        (2.0, 7.0, False, True),
        (1.2, 50.0, True, True),  # smaller than the noise, whatever its shape
    ],
)
def test_a_misfit_is_noise_up_to_a_size_and_a_shape(deviations, clumping, white, explained):
    assert (reason_against_fit(Misfit(1e-4, deviations, clumping), white) == "") is explained


@pytest.mark.parametrize("depth_m", [0.11, 0.125])
def test_a_plane_across_the_dome_is_given_up_early(depth_m, monkeypatch):
    """Every pass finds another shape, none nearer: the first three say so, of seven there may be.

    The farther one was taken for a press.
    """
    casts, cast = [], RangeObserver.linearise
    monkeypatch.setattr(
        RangeObserver, "linearise", lambda self, *at: casts.append(at) or cast(self, *at)
    )
    solver = estimator()
    casts.clear()
    size = CAMERA.intrinsics.height, CAMERA.intrinsics.width
    found = first(solver, np.full(size, depth_m, np.float32))
    assert found.status == "implausible" and "not near this membrane" in found.reason
    assert len(casts) <= 3
    assert not found.displacement_m.any() and np.isnan(found.gas_pressure_change_pa)


@pytest.mark.parametrize(
    ("deviations", "gas_noise", "measured", "contradicted"),
    [
        (0.0, 0.0, 0.0, False),
        (4.0, 0.0, 0.0, False),  # as far as five of its deviations may be noise
        (7.0, 0.0, 0.0, True),
        (-7.0, 0.0, 0.0, False),  # contact pushes: what is too high is taken for it
        (7.0, 3.0, 0.0, True),
        (7.0, 4.0, 0.0, False),  # within two deviations of the gas sensor
        (7.0, 0.0, None, False),
    ],
)
def test_a_bulge_that_no_contact_explains_contradicts_the_gas_sensor(
    deviations, gas_noise, measured, contradicted
):
    """Ranges of one bulge, whose pressure and its deviation are those of a straight line's fit."""
    bulge = np.linspace(0.1, 1.0, 30)
    sigma = 0.02
    deviation = sigma / np.linalg.norm(bulge)
    Q = sparse.eye_array(30, format="csr") / sigma**2
    seen = 0.3 + deviations * deviation
    problem = SimpleNamespace(Q=Q, g=Q @ (seen * bulge), measured_gas=measured)
    found = contradicts_gas(problem, bulge, 0.3 * bulge, gas_noise * deviation)
    assert found is contradicted


def test_a_gas_pressure_is_believed_from_no_gauge_pressure_to_the_cap_pressed_flat():
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
