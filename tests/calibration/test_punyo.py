"""The real press, if it is installed, and the preset made from it."""

import numpy as np
import pytest

from bubbleviz.calibration import collect_press, with_rubber
from bubbleviz.camera import PixelModel
from bubbleviz.files import file_hash
from bubbleviz.membrane import build_mesh
from bubbleviz.recordings import Recording, find_contact_free
from bubbleviz.sensor import load_sensor
from tests.small_press import changed

from .identified import identify


@pytest.fixture(scope="module")
def press(punyo_press):
    with Recording(punyo_press) as recording:
        yield recording


def test_gauge_pressure_from_the_press(press):
    """No wrench is used. The lab lies 225 m up, where the air has 98.7 kPa in the mean."""
    sea = {"atmospheric_pressure_pa": 101_325.0}
    found = identify(press, changed(load_sensor("punyo_oval_d405"), pneumatics=sea), range(40))
    result = with_rubber(found, [], press=collect_press(press, found.samples, found.given))
    gauge, _ = result.gauge_candidates
    local_pa = np.mean(found.samples.gas_pressure_pa) - 98_700.0
    assert result.surfaces.chosen == "free-form"
    assert not result.contradicts_file
    assert result.gauge.low < local_pa < result.gauge.high
    assert result.gauge.source.startswith("the press in")
    assert gauge.half_width < 0.15 * gauge.value
    assert gauge.low < local_pa < gauge.high
    assert result.prestretch is not None


def test_contact_free_frames(press):
    assert abs(find_contact_free(press).frames.stop - 60) <= 3


def test_preset_is_of_the_real_press(punyo_press):
    assert load_sensor("punyo_oval_d405").calibration.recording_sha256 == file_hash(punyo_press)


def test_preset_is_complete_and_small():
    sensor = load_sensor("punyo_oval_d405")
    assert sensor.calibration.recording == "punyo_press_a"
    low, high = sensor.calibration.tension_interval_n_per_m
    assert low < sensor.pneumatics.tension_n_per_m < high
    mesh = build_mesh(sensor)
    assert np.degrees(mesh.angles.min()) > 25.0
    np.testing.assert_allclose(mesh.nodes[mesh.rim, 2], 0.0, atol=1e-9)
    path = sensor.resolve(sensor.calibration.pixels_file)
    pixels = PixelModel.load(path)
    assert pixels.mask.shape == (480, 640)
    assert np.isfinite(pixels.noise_m[pixels.mask]).all() and (pixels.noise_m >= 0).all()
    assert path.stat().st_size < 600_000
