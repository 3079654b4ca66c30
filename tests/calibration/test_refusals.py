"""Recordings unfit for calibration: one line each, nothing written."""

from dataclasses import replace

import numpy as np
import pytest

from bubbleviz.calibration import advice, grade
from bubbleviz.errors import InputError
from bubbleviz.progress import Cancelled

from .identified import identify, with_air
from .twin import ATMOSPHERE, FREE, HEIGHT, cast, make_twin, nominal_sensor


@pytest.fixture(scope="module")
def twin():
    return make_twin()


def refused(source, match, frames=range(12), sensor=None):
    with pytest.raises(InputError, match=match) as error:
        identify(source, sensor or nominal_sensor(), frames, nodes=200)
    assert "\n" not in str(error.value)
    assert str(error.value).startswith(source.name)
    return str(error.value)


def test_contact_in_every_frame(twin):
    text = refused(twin, "pressed in by", range(FREE + 8, FREE + 15))
    column, row = (int(x) for x in text.split("pixel (")[1].split(")")[0].split(", "))
    dent = np.array([0.0, 0.008, twin.truth.nodes[:, 2].max()])  # where the twin is pressed
    T = twin.camera.T_B_C
    uv = twin.intrinsics.project((dent - T[:3, 3]) @ T[:3, :3])
    assert np.hypot(column - uv[0], row - uv[1]) < 8.0


@pytest.mark.parametrize("missing", [0.2, 0.35])
def test_a_dent_of_which_pixels_are_missing(twin, missing):
    depth = twin.depth.copy()
    depth[:, np.random.default_rng(0).random(depth.shape[1:]) < missing] = np.nan
    refused(replace(twin, depth=depth), "pressed in by 4", range(FREE + 8, FREE + 15))


def test_a_dent_while_the_whole_dome_moves(twin):
    """By 0.15 mm rms at the top, as the gas pressure of a held press changes a little."""
    up = 1e-3 * twin.truth.nodes[:, 2] / HEIGHT
    moved, still = (cast(twin.truth, twin.camera, x) for x in (up, 0.0 * up))
    by_millimetre = twin.camera.depth_image(moved - still)
    shift_mm = 0.15 * np.random.default_rng(2).standard_normal((len(twin), 1, 1))
    depth = (twin.depth + shift_mm * by_millimetre).astype(np.float32)
    refused(replace(twin, depth=depth), "pressed in by", range(FREE + 8, FREE + 15))


@pytest.mark.parametrize("width", [4e-3, 5e-3])
def test_a_steep_dent(twin, width):
    """Its flanks are steps from one pixel to the next."""
    nodes = twin.truth.nodes
    dent = 5e-3 * np.exp(-np.sum((nodes[:, :2] - (0.0, 0.008)) ** 2, axis=1) / width**2)
    pressed, flat = (cast(twin.truth, twin.camera, x) for x in (-dent, 0.0 * dent))
    depth = twin.depth + twin.camera.depth_image(pressed - flat).astype(np.float32)
    refused(replace(twin, depth=depth), "pressed in by [34]")


def test_false_return_is_not_a_dent(twin):
    """A region measured 20 mm too near, as by a reflection, is excluded."""
    rows, columns = np.indices(twin.depth.shape[1:])
    depth = twin.depth.copy()
    depth[:, (rows - 70) ** 2 + (columns - 78) ** 2 < 36] -= 0.02
    found = identify(replace(twin, depth=depth), nominal_sensor(), range(12), nodes=200)
    assert not found.pixels.mask[67:74, 75:82].any()


@pytest.mark.parametrize("gauge", [0.0, pytest.param(-200.0, marks=pytest.mark.long)])
def test_no_gauge_pressure(twin, gauge):
    local = with_air(nominal_sensor(), ATMOSPHERE - 1.0)
    pressures = [ATMOSPHERE - 1.0 + gauge] * len(twin)
    refused(replace(twin, pressures=pressures), "not above the atmospheric", sensor=local)
    pressures = [ATMOSPHERE + gauge] * len(twin)  # or higher up, as the file names no place
    found = identify(replace(twin, pressures=pressures), nominal_sensor(), range(12), nodes=200)
    assert grade(found) == "doubtful"
    assert any("enter the atmospheric pressure of the place" in each for each in advice(found))


@pytest.mark.parametrize("factor", [1000.0, 10.0, 0.1, 0.001])
def test_wrong_unit(twin, factor):
    refused(replace(twin, depth=np.float32(factor) * twin.depth), "m in the median")


def test_flat_membrane(twin):
    rng = np.random.default_rng(0)
    normal = twin.camera.T_B_C[2, :3]  # of the rim plane, seen from the camera
    rays = twin.camera.intrinsics.rays()
    plane = 0.054 / (rays @ normal) * rays[..., 2]
    plane = np.where((plane > 0.0) & (plane < 0.15), plane, np.nan)
    noise = 5e-5 * rng.standard_normal((12, *plane.shape))
    refused(replace(twin, depth=(plane + noise).astype(np.float32)), "too flat|not cross the rim")


def test_half_of_the_dome_invisible(twin):
    depth = twin.depth.copy()
    depth[:, :, :88] = np.nan
    assert "too little to determine" in refused(
        replace(twin, depth=depth), "% of the dome is visible"
    )


@pytest.mark.parametrize("kind", ["drift", "shake", "little"])
def test_moving_camera(twin, kind):
    """A little is 0.45 mm, 1 % of the radius, to either side: as much an error of γ0."""
    rng = np.random.default_rng(1)
    shift = {
        "drift": np.linspace(0.0, 2e-3, 12),
        "shake": 1e-3 * rng.standard_normal(12),
        "little": np.linspace(-4.5e-4, 4.5e-4, 12),
    }[kind]
    refused(
        replace(twin, depth=twin.depth[:12] + shift[:, None, None].astype(np.float32)), "dome moves"
    )


def test_a_cancelled_step_stops_at_once(twin):
    steps = []

    def progress(step, done):
        steps.append(step)
        assert 0.0 <= done <= 1.0
        if step == "free-form surface":
            raise Cancelled

    with pytest.raises(Cancelled):
        identify(twin, nominal_sensor(), range(12), nodes=200, progress=progress)
    assert steps[0] == "reading frames" and "fitting the rubber" not in steps
