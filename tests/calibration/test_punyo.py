"""The real press, where it is at hand, and the preset made from it."""

from pathlib import Path

import numpy as np
import pytest

from bubbleviz.calibration.contact_free import find_contact_free
from bubbleviz.calibration.identify import identify
from bubbleviz.calibration.residuals import measure_residuals
from bubbleviz.camera.pixels import PixelModel
from bubbleviz.frames.recording import Recording
from bubbleviz.membrane.build import build_mesh
from bubbleviz.sensor import load_sensor

PRESS = Path(__file__).parents[3] / "shared" / "data" / "punyo_press_a"
needs_press = pytest.mark.skipif(not PRESS.exists(), reason="the real recording is not here")


@pytest.fixture(scope="module")
def press():
    recording = Recording(PRESS)
    yield recording
    recording.close()


@needs_press
def test_contact_free_frames(press):
    assert abs(find_contact_free(press).frames.stop - 60) <= 3


@needs_press
def test_held_out_residual_and_fits(press):
    found = identify(press, load_sensor("punyo_oval_d405"), range(40))
    got = measure_residuals(
        [press[k] for k in range(40, 60)],
        found.modelled_range_m,
        found.camera.range_per_depth,
        found.pixels,
    )
    assert got.rms_m < 0.25e-3
    assert got.rectified_rms_m < 0.08e-3
    assert np.abs(got.drift_m).max() < 1e-5
    semi_axes = found.fits.ellipsoid.ellipsoid.semi_axes_m
    np.testing.assert_allclose(np.sort(semi_axes), [0.0416, 0.0437, 0.0585], atol=1e-3)
    assert found.pixels.mask.sum() > 180_000


def test_preset_is_whole_and_small():
    sensor = load_sensor("punyo_oval_d405")
    mesh = build_mesh(sensor)
    assert np.degrees(mesh.min_angle) > 25.0
    np.testing.assert_allclose(mesh.nodes[mesh.rim, 2], 0.0, atol=1e-9)
    assert sensor.calibration is not None
    path = sensor.resolve(sensor.calibration.pixels_file)
    pixels = PixelModel.load(path)
    assert pixels.mask.shape == (480, 640)
    assert np.isfinite(pixels.noise_m[pixels.mask]).all() and (pixels.noise_m >= 0).all()
    assert path.stat().st_size < 600_000
