"""The lag of colour behind depth is found to a fraction of a frame, or it is said why not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bubbleviz.colour.temporal_lag import TemporalLag, lag_between, temporal_lag
from bubbleviz.commands.info import recording_info
from bubbleviz.errors import InputError
from bubbleviz.frames.frame import Frame
from bubbleviz.frames.recording import Recording
from bubbleviz.shear.recorded_texture import recorded_texture
from tests.colour.speckle import camera, clean_image, dragged
from tests.frames.bagmaker import PERIOD, SECOND, START, BagMaker

PERIOD_S = PERIOD / SECOND


def press(times_s: np.ndarray) -> np.ndarray:
    """How far a press has gone: a smooth rise in 0.3 s, a hold that drifts."""
    s = np.clip((times_s - 1.0) / 0.3, 0.0, 1.0)
    return s * s * (3.0 - 2.0 * s) + 0.02 * np.clip(times_s - 1.3, 0.0, None)


def lags(true_s: float, noise: float) -> list[TemporalLag]:
    """Lags found in curves of other units, noise and stamps."""
    found = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        depth_times = PERIOD_S * np.arange(75) + rng.uniform(0.0, 4e-3, 75)
        colour_times = PERIOD_S * np.arange(75) + rng.uniform(0.0, 4e-3, 75)
        depth = 0.1 + 2e-3 * (press(depth_times) + rng.normal(0.0, noise, 75))
        moved = 0.3 + 7.0 * (press(colour_times - true_s) + rng.normal(0.0, noise, 75))
        found.append(lag_between(depth_times, depth, colour_times, moved))
    return found


@pytest.mark.parametrize("true_s", [-0.083, -0.04, 0.0, 0.055])
@pytest.mark.parametrize("noise", [0.003, 0.03])
def test_the_lag_of_known_curves_and_its_sigma(true_s: float, noise: float) -> None:
    found = lags(true_s, noise)
    errors = np.array([each.lag_s - true_s for each in found])
    sigmas = np.array([each.sigma_s for each in found])
    assert np.abs(errors).max() < 0.5 * PERIOD_S
    assert 0.3 < np.sqrt(np.mean((errors / sigmas) ** 2)) < 2.5
    assert found[0].period_s == pytest.approx(PERIOD_S, rel=0.05)


def test_a_filter_of_depth_is_a_lag_of_its_delay() -> None:
    """An exponential filter, as in RealSense cameras, delays a ramp by (1 − a) / a frames."""
    times, share = PERIOD_S * np.arange(75), 0.4
    filtered = press(times)
    for k in range(1, len(times)):
        filtered[k] = share * filtered[k] + (1.0 - share) * filtered[k - 1]
    found = lag_between(times, filtered, times, press(times))
    assert found.lag_s == pytest.approx(-(1.0 - share) / share * PERIOD_S, abs=0.2 * PERIOD_S)
    assert found.to_text().startswith("colour leads depth by ")


def test_curves_that_are_not_alike_have_no_lag() -> None:
    times, rng = PERIOD_S * np.arange(75), np.random.default_rng(0)
    with pytest.raises(ValueError, match="do not change together"):
        lag_between(times, rng.normal(size=75), times, press(times))
    with pytest.raises(ValueError, match="too little time in common"):
        lag_between(times, press(times), times[:20], press(times[:20]))


def make_recording(folder: Path, lead: float, frames: int = 60) -> Path:
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

        def moved(x: np.ndarray, y: np.ndarray, far: float = ahead) -> tuple[np.ndarray, ...]:
            u, v = dragged(x, y)
            return far * u, far * v

        image = camera(clean_image(moved) if ahead else still, k)
        bag.image(stamp, image, "mono8", topic="/cam/color/image", step=image.shape[1])
    return bag.write(folder)


@pytest.fixture(scope="module")
def led_by_colour(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_recording(tmp_path_factory.mktemp("led"), 2.4)


def test_the_lag_of_a_recording_is_told(led_by_colour: Path) -> None:
    with Recording(led_by_colour) as recording:
        found = temporal_lag(recording)
        assert found.lag_s == pytest.approx(-2.4 * PERIOD_S, abs=0.2 * PERIOD_S)
        image = recording[40].colour_after(found.lag_s)
        assert image is not None
        assert image.stamp_ns == START + 38 * PERIOD
    facts = recording_info(led_by_colour, lag=True)
    assert found.to_text() in facts.to_text()
    assert "leads" not in recording_info(led_by_colour).to_text()


class CountedRecording(Recording):
    """Counts how often a frame's depth image is decoded."""

    decoded = 0

    def __getitem__(self, index: int) -> Frame:
        self.decoded += 1
        return super().__getitem__(index)


def test_what_flow_is_measured_from_is_learned_in_two_passes(led_by_colour: Path) -> None:
    """One finds the contact-free frames, one the lag; its flow is that of the depth's moment."""
    with CountedRecording(led_by_colour) as recording:
        texture = recorded_texture(recording)
        assert recording.decoded <= 2 * len(recording)
        for k in (5, 36, 50):
            flow = texture(recording[k])
            assert flow is not None
            y, x = np.divmod(flow.pixel, clean_image().shape[1])
            most = np.stack(dragged(x, y), axis=1)
            error = flow.moved_px - press(np.array(k * PERIOD_S)) * most
            middle = np.linalg.norm(most, axis=1) > 3.0
            np.testing.assert_allclose(np.median(error[middle], axis=0), 0.0, atol=0.3)


def test_a_recording_that_tells_no_lag_says_why(tmp_path: Path) -> None:
    bag = BagMaker("mcap file")
    for k in range(30):
        bag.image(START + k * PERIOD, np.full((48, 64), 0.1, np.float32))
    with Recording(bag.write(tmp_path)) as recording, pytest.raises(InputError, match="no colour"):
        temporal_lag(recording)


def test_colour_leads_in_the_real_press(punyo_press_colour: Path) -> None:
    """By two or three frames, as its gas pressure does: the camera filters depth in time."""
    with Recording(punyo_press_colour) as recording:
        found = temporal_lag(recording)
    assert -3.0 < found.lag_s / found.period_s < -1.0
    assert found.sigma_s < 0.5 * found.period_s
