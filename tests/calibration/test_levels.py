"""Several inflation levels and a known press, from recordings to the files written."""

import json

import numpy as np
import pytest
from small_press import record

from bubbleviz.calibration import Settings, Step, Workbench, write_sensor
from bubbleviz.calibration.rectification import fit_lines
from bubbleviz.camera import PixelModel, RangeLine
from bubbleviz.errors import InputError
from bubbleviz.pipeline import Pipeline
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor import load_sensor, sensor_to_toml
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation import DepthNoise, SyntheticSource
from tests.program import output_of, refusal
from tests.small_press import changed

from .domes import Dome
from .identified import identify

QUIET = DepthNoise(absolute_m=5e-5)
STRETCH = 0.02
"""What the camera adds to a change of range in one pixel, and takes from it in the next."""


class Stretched(Dome):
    """The dome in a camera with a range scale error about 150 mm in every other pixel.

    A scale error common to all pixels is not identifiable: it looks like another shape.
    """

    @property
    def scale(self):
        rows, columns = np.indices(self.rest.shape)
        return 1.0 + STRETCH * (-1.0) ** (rows + columns)

    def __getitem__(self, k):
        frame = super().__getitem__(k)
        ranges = self.camera.range_image(frame.depth_m)
        wrong = 0.15 + self.scale * (ranges - 0.15)
        depth = self.camera.depth_image(wrong).astype(np.float32)
        return type(frame)(k, frame.time_s, depth, frame.intrinsics)


def stretched(height):
    """A dome over the same rim of 75 mm radius, inflated to a height."""
    radius = (0.075**2 + height**2) / (2.0 * height)
    return Stretched((radius,) * 3, height, QUIET, round(1e4 * height), frames=12, scale=0.35)


@pytest.fixture(scope="module")
def found():
    dome = stretched(0.05)
    plain = identify(dome, dome.sensor, range(12), nodes=500)
    return plain, with_levels(dome, stretched(0.045), stretched(0.055))


def with_levels(dome, *levels, nodes=500):
    settings = Settings(Step.TENSION, ((0, 12),), nodes=nodes, levels=levels)
    return Workbench(dome, dome.sensor).work(settings)


def test_levels_determine_the_prestretch(found):
    """Against the stretch that was put in."""
    plain, rectified = found
    line, mask = rectified.pixels.line, rectified.pixels.mask
    assert line.levels == 3 and plain.pixels.line is None
    error = line.slope[mask] - 1.0 / stretched(0.05).scale[mask]
    assert np.median(np.abs(error)) < 0.3 * STRETCH
    assert mask.mean() > 0.4


def test_frames_at_rest_stay_without_contact(found):
    plain, rectified = found
    mask, line = rectified.pixels.mask, rectified.pixels.line
    rest = np.where(mask, rectified.samples.statistics.range_m, np.nan)
    np.testing.assert_allclose(line.straighten(rest)[mask], rest[mask], atol=1e-12)
    assert mask.sum() <= plain.pixels.mask.sum()
    removed = rectified.pixels.removed
    assert sum(removed.values()) + mask.sum() == mask.size


def test_rectification_is_not_extrapolated():
    one = np.ones((2, 2))
    line = RangeLine(0.98 * one, 0.15 * one, 0.14 * one, 0.16 * one, 3)
    at_end = line.straighten(0.14 * one) - 0.14
    np.testing.assert_allclose(line.straighten(0.12 * one) - 0.12, at_end, atol=1e-15)
    assert abs(at_end[0, 0]) == pytest.approx(0.02 * 0.01)


def test_rectification_is_stored_in_the_pixels_file_and_used(found, tmp_path):
    plain, rectified = found
    dome = stretched(0.05)
    frame = dome[0]
    pushed = dome.camera.depth_image(dome.camera.range_image(frame.depth_m) - 4e-3)
    pressed = type(frame)(1, 0.0, pushed.astype(np.float32), frame.intrinsics)
    changes = []
    for each in (plain, rectified):
        write_sensor(each, tmp_path / f"{each is plain}.toml")
        model = SensorModel.of(load_sensor(tmp_path / f"{each is plain}.toml"), frame.intrinsics)
        assert (model.pixels.line is None) == (each is plain)
        for made in (model, each.model):  # from the files, and without them
            patch = Pipeline(made).process(frame, frozenset({"patch"})).patch
            assert np.linalg.norm(patch.force_n) < 0.05
        shown = dome.camera.range_image(pressed.depth_m)
        changes.append(model.range_image(pressed.depth_m) + model.pixels.bias_m - shown)
        np.testing.assert_allclose(
            model.range_image(pressed.depth_m), each.model.range_image(pressed.depth_m), atol=2e-6
        )
    assert np.nanmax(np.abs(changes[0])) < 1e-7
    mask = rectified.pixels.mask
    moved = changes[1][mask] / -4e-3
    wanted = (1.0 / dome.scale - 1.0)[mask]
    assert np.median(np.abs(moved - wanted)) < 0.3 * STRETCH


def test_levels_of_another_resolution_are_refused():
    with pytest.raises(InputError, match="differ in image"):
        other = Dome((0.08125,) * 3, 0.045, QUIET, 0, frames=12, scale=0.3)
        with_levels(stretched(0.05), other, nodes=200)


@pytest.mark.parametrize("moved_m", [0.0, 5e-5, 1e-3])
def test_levels_within_the_noise_correct_no_pixel_by_noise(moved_m):
    """Pixels with gains that scatter by 2 %, and 0.6 mm of noise: 1 % of 60 mm."""
    rng, shape = np.random.default_rng(0), (90, 120)
    true = 0.06 + moved_m * np.array([-1.0, 0.0, 1.0])[:, None, None] * np.ones(shape)
    gain = 1.0 + STRETCH * rng.standard_normal(shape)
    noise, frames = np.full((3, *shape), 6e-4), np.full(3, 25.0)
    seen = 0.06 + gain * (true - 0.06) + rng.normal(0.0, 6e-4 / 5.0, true.shape)
    slope, _, _ = fit_lines(seen, true, noise, frames)
    assert np.sqrt(np.mean((slope * gain - 1.0) ** 2)) < 1.3 * STRETCH


def test_rounding_to_millimetres_is_no_gain_of_a_pixel():
    """Rounding errors do not average out over frames where noise is 0.2 mm; no pixel has a gain."""
    rng, away = np.random.default_rng(0), np.linspace(0.06, 0.07, 120)
    true = away + 3.25e-3 * np.array([-1.0, 0.0, 1.0])[:, None, None] * np.ones((90, 1))
    images = np.round(true[:, None] + rng.normal(0.0, 2e-4, (3, 25, *true.shape[1:])), 3)
    noise, frames = images.std(axis=1).clip(1e-3 / np.sqrt(12.0)), np.full(3, 25.0)
    known, unknown = (
        fit_lines(images.mean(axis=1), true, noise, frames, quantum)[0] for quantum in (1e-3, 0.0)
    )
    assert np.std(known) < 0.005
    assert np.std(unknown) > 0.02


def test_a_stuck_pixel_is_not_used():
    moved = 3e-3 * np.array([-1.0, 0.0, 1.0])[:, None, None] * np.ones((8, 8))
    gain = 1.0 + STRETCH * np.random.default_rng(0).standard_normal((8, 8))
    gain[2, 3] = 0.0
    seen = 0.06 + gain * moved
    slope, _, _ = fit_lines(seen, 0.06 + moved, np.full(seen.shape, 1e-4), np.full(3, 25.0))
    assert np.isnan(slope[2, 3]) and np.isnan(slope).sum() == 1


@pytest.fixture(scope="module")
def press():
    """A simulated recording: rest, then a cylinder at a known constant pose."""
    sensor = stretched(0.05).sensor
    sensor = changed(
        sensor,
        membrane={"nodes": 300, "rim_radius_m": 0.075, "height_m": 0.05},
        camera={"position_m": (0.0, 0.0, -0.104)},
    )
    obj = load_object("cylinder")
    poses = np.tile(np.eye(4), (16, 1, 1))
    poses[:, 2, 3] = 0.05 - np.r_[np.full(12, -0.01), np.full(4, 0.008)] - obj.vertices[:, 2].min()
    return SyntheticSource(sensor, obj, poses, QUIET, nodes=400)


@pytest.fixture
def pressed(press, tmp_path):
    """Command that identifies the sensor from the recording."""
    (tmp_path / "given.toml").write_text(sensor_to_toml(press.sensor))
    words = ("--sensor", tmp_path / "given.toml", "--contact-free", "0:12", "--object", "cylinder")
    recording = record(tmp_path / "press.mcap", press)
    return ("identify", recording, *words, "--out", tmp_path / "new.toml", "--nodes")


def test_command_validates_by_a_known_press(press, pressed, tmp_path):
    pose = ("--pose", f"0 0 {press.poses[-1][2, 3]} 0 0 0 1")
    words = (*pressed, 300, *pose, "--report", tmp_path / "report", "--json")
    assert "--pressed" in refusal(*words)
    numbers = json.loads(output_of(*words, "--pressed", "12:16"))["validation"]
    assert numbers["rms_m"] < 0.15 * numbers["untouched_rms_m"]
    assert numbers["rms_m"] < numbers["p95_m"] and numbers["patch_overlap"] > 0.5
    text = (tmp_path / "report" / "report.html").read_text()
    assert "Known press: distance of the measured points" in text
    assert f"{1e3 * numbers['rms_m']:.3f} mm rms" in text


def test_command_takes_further_levels(tmp_path):
    domes = [stretched(height) for height in (0.05, 0.045)]
    rest, level = (record(tmp_path / f"{k}.mcap", dome) for k, dome in enumerate(domes))
    (tmp_path / "given.toml").write_text(sensor_to_toml(domes[0].sensor))
    words = ("--sensor", tmp_path / "given.toml", "--nodes", 150, "--out", tmp_path / "new.toml")
    told = output_of("identify", rest, *words, "--level", level, "--level-sigma", 20, "--json")
    assert json.loads(told)["rectification"]["levels"] == 2
    assert PixelModel.load(tmp_path / "new.npz").line.levels == 2
