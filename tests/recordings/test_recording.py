"""Recordings written by another program are read correctly."""

import io
import os

import numpy as np
import psutil
import pytest
from bagmaker import (
    HEIGHT,
    KINDS,
    PERIOD,
    SECOND,
    START,
    WIDTH,
    BagMaker,
    depth_image,
    fill,
    pressure_at,
)
from compressed_depth import compressed

from bubbleviz.api.batching import find_recordings
from bubbleviz.api.frames import info
from bubbleviz.errors import InputError
from bubbleviz.recordings import Recording, bag_storage as chunks


def test_every_format_gives_the_frames_written(press):
    with Recording(press) as recording:
        assert len(recording) == 6
        np.testing.assert_allclose(recording.times_s, np.arange(6) * PERIOD / SECOND, atol=1e-12)
        for k in (5, 0, 3, 3, 1):  # any order
            frame = recording[k]
            np.testing.assert_array_equal(frame.depth_m, depth_image(k))
            assert frame.depth_m.dtype == np.float32
            assert (frame.index, frame.stamp_ns) == (k, START + k * PERIOD)
            assert frame.time_s == recording.times_s[k]
            assert frame.gas_pressure_pa == pytest.approx(pressure_at(frame.stamp_ns), abs=1e-6)
            np.testing.assert_allclose(frame.wrench, [k, 2, 3, 4, 5, 6])
            assert (frame.intrinsics.width, frame.intrinsics.height) == (WIDTH, HEIGHT)
            assert (frame.intrinsics.fx, frame.intrinsics.cy) == (30.0, 11.5)
            assert frame.intrinsics.distortion_model == "none"  # plumb_bob with zeros


def write_compressed(folder, kind, encoding, cut=None, more=""):
    """Compressed depth with a hole, and compressed colour images."""
    bag, topic = BagMaker(kind), "/cam/depth/image/compressedDepth"
    image = "sensor_msgs/msg/CompressedImage"
    for k in range(4):
        stamp = START + k * PERIOD
        depth = depth_image(k)
        depth[3, 5] = np.nan
        text, data = compressed(depth, encoding)
        pixels = np.frombuffer(data[:cut], np.uint8)
        header = bag.header(stamp)
        bag.camera_info(stamp)
        jpeg = np.arange(9, dtype=np.uint8)
        bag.add("/cam/color/compressed", image, stamp, header=header, format="jpeg", data=jpeg)
        bag.add(topic, image, stamp, header=header, format=text + more, data=pixels)
    return bag.write(folder)


@pytest.mark.parametrize("kind", ["mcap file", "db3 folder", "bag none"])
@pytest.mark.parametrize(("encoding", "off_m"), [("16UC1", 5.1e-4), ("32FC1", 2e-5)])
def test_compressed_depth_is_read(tmp_path, kind, encoding, off_m):
    with Recording(write_compressed(tmp_path, kind, encoding, more=" png")) as recording:
        assert (len(recording), recording.size) == (4, (WIDTH, HEIGHT))
        assert recording.encoding == encoding
        assert recording.intrinsics is not None
        for k in range(4):
            depth, true = recording[k].depth_m, depth_image(k)
            assert depth.dtype == np.float32 and np.isnan(depth[3, 5])
            true[3, 5] = np.nan
            assert np.nanmax(np.abs(depth - true)) < off_m
            np.testing.assert_array_equal(np.isnan(depth), np.isnan(true))


@pytest.mark.parametrize(
    ("cut", "more", "says"),
    [
        (60, "", "not a compressed depth image"),
        (5, "", "not a compressed"),
        (None, " rvl", "only PNG"),
    ],
)
def test_compressed_depth_that_cannot_be_read_is_refused(tmp_path, cut, more, says):
    path = write_compressed(tmp_path, "mcap file", "16UC1", cut, more)
    with pytest.raises(InputError, match=says):
        Recording(path)


def write_files(folder, starts, kind="mcap file"):
    """Three frames in each file, from the time of a frame on; no metadata."""
    for name, start in starts.items():
        bag = BagMaker(kind)
        for k in range(start, start + 3):
            bag.image(START + k * PERIOD, depth_image(k % 9))
        bag.write(folder, name)
        (folder / name / "metadata.yaml").unlink()
        (folder / name).rmdir()


@pytest.mark.parametrize("kind", ["mcap file", "db3 file"])
@pytest.mark.parametrize("names", [("rec_9", "rec_10"), ("0_rec_10-00-00", "1_rec_10-00-01")])
def test_a_bag_split_over_files_is_one_recording(tmp_path, names, kind):
    write_files(tmp_path, dict(zip(names, (0, 3), strict=True)), kind)
    with Recording(tmp_path) as recording:
        for k in range(6):
            np.testing.assert_array_equal(recording[k].depth_m, depth_image(k))


def test_a_split_bag_whose_last_file_has_no_message_yet_is_one_recording(tmp_path):
    write_files(tmp_path, {"rec_0": 0, "rec_1": 3, "rec_2": 6})
    os.truncate(tmp_path / "rec_2.mcap", 300)
    with Recording(tmp_path) as recording:
        assert len(recording) == 6


@pytest.mark.parametrize(
    "starts",
    [
        {"press_0": 0, "press_1": 0},  # at the same time
        {"press_0": 0, "press_1": 300},  # ten seconds later
    ],
    ids=str,
)
@pytest.mark.parametrize("kind", ["mcap file", "db3 file"])
def test_a_folder_of_separate_recordings_is_refused(tmp_path, starts, kind):
    """Else frames of all of them would be interleaved as those of one."""
    write_files(tmp_path, starts, kind)
    for open_folder in (Recording, info):
        with pytest.raises(InputError, match="give one of the files") as refused:
            open_folder(tmp_path)
        assert str(tmp_path) in str(refused.value) and min(starts) in str(refused.value)
    assert len(find_recordings(tmp_path)) == 2


def test_stamps_out_of_order_are_sorted(tmp_path):
    bag = BagMaker("mcap file")
    for log, k in enumerate((2, 0, 1)):
        bag.image(START + k * PERIOD, depth_image(k), log=START + log)
    with Recording(bag.write(tmp_path)) as recording:
        assert (np.diff(recording.times_s) > 0).all()
        for k in range(3):
            np.testing.assert_array_equal(recording[k].depth_m, depth_image(k))


@pytest.mark.parametrize("frames", [3, 40])
def test_laps_of_a_recorded_loop_follow_each_other_by_log_times(tmp_path, frames):
    """A replay that begins again has its old stamps again, whether or not they go back far."""
    bag, laps = BagMaker("mcap file"), 3
    for log in range(laps * frames):
        bag.image(START + (log % frames) * PERIOD, depth_image(log % 5), log=START + log * PERIOD)
        bag.pressure(START + (log % frames) * PERIOD, 1e5 + log, log=START + log * PERIOD)
    with Recording(bag.write(tmp_path)) as recording:
        np.testing.assert_allclose(np.diff(recording.times_s), PERIOD * 1e-9)
        for log in (0, frames - 1, frames, 2 * frames + 1):
            frame = recording[log]
            np.testing.assert_array_equal(frame.depth_m, depth_image(log % 5))
            assert frame.gas_pressure_pa == pytest.approx(1e5 + log)
        assert "begin again" in recording.note


def jumping(at):
    """A clock that is set forward by 400 days before the fifth frame."""
    return at + (at > START + 4 * PERIOD) * 400 * 86_400 * SECOND


def garbled(stamp):
    """A clock one second slow, with one garbage stamp."""
    return lambda at: stamp if at == START + 3 * PERIOD else at - SECOND


@pytest.mark.parametrize(
    ("image_ns", "gas_ns", "note"),
    [
        (lambda at: 0, lambda at: 0, ""),
        (
            lambda at: at,
            lambda at: at - 3600 * SECOND,
            "stamps on /gas are of another clock (-3600.0 s)",
        ),
        (jumping, jumping, "was set during the recording"),
        (lambda at: START, lambda at: START, "never advance"),
        *(
            (garbled(stamp), lambda at: at - SECOND, "")
            for stamp in (5, 86_400 * SECOND, 2_100_000_000 * SECOND)
        ),
    ],
)
def test_log_times_replace_stamps_that_are_missing_or_of_another_clock(
    tmp_path, image_ns, gas_ns, note
):
    bag = BagMaker("mcap file")
    for k in range(7):
        log = START + k * PERIOD
        bag.image(image_ns(log), depth_image(k % 5), log=log)
        bag.pressure(gas_ns(log), pressure_at(log), log=log)
    with Recording(bag.write(tmp_path)) as recording:
        np.testing.assert_allclose(recording.times_s, np.arange(7) * PERIOD * 1e-9)
        for k in range(7):
            np.testing.assert_array_equal(recording[k].depth_m, depth_image(k % 5))
            expected = pressure_at(START + k * PERIOD)
            assert recording[k].gas_pressure_pa == pytest.approx(expected)
        assert note in (recording.note or "")


def test_values_recorded_at_another_time_are_not_used_and_noted(tmp_path):
    bag = BagMaker("mcap file")
    for k in range(7):
        bag.image(START + k * PERIOD, depth_image(0))
        bag.pressure(START + k * PERIOD - 3600 * SECOND, 1e5)
    with Recording(bag.write(tmp_path)) as recording:
        assert all(frame.gas_pressure_pa is None for frame in recording)
        assert "/gas was recorded at another time than the images (-3600.0 s)" in recording.note


@pytest.mark.parametrize(("late_s", "found"), [(0.09, True), (0.11, False)])
def test_pressure_beyond_its_range_is_the_nearest_or_none(tmp_path, late_s, found):
    bag = BagMaker("mcap file")
    bag.pressure(START, 106_000.0)
    bag.image(START + round(late_s * SECOND), depth_image(0))
    bag.image(START - round(late_s * SECOND), depth_image(1))
    with Recording(bag.write(tmp_path)) as recording:
        expected = 106_000.0 if found else None
        assert [recording[k].gas_pressure_pa for k in range(2)] == [expected] * 2


def test_without_gas_pressure_wrench_and_camera_info_they_are_none(tmp_path):
    bag = BagMaker("mcap file")
    bag.image(START, depth_image(0))
    with Recording(bag.write(tmp_path)) as recording:
        frame = recording[0]
        assert (frame.gas_pressure_pa, frame.wrench, frame.intrinsics) == (None, None, None)
        assert not recording.has_wrench


def test_the_depth_image_is_found_among_others_and_may_be_chosen(tmp_path):
    bag = BagMaker("mcap file")
    grey = np.zeros((HEIGHT, WIDTH), dtype=np.uint8)
    infrared = np.full((HEIGHT, WIDTH), 500, dtype=np.uint16)
    bag.image(START, grey, "mono8", topic="/cam/depth/confidence")
    bag.image(START, infrared, "16UC1", topic="/cam/infrared/image")
    bag.image(START, depth_image(0), topic="/cam/depth/image")
    path = bag.write(tmp_path)
    with Recording(path) as recording:
        assert recording.depth_topic.name == "/cam/depth/image"
    with Recording(path, depth_topic="/cam/infrared/image") as recording:
        assert recording[0].depth_m[0, 0] == np.float32(0.5)
    with pytest.raises(InputError, match="/nope"):
        Recording(path, depth_topic="/nope")
    with pytest.raises(InputError, match="/nope"):
        Recording(path, pressure_topic="/nope")


def test_camera_info_of_the_same_camera_and_size_is_taken(tmp_path):
    bag = BagMaker("mcap file")
    bag.camera_info(START, topic="/other/camera_info", k=np.eye(3).ravel() * 7)
    bag.camera_info(START, topic="/cam/color/camera_info", width=1280, height=720)
    bag.camera_info(START)
    bag.image(START, depth_image(0))
    with Recording(bag.write(tmp_path)) as recording:
        assert recording.intrinsics.fx == 30.0


def test_reading_one_frame_does_not_decompress_the_others(tmp_path, monkeypatch):
    rng = np.random.default_rng(0)
    bag = BagMaker("mcap file")
    for k in range(20):
        noise = rng.uniform(0.1, 0.2, (480, 640)).astype(np.float32)
        bag.image(START + k * PERIOD, noise)
    path = bag.write(tmp_path)
    inflated = [0]
    original = chunks.LazyChunk.read

    def counting(self, count):
        before = self.memory
        part = original(self, count)
        inflated[0] += self.memory - before
        return part

    monkeypatch.setattr(chunks.LazyChunk, "read", counting)
    image = 640 * 480 * 4
    with Recording(path) as recording:
        assert inflated[0] < 2 * image  # 20 headers and the first image
        inflated[0] = 0
        recording[13]
        assert inflated[0] < 1.2 * image


def test_a_chunk_read_to_its_end_keeps_no_buffers_of_its_decompressor():
    """Which for a zstd frame of that window are as large as the chunk."""
    size, number = 8 << 20, 6
    options = {chunks.zstd.CompressionParameter.window_log: 24}
    packed = chunks.zstd.compress(np.random.default_rng(0).bytes(size), options=options)
    before, kept = psutil.Process().memory_info().rss, []
    for _ in range(number):
        part = chunks.FilePart(io.BytesIO(packed), 0, len(packed))
        kept.append(chunks.LazyChunk(part, "zstd", size=size))
        assert len(kept[-1].read(size)) == size
    assert psutil.Process().memory_info().rss - before < 2 * number * size


def test_a_long_recording_with_stamps_equal_to_log_times_reads_few_headers(tmp_path, monkeypatch):
    monkeypatch.setattr("bubbleviz.recordings.recording.SAMPLED_ABOVE", 100)
    reads = []
    bag, jittered = BagMaker("mcap file"), BagMaker("mcap file")
    for k in range(300):
        bag.image(START + k * PERIOD, depth_image(k, 2, 3))
        jittered.image(START + k * PERIOD, depth_image(k, 2, 3), log=START + k * PERIOD + k % 7)
    from bubbleviz.recordings import Messages

    original = Messages.header
    monkeypatch.setattr(Messages, "header", lambda m, k: reads.append(k) or original(m, k))
    with Recording(bag.write(tmp_path, "same")) as recording:
        assert len(reads) == 64
        np.testing.assert_allclose(np.diff(recording.times_s), PERIOD / SECOND, atol=1e-12)
    with Recording(jittered.write(tmp_path, "jittered")) as recording:
        np.testing.assert_allclose(np.diff(recording.times_s), PERIOD / SECOND, atol=1e-12)


def test_real_recording_against_rosbags(punyo_press):
    """Frames and pressures of the real press as rosbags' own sequential reader gives them."""
    from rosbags.highlevel import AnyReader

    with AnyReader([punyo_press]) as reader, Recording(punyo_press) as recording:
        by_type = {c.msgtype: c for c in reader.connections}
        images = by_type["sensor_msgs/msg/Image"]
        stamps, pressures = [], []
        for connection, _, raw in reader.messages([by_type["sensor_msgs/msg/FluidPressure"]]):
            message = reader.deserialize(raw, connection.msgtype)
            stamps.append(message.header.stamp.sec * SECOND + message.header.stamp.nanosec)
            pressures.append(message.fluid_pressure)
        for k, (connection, _, raw) in enumerate(reader.messages([images])):
            if k % 15:
                continue
            message = reader.deserialize(raw, connection.msgtype)
            pixels = message.data.view(np.float32).reshape(480, 640)
            frame = recording[k]
            np.testing.assert_array_equal(np.nan_to_num(frame.depth_m), pixels)
            offsets = np.array(stamps) - frame.stamp_ns
            expected = np.interp(0.0, offsets, pressures)
            assert frame.gas_pressure_pa == pytest.approx(expected, abs=0.01)
        assert len(recording) == 90
        assert recording.intrinsics.distortion_model == "inverse_brown_conrady"


@pytest.mark.parametrize("kind", KINDS)
def test_close_releases_the_file(tmp_path, kind):
    path = fill(BagMaker(kind)).write(tmp_path)
    descriptors = psutil.Process().num_fds
    before = descriptors()
    with Recording(path) as recording:
        recording[0]
        assert descriptors() > before
    assert descriptors() == before
