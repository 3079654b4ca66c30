"""The real press, if it is installed, and the preset made from it."""

import numpy as np
import pytest

from bubbleviz.calibration import collect, collect_press, with_rubber, write_sensor
from bubbleviz.camera import PixelModel
from bubbleviz.errors import InputError
from bubbleviz.files import file_hash
from bubbleviz.membrane import build_mesh
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import Recording, find_contact_free
from bubbleviz.sensor import load_sensor
from tests.small_press import changed

from .identified import identify
from .twin import residuals_and_bias


@pytest.fixture(scope="module")
def press(punyo_press):
    with Recording(punyo_press) as recording:
        yield recording


@pytest.fixture(scope="module")
def found(press):
    """Identified from the first 40 of 60 contact-free frames; the atmosphere is unknown."""
    unknown = {"gauge_pressure_pa": 5258.0, "gauge_sigma_pa": None}
    unknown |= {"atmospheric_pressure_pa": 101_325.0}
    given = changed(load_sensor("punyo_oval_d405"), pneumatics=unknown)
    return identify(press, given, range(40), nodes=600)


@pytest.fixture(scope="module")
def held(press, found):
    return collect_press(press, found.samples, found.given)


@pytest.mark.long  # in short: of the twin, in test_rubber_press.py
def test_gauge_pressure_from_the_press(found, held):
    """No wrench is used. The lab lies 225 m up, where the air has 98.7 kPa in the mean."""
    result = with_rubber(found, [], press=held)
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


@pytest.mark.long  # in short: of the twin, in test_refusals.py
def test_held_press_is_not_taken_as_rest(press, found):
    """It is not quite still; its largest change of depth from rest, 5.5 mm, is at (259, 289)."""
    with pytest.raises(InputError, match=r"by 2\.\d mm or more around pixel \(2[56]\d, 2[89]\d\)"):
        identify(press, found.given, range(70, 90), nodes=600)


@pytest.mark.long  # in short: of the twin, in test_identification.py
def test_held_out_residual_and_fits(press, found):
    residual, bias = residuals_and_bias(found, [press[k] for k in range(40, 60)])
    assert np.sqrt(np.nanmean(residual**2)) < 0.25e-3
    assert np.sqrt(np.nanmean((residual - bias) ** 2)) < 0.08e-3
    assert np.abs(np.nanmedian(residual - bias, axis=1)).max() < 1e-5
    cap = found.surfaces.cap
    at_rim = np.sqrt(1.0 - (cap.centre_m[2] / cap.semi_axes_m[2]) ** 2)
    rim = cap.semi_axes_m[:2] * at_rim  # the drawing's
    np.testing.assert_allclose(np.sort(rim), [0.0396, 0.0557], atol=2e-3)
    assert found.pixels.mask.sum() > 180_000


@pytest.mark.long  # in short: of a sphere, in test_identify_command.py
def test_no_force_on_frames_not_used(press, found, tmp_path):
    assert found.tension_by_shape.half_width < 0.05 * found.tension_n_per_m
    write_sensor(found, tmp_path / "half.toml")
    pipeline = Pipeline.of(load_sensor(tmp_path / "half.toml"), intrinsics=press[0].intrinsics)
    forces = [
        np.linalg.norm(pipeline.process(press[k], frozenset({"patch"})).patch.force_n)
        for k in range(42, 60, 3)
    ]
    assert np.sqrt(np.mean(np.square(forces))) <= 0.05


@pytest.mark.long  # the whole is above
def test_gauge_pressure_from_the_press_agrees_with_that_from_its_parts(press, found, held):
    gauge, _ = with_rubber(found, [], press=held).gauge_candidates
    for parts in (2, 3):
        for frames in np.array_split(held.frames, parts):
            part = with_rubber(found, [], press=collect(press, found.given, frames.tolist()))
            assert gauge.low < part.gauge_candidates[0].value < gauge.high, frames


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
