"""Colour and depth are paired by time stamp and a given delay."""

import numpy as np
import pytest

from bubbleviz.recordings import Recording, find_contact_free
from bubbleviz.shear import recorded_texture
from tests.colour.speckle import camera, clean_image, dragged
from tests.recordings.bagmaker import PERIOD, SECOND, START, BagMaker

PERIOD_S = PERIOD / SECOND


def press(times_s):
    """How far a press has gone: a smooth rise in 0.3 s, a hold that drifts."""
    s = np.clip((times_s - 1.0) / 0.3, 0.0, 1.0)
    return s * s * (3.0 - 2.0 * s) + 0.02 * np.clip(times_s - 1.3, 0.0, None)


def make_recording(folder, lead, frames=42):
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


def learned(recording, **more):
    return recorded_texture(recording, find_contact_free(recording).frames, **more)


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
def test_frames_are_paired_by_stamps(lead, led_by_colour, stamped_alike):
    with Recording(led_by_colour if lead else stamped_alike) as recording:
        texture = learned(recording)
        for k in (5, 36, 40):
            np.testing.assert_allclose(
                errors_px(recording, texture, recording[k], lead), 0.0, atol=0.3
            )
            colour = recording[k].colour
            assert colour is not None and colour.stamp_ns == recording.stamps_ns[k]


class CountedRecording(Recording):
    """Counts how often a frame's depth image is decoded."""

    decoded = 0

    def __getitem__(self, index):
        self.decoded += 1
        return super().__getitem__(index)


def test_flow_reference_is_learned_in_one_pass(stamped_alike):
    with CountedRecording(stamped_alike) as recording:
        learned(recording)
        assert recording.decoded <= len(recording)


def test_static_colour_images_are_valid(tmp_path):
    path = make_recording(tmp_path, 0.0, frames=25)  # ends before the press begins
    with Recording(path) as recording:
        texture = learned(recording)
        assert texture.remark.startswith("contact-free frames 0–")
        flow = texture(recording[24])
        assert flow is not None and not flow.problem
        assert np.abs(flow.moved_px).max() < 0.5
