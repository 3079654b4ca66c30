"""Colour and depth are paired by stamps and a given delay; the delay seen is only told."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bubbleviz.api.frames import info
from bubbleviz.calibration import lag_between, recorded_texture, temporal_lag
from bubbleviz.camera import DepthCamera, MembraneView
from bubbleviz.errors import InputError
from bubbleviz.membrane import MembraneMesh
from bubbleviz.recordings import Recording
from bubbleviz.simulation import PrintedMembrane, Speckle
from tests.colour.speckle import camera, clean_image, dragged
from tests.oracles.stuck_press import shear_sensor
from tests.recordings.bagmaker import PERIOD, SECOND, START, BagMaker

PERIOD_S = PERIOD / SECOND
SMALL = {"width": 320, "height": 240, "fx": 215.0, "fy": 215.0, "cx": 159.5, "cy": 119.5}
TRUTH = Path(__file__).parents[3] / "shared" / "data" / "rubber_truth"


def press(times_s):
    """How far a press has gone: a smooth rise in 0.3 s, a hold that drifts."""
    s = np.clip((times_s - 1.0) / 0.3, 0.0, 1.0)
    return s * s * (3.0 - 2.0 * s) + 0.02 * np.clip(times_s - 1.3, 0.0, None)


def lags(true_s, noise):
    """Lags found in curves of other units, noise and stamps."""
    found = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        depth_times = PERIOD_S * np.arange(75) + rng.uniform(0.0, 4e-3, 75)
        colour_times = PERIOD_S * np.arange(75) + rng.uniform(0.0, 4e-3, 75)
        depth = 0.1 + 2e-3 * (press(depth_times) + rng.normal(0.0, noise, 75))
        moved = 0.3 + 7.0 * (press(colour_times - true_s) + rng.normal(0.0, noise, 75))
        found.append(lag_between(depth_times, depth, colour_times, moved, 1.03))
    return found


@pytest.mark.parametrize("true_s", [-0.083, -0.04, 0.0, 0.055])
@pytest.mark.parametrize("noise", [0.003, 0.03])
def test_the_lag_of_known_curves_and_its_interval(true_s, noise):
    found = lags(true_s, noise)
    errors = np.array([each.lag_s - true_s for each in found])
    ends = np.array([each.interval_s for each in found]) - true_s
    assert np.abs(errors).max() < PERIOD_S
    assert np.mean((ends[:, 0] <= 0.0) & (ends[:, 1] >= 0.0)) >= 0.85
    assert np.median(np.diff(ends)) < 2.0 * PERIOD_S


def test_the_interval_knows_that_the_texture_of_a_drag_moves_on_alone():
    """Stamped alike; as on the dragged rubber of `shared/data/rubber_truth`."""
    times = PERIOD_S * np.arange(75)
    gone = press(times)
    moved = gone / (1.0 + 0.8 * gone) + 2.0 * np.clip(times - 1.3, 0.0, 0.4)
    low, high = lag_between(times, gone, times, moved, 1.03).interval_s
    assert low <= 0.0 <= high


def test_a_filter_of_depth_is_a_lag_of_its_delay():
    """An exponential filter, as in RealSense cameras, delays a ramp by (1 − a) / a frames."""
    times, share = PERIOD_S * np.arange(75), 0.4
    filtered = press(times)
    for k in range(1, len(times)):
        filtered[k] = share * filtered[k] + (1.0 - share) * filtered[k - 1]
    found = lag_between(times, filtered, times, press(times), 1.07)
    assert found.interval_s[0] < -(1.0 - share) / share * PERIOD_S < found.interval_s[1] < 0.0
    assert found.to_text().startswith("colour delay of -0.0")


def test_curves_that_are_not_alike_have_no_lag():
    times, rng = PERIOD_S * np.arange(75), np.random.default_rng(0)
    with pytest.raises(ValueError, match="do not change together"):
        lag_between(times, rng.normal(size=75), times, press(times), 1.0)
    with pytest.raises(ValueError, match="too little time in common"):
        lag_between(times, press(times), times[:20], press(times[:20]), 1.0)


def make_recording(folder, lead, frames=60):
    """Speckle dragged as far as the depth changes `lead` periods later."""
    bag, rng = BagMaker("mcap file"), np.random.default_rng(0)
    still = clean_image()
    shape = still.shape
    for k in range(frames):
        stamp = START + k * PERIOD
        gone = press(np.array(k * PERIOD_S))
        depth = 0.1 + rng.normal(0.0, 5e-5, shape)
        depth[80:160, 100:200] -= 5e-3 * gone
        bag.image(stamp, depth.astype(np.float32), topic="/cam/depth/image")
        ahead = float(press(np.array((k + lead) * PERIOD_S)))

        def moved(x, y, far=ahead):
            u, v = dragged(x, y)
            return far * u, far * v

        image = camera(clean_image(moved) if ahead else still, k)
        bag.image(stamp, image, "mono8", topic="/cam/color/image", step=image.shape[1])
    return bag.write(folder)


@pytest.fixture(scope="module")
def led_by_colour(tmp_path_factory):
    return make_recording(tmp_path_factory.mktemp("led"), 2.4)


@pytest.fixture(scope="module")
def stamped_alike(tmp_path_factory):
    return make_recording(tmp_path_factory.mktemp("alike"), 0.0)


def test_the_lag_that_is_seen_is_told_with_its_interval(led_by_colour):
    with Recording(led_by_colour) as recording:
        found = temporal_lag(recording)
        assert found.lag_s == pytest.approx(-2.4 * PERIOD_S, abs=0.4 * PERIOD_S)
        assert found.interval_s[0] < -2.4 * PERIOD_S < found.interval_s[1] < 0.0
    facts = info(led_by_colour, lag=True)
    assert found.to_text() in facts.to_text()
    told = json.loads(facts.to_json())["colour"]["lag"]
    assert told == {"lag_s": found.lag_s, "interval_s": list(found.interval_s)}
    assert "delay" not in info(led_by_colour).to_text()


def errors_px(recording, texture, frame, lead):
    """Median error of the flow of a frame from that of the colour `lead` periods later."""
    flow = texture(frame)
    y, x = np.divmod(flow.pixel, clean_image().shape[1])
    most = np.stack(dragged(x, y), axis=1)
    error = flow.moved_px - press(np.array((frame.index + lead) * PERIOD_S)) * most
    middle = np.linalg.norm(most, axis=1) > 3.0
    assert middle.sum() > 20
    return np.asarray(np.median(error[middle], axis=0))


@pytest.mark.parametrize("lead", [0.0, 2.4])
def test_frames_are_paired_by_their_stamps_whatever_is_seen(lead, led_by_colour, stamped_alike):
    with Recording(led_by_colour if lead else stamped_alike) as recording:
        texture = recorded_texture(recording)
        for k in (5, 36, 50):
            np.testing.assert_allclose(
                errors_px(recording, texture, recording[k], lead), 0.0, atol=0.3
            )
            colour = recording[k].colour
            assert colour is not None and colour.stamp_ns == recording.stamps_ns[k]


def test_a_delay_that_is_given_pairs_the_frames_of_one_moment(led_by_colour):
    """To half a frame: the images are 2.4 frames ahead."""
    delay_s = -2.4 * PERIOD_S
    with Recording(led_by_colour) as recording:
        texture = recorded_texture(recording, colour_delay_s=delay_s)
        assert "colour delay -0.080 s" in texture.remark
        for k in (5, 36, 50):
            frame = replace(recording[k], colour_delay_s=delay_s)
            assert frame.colour.stamp_ns == START + (k - 2) * PERIOD
            np.testing.assert_allclose(errors_px(recording, texture, frame, 0.4), 0.0, atol=0.3)


class CountedRecording(Recording):
    """Counts how often a frame's depth image is decoded."""

    decoded = 0

    def __getitem__(self, index):
        self.decoded += 1
        return super().__getitem__(index)


def test_what_flow_is_measured_from_is_learned_in_one_pass(stamped_alike):
    with CountedRecording(stamped_alike) as recording:
        recorded_texture(recording)
        assert recording.decoded <= len(recording)


def test_colour_that_never_moves_is_no_error(tmp_path):
    path = make_recording(tmp_path, 0.0, frames=25)  # ends before the press begins
    with Recording(path) as recording:
        texture = recorded_texture(recording)
        assert texture.remark.startswith("contact-free frames 0–")
        flow = texture(recording[24])
        assert flow is not None and not flow.problem
        assert np.abs(flow.moved_px).max() < 0.5
    facts = info(path, lag=True)
    assert "no colour delay seen: no contact with at least 5 colour images" in facts.to_text()
    assert facts.colour is not None and facts.colour.lag is None


def test_a_recording_without_colour_images_tells_no_lag(tmp_path):
    bag = BagMaker("mcap file")
    for k in range(30):
        bag.image(START + k * PERIOD, np.full((48, 64), 0.1, np.float32))
    path = bag.write(tmp_path)
    with Recording(path) as recording, pytest.raises(InputError, match="no colour"):
        temporal_lag(recording)
    assert info(path, lag=True).colour is None


def test_colour_leads_in_the_real_press(punyo_press_colour):
    """By one or two frames: the camera filters depth in time."""
    with Recording(punyo_press_colour) as recording:
        found = temporal_lag(recording)
        period_s = float(np.median(np.diff(recording.times_s)))
    assert -3.0 < found.lag_s / period_s < -0.5
    assert found.interval_s[1] < 0.0


@pytest.mark.long
@pytest.mark.skipif(not TRUTH.exists(), reason="the rubber's shapes are not in the repository")
@pytest.mark.parametrize("name", ["ball_drag1", "puck_twist"])
def test_the_interval_holds_the_truth_on_rubber_that_is_dragged(name, tmp_path):
    """Its images are stamped alike; the old estimate was off by up to a quarter of a second."""
    with np.load(TRUTH / f"{name}.npz") as truth:
        rest, triangles = truth["rest_m"].astype(float), truth["triangles"]
        moved = truth["nodes_m"].astype(float) - rest
    camera = DepthCamera.of(shear_sensor().camera.model_copy(update=SMALL))
    view = MembraneView(camera, MembraneMesh(rest, triangles, rest[:, 2] < 1e-6))
    printed, rng = PrintedMembrane(Speckle(), view), np.random.default_rng(0)
    bag = BagMaker("mcap file")
    for k in range(30 + len(moved)):
        shape, stamp = moved[k - 30] if k >= 30 else np.zeros_like(rest), START + k * PERIOD
        depth = camera.depth_image(view.range_image(shape))
        depth = depth + rng.normal(0.0, 5e-5, depth.shape)
        bag.image(stamp, depth.astype(np.float32), topic="/cam/depth/image")
        image = printed.image(shape, k)
        bag.image(stamp, image, "mono8", topic="/cam/color/image", step=image.shape[1])
    with Recording(bag.write(tmp_path)) as recording:
        low, high = temporal_lag(recording).interval_s
    assert low <= 0.0 <= high
    assert high - low < 8.0 * PERIOD_S
