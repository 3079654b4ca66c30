"""Recordings and streams associate the same wrench and colour with each frame."""

from functools import partial

import numpy as np
import pytest
from streams import frames_of, recorded
from wire import (
    CLOUD,
    HEIGHT,
    INFO,
    NOW,
    PERIOD,
    PRESSURE,
    SECOND,
    WIDTH,
    WRENCH,
    arrived,
    camera_info,
    cloud,
    depth,
    gas,
    grey,
    pressure,
    wrench,
)

from bubbleviz.camera import Intrinsics
from bubbleviz.live import FrameAssembler
from bubbleviz.recordings import Message, Recording

MS = 1_000_000


def of_another_clock():
    """Gas pressure without stamps; the camera's clock is 40 s behind."""
    frames = [depth(NOW - 40 * SECOND + k * PERIOD, k, NOW + k * PERIOD) for k in range(6)]
    stampless = [
        arrived("/gas", PRESSURE, pressure(0, 1e5 + 10 * k), 0, NOW + 20 * k * MS)
        for k in range(10)
    ]
    return stampless + frames


def with_jitter():
    """Stamps and arrivals of every topic waver, each at its own rate."""
    rng, found = np.random.default_rng(0), list[Message]()
    for k in range(20):
        stamp = NOW + k * PERIOD + int(rng.integers(0, 4 * MS))
        found.append(depth(stamp, k, stamp + 9 * MS))
    for k in range(100):
        stamp = NOW - 5 * MS + 7 * k * MS + int(rng.integers(0, 2 * MS))
        found.append(gas(stamp, 1e5 + float(rng.integers(0, 1000)), stamp + MS))
        force = wrench(stamp, rng.uniform(-9.0, 9.0, 6).tolist())
        found.append(arrived("/ft", WRENCH, force, stamp, stamp + 2 * MS))
    return found


def beyond_the_last(late_ms):
    """One gas pressure, and a frame after it."""
    return [gas(NOW, 1.06e5), depth(NOW + late_ms * MS)]


def with_colour():
    """Colour of two moments in three, a quarter of a period earlier."""
    shown = [k for k in range(12) if k % 3]
    images = [grey(NOW + k * PERIOD - PERIOD // 4, k) for k in shown]
    return [*images, *(depth(NOW + k * PERIOD, k) for k in range(12))]


def beside(frame):
    """What belongs to a frame, with the colour of its moment and of a fifth of a second before."""
    values = None if frame.wrench is None else tuple(frame.wrench.tolist())
    find = frame.find_colour or (lambda _: None)
    images = [find(lag_s) for lag_s in (0.0, -0.2)]
    levels = [None if image is None else int(image.grey()[5, 5]) for image in images]
    return round(frame.time_s, 9), frame.gas_pressure_pa, values, *levels


@pytest.mark.parametrize(
    ("sent", "has"),
    [
        (of_another_clock, [100_000.0, 100_000.0 + PERIOD / 2 / MS]),
        (with_jitter, None),
        (partial(beyond_the_last, 90), [1.06e5]),
        (partial(beyond_the_last, 110), [None]),
        (with_colour, [None, None]),
    ],
    ids=["another clock", "jitter", "near the last", "far from it", "colour"],
)
def test_recording_and_stream_have_the_same_values_for_each_frame(tmp_path, sent, has):
    messages = sorted(sent(), key=lambda message: message.arrival_ns)
    assembler = FrameAssembler()
    assembler.follow_colour()
    live = [beside(frame) for frame in frames_of(assembler, *messages)]
    with Recording(recorded(tmp_path / "rec.mcap", messages)) as recording:
        assert live == [beside(recording[k]) for k in range(len(recording))]
    if has is None:
        assert len({values for _, _, values, *_ in live}) == 20
    else:
        assert [value for _, value, *_ in live[:2]] == pytest.approx(has)
    if "color" in "".join(message.topic for message in messages):
        assert [level for *_, level, _ in live] == [k if k % 3 else None for k in range(12)]


@pytest.mark.parametrize("rows", [True, False])
def test_point_clouds_are_the_same_depth_images_live_and_recorded(tmp_path, rows):
    """In rows, or in any order, of which the nearest points count; those need the camera."""
    camera = Intrinsics(WIDTH, HEIGHT, 60.0, 61.0, 31.5, 23.5)  # as wire.camera_info has it
    rays, random = np.dstack([camera.slopes(), np.ones((HEIGHT, WIDTH))]), np.random.default_rng(0)
    truths = np.linspace(0.1, 0.2, 3 * HEIGHT * WIDTH, dtype=np.float32).reshape(3, HEIGHT, WIDTH)
    truths[:, 3, 4] = np.nan
    clouds, infos = [], []
    for k, truth in enumerate(truths):
        stamp, points = NOW + k * PERIOD, rays * truth[..., None]
        if not rows:
            away = [[0.3, 0.0, 0.1], [0.0, -0.3, 0.1]], -points[0, :2]  # beside the image, behind
            points = np.concatenate([points, 1.5 * points]).reshape(-1, 3)
            points = random.permutation(np.concatenate([points, *away]))
        shape = (HEIGHT, WIDTH) if rows else (1, len(points))
        clouds.append(arrived("/tof/points", CLOUD, cloud(stamp, points, *shape), stamp))
        infos.append(arrived("/tof/camera_info", INFO, camera_info(stamp), stamp))
    for assembler, sent in (
        (FrameAssembler(), [m for pair in zip(infos, clouds, strict=True) for m in pair]),
        (FrameAssembler(camera=camera), clouds),
    ):
        found = [frame.depth_m for frame in frames_of(assembler, *sent)]
        np.testing.assert_array_equal(found, truths)
    with Recording(recorded(tmp_path / "rec.mcap", [*infos, *clouds])) as recording:
        assert (recording.size, recording.encoding) == ((WIDTH, HEIGHT), "points")
        np.testing.assert_array_equal([frame.depth_m for frame in recording], truths)
    blind = FrameAssembler()
    if rows:
        assert len(frames_of(blind, *clouds)) == 3
    else:
        assert frames_of(blind, *clouds) == [] and "camera info" in blind.counters.problem
