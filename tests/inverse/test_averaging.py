"""Depth images that show the same are averaged, others are not."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import bubbleviz as bv
from bubbleviz.averaging import StillFrames
from bubbleviz.camera import DepthCamera
from bubbleviz.errors import InputError
from bubbleviz.membrane import build_mesh
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import Frame, HeldFrames
from bubbleviz.rigid_object import load_object
from bubbleviz.simulation import DepthNoise, touching_height
from tests.small_press import changed, record

PRODUCTS = frozenset({"estimate", "patch"})
WHITE, CORRELATED = DepthNoise(relative=0.01), DepthNoise(relative=0.01, correlation_px=3.0)


class Damaged(HeldFrames):
    """A source of which frame 8 cannot be read."""

    def __getitem__(self, index):
        if index == 8:
            raise InputError("frame 8 is damaged; record it again")
        return super().__getitem__(index)


@cache
def sensor():
    given = bv.load_sensor("pico_flexx_75mm")
    return changed(given, membrane={"nodes": 300, "prestretch": 1.2})


@cache
def pipeline():
    return Pipeline.of(sensor())


@cache
def presses():
    """Ranges of a ball well above the membrane, then 6 and 6.5 mm below first contact; forces."""
    poses = np.tile(np.eye(4), (3, 1, 1))
    top = touching_height(load_object("sphere"), poses[0], build_mesh(sensor()))
    poses[:, 2, 3] = top - 1e-3 * np.array([-20.0, 6.0, 6.5])
    simulated = bv.simulate(sensor(), "sphere", poses)
    camera = DepthCamera.of(sensor().camera)
    ranges_m = [camera.range_image(simulated[k].depth_m) for k in range(3)]
    return ranges_m, [simulated.truth(k).force_n[2] for k in range(3)]


def between(values, depth_mm):
    """Value at a depth, in proportion between those of the two presses."""
    share = (depth_mm - 6.0) / 0.5
    return (1.0 - share) * values[1] + share * values[2]


def exact(depth_mm):
    """Ranges of a ball at a depth; without contact if it is None."""
    return presses()[0][0] if depth_mm is None else between(presses()[0], depth_mm)


def noisy(depths_mm, noise=WHITE, seed=0):
    camera, frames = DepthCamera.of(sensor().camera), []
    for k, depth_mm in enumerate(depths_mm):
        depth_m = camera.depth_image(noise.apply(exact(depth_mm), seed, k))
        frames.append(Frame(k, k / 30.0, depth_m.astype(np.float32)))
    return frames


def averaged(source, order=None):
    """Frames with their means, asked for in an order."""
    still = StillFrames(pipeline(), source)
    found = {k: still.applied(source[k]) for k in order or range(len(source))}
    return [found[k] for k in sorted(found)]


def streamed(frames):
    """Frames with their means, as they come live."""
    still = StillFrames(pipeline())
    return [still.applied(frame) for frame in frames]


def images(frames):
    return [frame.images for frame in frames]


def pushes(frames):
    """Force along z, N, of each frame alone."""
    found = []
    for frame in frames:
        pipeline().restart()
        found.append(pipeline().process(frame, PRODUCTS).estimate.force_n[2])
    return np.array(found)


@pytest.mark.parametrize("noise", [WHITE, CORRELATED])
def test_an_object_at_rest_is_averaged_over_five_frames_on_either_side(noise):
    found = np.array(images(averaged(HeldFrames(noisy((6.0,) * 23, noise)))))
    most = np.minimum(np.arange(23), 5) + np.minimum(np.arange(23)[::-1], 5) + 1
    assert (found <= most).all()
    assert np.mean(found == most) > 0.7  # nine of ten; fewer by chance


@pytest.mark.long  # in short: its images, below
def test_the_force_of_an_object_at_rest_scatters_less():
    frames, force_n = noisy((6.0,) * 19), between(presses()[1], 6.0)
    inner = slice(5, -5)
    alone, mean = pushes(frames[inner]), pushes(averaged(HeldFrames(frames))[inner])
    assert np.std(mean) < 0.6 * np.std(alone)
    assert np.abs(mean - force_n).mean() < np.abs(alone - force_n).mean()


def test_live_frames_are_averaged_with_those_before():
    found = np.array(images(streamed(noisy((6.0,) * 23))))
    most = np.minimum(np.arange(23), 5) + 1
    most[1] = 1  # a straight line through two images is the second one
    assert (found <= most).all()
    assert np.mean(found == most) > 0.7


def test_a_stream_that_begins_anew_is_not_averaged_with_itself():
    frames = noisy((6.0,) * 8)
    found = streamed(frames + frames[:1] + [replace(frames[1], time_s=9.0)])
    assert images(found)[-2:] == [1, 1]


@pytest.mark.long  # in short: faster motions, below
def test_a_motion_too_slow_to_be_seen_shifts_no_force():
    """A press of 0.02 mm a frame, seen in images of both sides, or of one as at the end."""
    depths = 6.0 + 0.02 * np.arange(14)
    single, truth = noisy(depths), between(presses()[1], depths)
    alone = pushes(single) - truth
    for frames in (averaged(HeldFrames(single)), streamed(single)):
        assert np.mean(images(frames)) > 4.0
        mean = pushes(frames) - truth
        assert np.sqrt(np.mean(mean**2)) < np.sqrt(np.mean(alone**2))
        assert abs(mean[-5:].mean() - alone.mean()) < np.std(alone)  # both miss what the mesh does


@pytest.mark.parametrize("speed_mm", [0.6, -0.6])
def test_an_object_that_moves_is_not_averaged(speed_mm):
    depths = 6.0 + speed_mm * np.arange(-3, 4)
    assert images(averaged(HeldFrames(noisy(depths)))) == [1] * 7


def test_false_returns_do_not_hide_that_an_object_moves():
    """Of 1 % of the pixels, as of a D405."""
    frames, random = noisy(6.0 + 0.6 * np.arange(-3, 4)), np.random.default_rng(3)
    for frame in frames:
        false = random.random(frame.depth_m.shape) < 0.01
        frame.depth_m[false] = random.uniform(0.02, 0.3, np.count_nonzero(false))
    assert images(averaged(HeldFrames(frames))) == [1] * 7


def test_contact_that_begins_ends_the_mean():
    depths = (6.0,) * 8 + (7.0,) * 8
    frames, moved = averaged(HeldFrames(noisy(depths))), exact(6.0) - exact(7.0) > 5e-4
    assert max(images(frames)[:8]) <= 8 and max(images(frames)[8:]) <= 8
    assert min(images(frames)) > 3
    camera = DepthCamera.of(sensor().camera)
    for frame, depth_mm in zip(frames, depths, strict=True):
        error_m = camera.range_image(frame.steady_depth_m) - exact(depth_mm)
        assert np.nanmean(error_m[moved]) == pytest.approx(0.0, abs=1e-4)


def test_a_membrane_without_contact_is_not_averaged():
    assert images(averaged(HeldFrames(noisy((None,) * 7)))) == [1] * 7


def test_equal_images_add_nothing():
    still = [replace(frame, index=k) for k, frame in enumerate(noisy((6.0,)) * 9)]
    assert images(averaged(HeldFrames(still))) == [1] * 9


def test_a_frame_has_the_same_mean_however_it_was_reached():
    source = HeldFrames(noisy((6.0,) * 13))
    played, sought = averaged(source), averaged(source, [12, 3, 9, 6, 0, 7, 1, 11, 4, 2, 8, 10, 5])
    for one, other in zip(played, sought, strict=True):
        assert one.images == other.images
        np.testing.assert_array_equal(one.steady_depth_m, other.steady_depth_m)


def test_a_live_frame_that_is_kept_has_the_mean_it_was_shown_with():
    frames = noisy((6.0,) * 13)
    shown = streamed(frames)
    still = StillFrames(pipeline(), HeldFrames(frames), both_sides=False)
    assert max(images(shown)) > 3
    for k in (7, 12, 3):
        kept = still.applied(frames[k])
        assert kept.images == shown[k].images
        np.testing.assert_array_equal(kept.steady_depth_m, shown[k].steady_depth_m)


def test_a_damaged_frame_ends_the_mean_of_those_around():
    found = averaged(Damaged(noisy((6.0,) * 13)), order=range(8))
    assert 3 < max(images(found)) <= 8


def test_outliers_and_missing_returns_stay_out_of_the_mean():
    frames = noisy((6.0,) * 13)
    exact_m = DepthCamera.of(sensor().camera).depth_image(exact(6.0))
    random = np.random.default_rng(0)
    for frame in frames:
        pixels = random.choice(frame.depth_m.size, size=frame.depth_m.size // 5, replace=False)
        outliers, missing = np.array_split(pixels, 2)
        frame.depth_m.flat[outliers] += 0.05
        frame.depth_m.flat[missing] = np.nan
    frame = averaged(HeldFrames(frames))[6]
    assert frame.images > 5
    good = np.abs(frame.depth_m - exact_m) < 0.01  # neither missing here nor an outlier
    assert np.isnan(frame.steady_depth_m[np.isnan(frame.depth_m)]).all()
    assert np.nanmax(np.abs(frame.steady_depth_m - exact_m)[good]) < 0.004
    error_m = np.nanstd((frame.steady_depth_m - exact_m)[good])
    assert error_m < 0.5 * np.nanstd((frame.depth_m - exact_m)[good])


def test_the_estimator_averages_live_images_of_an_object_at_rest():
    estimator = bv.Estimator(sensor())
    found = [
        estimator.update(frame.depth_m, time_s=frame.time_s).result.frame.images
        for frame in noisy((6.0,) * 8)
    ]
    assert found[0] == 1 and max(found) > 3


def test_estimates_of_a_recording_say_how_many_images_they_are_of(tmp_path):
    record(tmp_path / "press.mcap", noisy((6.0,) * 9))
    run = bv.estimate(tmp_path / "press.mcap", sensor(), out=tmp_path / "result.npz")
    found = run.columns()["images"]
    assert found.max() > 1
    again = bv.estimate(bv.open(tmp_path / "press.mcap")[3:6], sensor())
    assert again.columns()["images"].tolist() == found[3:6].tolist()
    loaded = bv.load_run(tmp_path / "result.npz")
    assert loaded.columns()["images"].tolist() == found.tolist()
