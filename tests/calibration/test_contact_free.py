"""The contact-free frames at the start of a recording: what ends them, and when."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import trim_mean

from bubbleviz.calibration import collect, collect_press
from bubbleviz.errors import InputError
from bubbleviz.recordings import LAG, Frame, HeldFrames, find_contact_free, tile_depths

from .twin import FREE, make_twin, nominal_sensor

FRAMES = 80


def plane(depth_from=FRAMES, pressure_from=FRAMES, gas=True, blip=None):
    """A plane 0.1 m away with 0.5 mm of noise; a corner of it and the gas pressure move."""
    rng = np.random.default_rng(0)
    depth = 0.1 + 5e-4 * rng.standard_normal((FRAMES, 48, 64))
    depth[depth_from:, :16, :16] -= 3e-3
    gas_pa = 1e5 + 4.0 * rng.standard_normal(FRAMES) if gas else [None] * FRAMES
    if gas:
        gas_pa[pressure_from:] += 100.0
    if blip is not None:
        depth[blip : blip + 2, :16, :16] -= 3e-3
    return HeldFrames([Frame(k, k / 30.0, depth[k], None, gas_pa[k]) for k in range(FRAMES)])


@pytest.mark.parametrize(
    ("source", "end", "ended_by"),
    [
        (plane(), FRAMES, "recording"),
        (plane(depth_from=40), 40, "depth"),
        (plane(pressure_from=30), 30, "pressure"),
        (plane(depth_from=40, pressure_from=30), 30, "pressure"),
        (plane(depth_from=30, pressure_from=40), 30, "depth"),
        (plane(depth_from=30, gas=False), 30, "depth"),
        (plane(depth_from=50, blip=20), 50, "depth"),  # a glitch is no contact
        (plane(depth_from=6), 6, "depth"),
    ],
)
def test_contact_free_range_ends_at_the_first_change(source, end, ended_by):
    found = find_contact_free(source)
    assert found.frames.start == 0
    assert end - 1 <= found.frames.stop <= end  # a frame that noise makes the beginning of it
    assert found.ended_by == ended_by
    assert (found.pressure_score is None) is (source[0].gas_pressure_pa is None)
    assert found.depth_score[:5].max() < 6.0


def test_contact_may_move_in_most_of_a_recording():
    """In three quarters of the frames everything changes, by 1 mm and 30 Pa."""
    source, rng = plane(), np.random.default_rng(1)
    moving = [
        replace(
            frame,
            depth_m=frame.depth_m - 1e-3 * rng.uniform(),
            gas_pressure_pa=frame.gas_pressure_pa + 30.0 * rng.uniform(),
        )
        for frame in (source[k] for k in range(20, FRAMES))
    ]
    frames = find_contact_free(HeldFrames([*(source[k] for k in range(20)), *moving])).frames
    assert 18 <= frames.stop <= 20


@pytest.mark.parametrize("rounded", [False, True])
def test_noise_of_the_gas_pressure_is_no_contact(rounded):
    """Correlated in time, or rounded to a unit that is larger than its noise."""
    depth, rng = np.full((48, 64), 0.1, np.float32), np.random.default_rng(0)
    for noise in rng.standard_normal((10, 400)):
        gas_pa = 1e5 + (np.round(0.5 * noise) if rounded else lfilter([1], [1, -0.8], noise))
        frames = [Frame(k, k / 30.0, depth, None, each) for k, each in enumerate(gas_pa)]
        assert find_contact_free(HeldFrames(frames)).ended_by == "recording"


def test_a_recording_that_begins_with_a_contact_is_refused():
    with pytest.raises(InputError, match="already changes at frame 4"):
        find_contact_free(plane(pressure_from=4))


def test_the_depth_of_a_tile_is_the_mean_of_its_middle_half():
    depth = np.random.default_rng(0).exponential(0.01, (20, 30)) + 0.1  # the rest is cut off
    depth[:8, :4] = np.nan
    depth[8:12, 8:16], depth[12, 8] = np.nan, np.nan
    found = tile_depths(depth)
    assert found.shape == (6,)
    for k, (row, column) in enumerate((r, c) for r in (0, 8) for c in (0, 8, 16)):
        tile = depth[row : row + 8, column : column + 8]
        known = tile[np.isfinite(tile)]
        middle = trim_mean(known, 0.25) if len(known) >= 32 else np.nan
        assert found[k] == pytest.approx(middle, nan_ok=True)
    assert np.isfinite(found[0]) and np.isnan(found[4])


@pytest.mark.parametrize("shape", [(3, 4), (40, 7), (7, 40)])
def test_an_image_smaller_than_a_tile_has_none(shape):
    assert tile_depths(np.full(shape, 0.1)).shape == (0,)


def test_held_press_is_found_near_the_highest_gas_pressure():
    """The twin's press grows over eight frames: seven eighths of it are not yet nine tenths."""
    twin = make_twin(frames=FREE + 20)
    samples = collect(twin, nominal_sensor(), range(FREE))
    held = collect_press(twin, samples, nominal_sensor())
    assert held.frames == tuple(range(FREE + 7 + LAG, FREE + 20))
    twin.pressures[FREE:] = twin.pressures[:20]  # nothing is pressed
    assert collect_press(twin, samples, nominal_sensor()) is None
    silent = collect(make_twin(pressure=False), nominal_sensor(), range(9))
    assert collect_press(twin, silent, nominal_sensor()) is None
