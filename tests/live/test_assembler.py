"""Messages become frames; invalid ones are counted and never raise."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from streams import frames_of
from wire import (
    CLOUD,
    COMPRESSED,
    HEIGHT,
    IMAGE,
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
    compressed_depth,
    depth,
    gas,
    image,
    number_shown,
    pressure,
    wrench,
)

from bubbleviz.live import WAIT_NS, FrameAssembler, TopicNames, stamp_of
from bubbleviz.recordings import Frame, Message


def test_frame_equals_the_sent_messages():
    assembler = FrameAssembler()
    info = arrived("/cam/camera_info", INFO, camera_info(NOW), NOW)
    first, second = frames_of(assembler, info, depth(NOW, 3), depth(NOW + PERIOD, 4))
    np.testing.assert_allclose(first.depth_m, 0.103, rtol=1e-6)
    assert first.depth_m.shape == (HEIGHT, WIDTH)
    assert (first.stamp_ns, first.arrival_ns) == (NOW, NOW + 1_000_000)
    assert (first.intrinsics.fx, first.intrinsics.cy) == (60.0, 23.5)
    assert (first.index, second.index) == (0, 1)
    assert second.time_s == pytest.approx(PERIOD * 1e-9)
    assert assembler.counters.frames == 2
    assert assembler.counters.received == 3


def test_compressed_depth_is_decoded_and_compressed_colour_not_subscribed():
    topic, names = "/cam/depth/image/compressedDepth", TopicNames()
    assembler = FrameAssembler()
    messages = [
        arrived(topic, COMPRESSED, compressed_depth(NOW + k * PERIOD, k), NOW + k * PERIOD)
        for k in (3, 4)
    ]
    frames = frames_of(assembler, *messages)
    assert [float(frame.depth_m[0, 0]) for frame in frames] == pytest.approx([0.103, 0.104])
    assert frames[0].depth_m.shape == (HEIGHT, WIDTH)
    assert names.wants(topic, COMPRESSED) and not names.wants("/cam/color/compressed", COMPRESSED)
    garbage = arrived(topic, COMPRESSED, compressed_depth(NOW)[:-30], NOW + 9 * PERIOD)
    assert frames_of(assembler, garbage) == [] and assembler.counters.undecodable == 1


def test_gas_pressure_and_wrench_are_interpolated_at_the_stamp_with_the_lag():
    """On a ramp of 1 kPa/s the value gives its time."""
    for lag in (0.0, 0.02, -0.015):
        assembler = FrameAssembler(lag_s=lag)
        found = []
        for k in range(40):
            t = NOW + k * 10_000_000
            found += assembler.push(gas(t, 1e5 + 1e3 * k * 0.01))
            sent = arrived("/ft", WRENCH, wrench(t, [float(k)] * 6), t)
            found += assembler.push(sent)
            if k == 20:
                found += assembler.push(depth(t - 3_000_000, arrival=t + 1_000_000))
        (frame,) = found
        at = 0.2 - 0.003 + lag
        assert frame.gas_pressure_pa == pytest.approx(1e5 + 1e3 * at, abs=1e-3)
        np.testing.assert_allclose(frame.wrench, np.full(6, at / 0.01), atol=1e-6)


def test_frame_waits_a_limited_time_for_its_pressure():
    assembler = FrameAssembler()
    assembler.push(gas(NOW - 10_000_000, 1e5))
    assert assembler.push(depth(NOW)) == []
    (frame,) = assembler.push(gas(NOW + 10_000_000, 1.02e5))
    assert frame.gas_pressure_pa == pytest.approx(1.01e5)
    assert assembler.push(depth(NOW + PERIOD)) == []
    until = assembler.waits_until_ns
    assert until == NOW + PERIOD + 1_000_000 + WAIT_NS
    assert assembler.flush(until - 1) == []
    (late,) = assembler.flush(until)
    assert late.gas_pressure_pa == 1.02e5  # the nearest there is


def test_silent_pressure_topic_is_neither_awaited_nor_used():
    assembler = FrameAssembler()
    assembler.push(gas(NOW - 5 * SECOND, 1e5))
    (frame,) = assembler.push(depth(NOW))
    assert frame.gas_pressure_pa is None


def test_duplicate_and_old_frames_are_counted_and_skipped():
    assembler = FrameAssembler()
    order = [0, 1, 2, 2, 1, 3]
    sent = [depth(NOW + k * PERIOD, k, arrival=NOW + n * PERIOD) for n, k in enumerate(order)]
    found = frames_of(assembler, *sent)
    assert [number_shown(frame) for frame in found] == [0, 1, 2, 3]
    counters = assembler.counters
    assert (counters.duplicate, counters.out_of_order, counters.frames) == (1, 1, 4)


@pytest.mark.parametrize(
    ("stamp", "said"),
    [
        (0, "no time stamp"),
        (NOW - 1169 * 86400 * SECOND, "1169 days behind this computer's clock"),
        (NOW + 800 * 86400 * SECOND, "800 days ahead of this computer's clock"),
    ],
)
def test_invalid_stamp_is_counted_and_replaced_by_the_arrival_time(stamp, said):
    assembler = FrameAssembler()
    sent = [depth(NOW + k * PERIOD, k) for k in range(6)]
    sent[3] = depth(stamp, 3, arrival=sent[3].arrival_ns)
    found = frames_of(assembler, *sent)
    assert assembler.counters.bad_stamps == 1
    assert said in assembler.counters.problem
    np.testing.assert_allclose([f.time_s for f in found], np.arange(6) * PERIOD * 1e-9, atol=1e-9)
    assert found[3].stamp_ns == stamp  # its own


def test_clock_jump_is_accepted_after_three_frames():
    assembler = FrameAssembler()
    jump = -3 * 3600 * SECOND
    sent = [depth(NOW + k * PERIOD, k) for k in range(5)]
    sent += [
        depth(NOW + k * PERIOD + jump, k, arrival=NOW + k * PERIOD + 1_000_000)
        for k in range(5, 12)
    ]
    found = frames_of(assembler, *sent)
    assert assembler.counters.clock_jumps == 1
    assert assembler.counters.bad_stamps == 2
    assert len(found) == 12
    assert found[-1].time_s == pytest.approx(4 * PERIOD * 1e-9)


def test_short_loop_with_repeated_stamps_is_followed():
    """Of a loop joined at its last frame, all other frames are older."""
    assembler = FrameAssembler()
    sent = [
        depth(NOW + (k % 20) * PERIOD, k, arrival=NOW + k * PERIOD + 1_000_000)
        for k in range(19, 219)
    ]
    assert len(frames_of(assembler, *sent)) > 40


def test_wrong_sizes_types_and_bytes_are_counted_separately():
    assembler = FrameAssembler(size=(WIDTH, HEIGHT))
    stamps = [NOW + k * PERIOD for k in range(8)]
    found = frames_of(
        assembler,
        depth(stamps[0]),
        arrived("/cam/depth", IMAGE, image(stamps[1], height=24, width=32), stamps[1]),
        arrived("/cam/depth", "std_msgs/msg/String", b"\0\1\0\0\4\0\0\0abc\0", stamps[2]),
        arrived("/cam/depth", IMAGE, b"", stamps[3]),
        arrived("/cam/depth", IMAGE, b"\xff" * 5000, stamps[4]),
        arrived("/cam/depth", IMAGE, image(stamps[5])[:-100], stamps[5]),
        arrived("/cam/depth", IMAGE, image(stamps[6], encoding="rgb8"), stamps[6]),
        depth(stamps[7]),
    )
    counters = assembler.counters
    assert len(found) == 2
    assert (counters.wrong_size, counters.wrong_type, counters.undecodable) == (1, 1, 4)
    assert "/cam/depth" in counters.problem


def test_topic_named_depth_is_preferred_and_infrared_ignored():
    assembler = FrameAssembler()
    sent = []
    for k in range(3):
        stamp = NOW + k * PERIOD
        sent += [depth(stamp, 50, topic="/cam/ir"), depth(stamp, k, topic="/cam/depth/image")]
    found = frames_of(assembler, *sent)
    assert [number_shown(frame) for frame in found] == [50, 0, 1, 2]


def test_topics_of_other_sensors_and_own_results_are_ignored():
    assembler = FrameAssembler(TopicNames(prefix="/left"))
    found = frames_of(
        assembler, depth(NOW, 1, topic="/right/depth"), depth(NOW, 2, topic="/left/depth")
    )
    assert len(found) == 1
    ours = arrived("/bubbleviz/contact_patch", CLOUD, cloud(NOW, np.ones((4, 3)), 2, 2), NOW)
    assembler = FrameAssembler()
    assert frames_of(assembler, ours) == []
    assert assembler.counters.undecodable == 0


GOOD = {
    IMAGE: image(NOW),
    INFO: camera_info(NOW),
    PRESSURE: pressure(NOW, 1e5),
    WRENCH: wrench(NOW, [1.0] * 6),
    CLOUD: cloud(NOW, np.ones((HEIGHT * WIDTH, 3)), HEIGHT, WIDTH),
}


@settings(max_examples=300)
@given(
    st.sampled_from(sorted(GOOD)),
    st.lists(st.tuples(st.integers(0, 400), st.binary(min_size=1, max_size=8)), max_size=4),
    st.integers(0, 12_000),
    st.binary(max_size=64),
)
def test_arbitrary_bytes_raise_no_exception(kind, changes, cut, tail):
    data = bytearray(GOOD[kind])
    for at, new in changes:
        data[at : at + len(new)] = new
    payload = bytes(data[:cut]) + tail
    assembler = FrameAssembler()
    for k in range(2):
        assembler.push(Message("/t/depth", kind, payload, stamp_of(payload), NOW + k * PERIOD))
    assembler.push(depth(NOW + 2 * PERIOD, topic="/t/depth2"))
    assembler.flush()
    assert assembler.counters.received == 3


@settings(max_examples=200)
@given(st.sampled_from(sorted(GOOD)), st.binary(max_size=300))
def test_random_bytes_are_counted_as_undecodable(kind, noise):
    assembler = FrameAssembler()
    assembler.push(Message("/t", kind, b"\x07" + noise, stamp_of(noise), NOW))
    assert assembler.counters.undecodable == 1


@settings(max_examples=100)
@given(st.lists(st.integers(-(2**40), 2**63 - 1), min_size=1, max_size=30))
def test_frame_times_are_monotonic_between_clock_jumps(stamps):
    assembler = FrameAssembler()
    found: list[Frame] = []
    for k, stamp in enumerate(stamps):
        found += assembler.push(arrived("/cam/depth", IMAGE, GOOD[IMAGE], stamp, NOW + k * PERIOD))
    found += assembler.flush()
    counters = assembler.counters
    assert len(found) + counters.duplicate + counters.out_of_order == len(stamps)
    falls = sum(b.time_s < a.time_s for a, b in pairwise(found))
    assert falls <= 2 * counters.clock_jumps + counters.bad_stamps


@pytest.mark.parametrize(("equal", "told"), [(29, False), (30, True)])
def test_a_camera_that_repeats_its_last_image_gives_a_warning(equal, told):
    """With a new time stamp each time; an image without returns (covered camera) gives none."""
    assembler = FrameAssembler()
    for k in range(equal + 40):
        number = 10 if 10 <= k < 10 + equal else k
        assembler.push(depth(NOW + k * PERIOD, number))
    assert bool(assembler.equal.warning) == told
    assert assembler.counters.equal_in_a_row == (equal if told else 0)
    covered = FrameAssembler()
    for k in range(60):
        nothing = np.zeros(2 * WIDTH * HEIGHT, np.uint8)
        stamp = NOW + k * PERIOD
        covered.push(arrived("/cam/depth", IMAGE, image(stamp, data=nothing), stamp))
    assert not covered.equal.warning
