"""The recorder skips nothing, and its file opens wherever writing was interrupted."""

import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader
from wire import IMAGE, NOW, PERIOD, camera_info, depth, gas, image, number_of, number_shown

from bubbleviz.api.frames import info
from bubbleviz.errors import InputError
from bubbleviz.live import Recorder
from bubbleviz.recordings import MARKERS, Message, Recording
from tests.program import python

INFO = "sensor_msgs/msg/CameraInfo"


def record(path, frames=50, recorder=None):
    recorder = recorder or Recorder()
    recorder.start(path)
    for k in range(frames):
        stamp = NOW + k * PERIOD
        recorder.push(depth(stamp, k))
        recorder.push(gas(stamp, 1e5 + k))
        recorder.push(Message("/cam/camera_info", INFO, camera_info(stamp), stamp, stamp))
    recorder.mark("grasp")
    status = recorder.stop()
    assert (status.problem, status.messages) == ("", 3 * frames + 1)


@pytest.mark.parametrize("name", ["rec.mcap", "folder"])
def test_mcap_and_rosbags_read_every_message_with_its_schema(tmp_path, name):
    path = tmp_path / name
    record(path)
    file = path if path.is_file() else path / "folder.mcap"
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary.statistics.message_count == 151
        found = [m.data for s, _, m in reader.iter_messages() if s is not None and s.name == IMAGE]
        assert {s.encoding for s in summary.schemas.values()} == {"ros2msg"}
        assert all("topic_type_hash" in c.metadata for c in summary.channels.values())
        assert {c.compression for c in summary.chunk_indexes} == {"lz4"}
    assert [number_of(data) for data in found] == list(range(50))
    assert found[7] == image(NOW + 7 * PERIOD, 7)
    with AnyReader([path]) as bag:
        for connection, _, raw in bag.messages():
            message = bag.deserialize(raw, connection.msgtype)  # by the schema in the file
            assert message is not None
        topics = {t: (i.msgtype, i.msgcount) for t, i in bag.topics.items()}
    assert topics["/cam/depth"] == (IMAGE, 50)
    assert topics[MARKERS] == ("std_msgs/msg/String", 1)
    assert topics["/gas"] == ("sensor_msgs/msg/FluidPressure", 50)
    # it is read as any recording
    with Recording(path) as recording:
        assert len(recording) == 50
        assert recording.bag.note == ""
        assert recording[9].gas_pressure_pa == 1e5 + 9
        assert recording.intrinsics is not None
        np.testing.assert_allclose(recording.times_s, np.arange(50) * PERIOD * 1e-9)


def test_markers_and_notes_are_kept_with_their_time(tmp_path):
    recorder = Recorder()
    recorder.start(tmp_path / "rec.mcap")
    recorder.push(depth(time.time_ns()))
    before = time.time_ns()
    recorder.mark("slip, second try")
    recorder.mark()
    after = time.time_ns()
    recorder.stop()
    with AnyReader([tmp_path / "rec.mcap"]) as bag:
        found = [
            (bag.deserialize(raw, connection.msgtype).data, at)
            for connection, at, raw in bag.messages()
            if connection.topic == MARKERS
        ]
    assert [text for text, _ in found] == ["slip, second try", "marker"]
    assert all(before <= at <= after for _, at in found)


def test_pre_roll_is_recorded(tmp_path):
    recorder = Recorder(pre_roll_s=1.0)
    for k in range(90):
        recorder.push(depth(NOW + k * PERIOD, k))
    recorder.start(tmp_path / "rec.mcap")
    recorder.push(depth(NOW + 90 * PERIOD, 90))
    recorder.stop()
    with Recording(tmp_path / "rec.mcap") as recording:
        numbers = [number_shown(recording[k]) for k in range(len(recording))]
    assert numbers == list(range(60, 91)) or numbers == list(range(59, 91))


def test_nothing_is_overwritten_and_only_one_recording_runs(tmp_path):
    (tmp_path / "rec.mcap").write_text("precious")
    recorder = Recorder()
    with pytest.raises(InputError, match="exists"):
        recorder.start(tmp_path / "rec.mcap")
    with pytest.raises(InputError, match="does not exist"):
        recorder.start(tmp_path / "nowhere" / "rec.mcap")
    recorder.start(tmp_path / "other.mcap")
    with pytest.raises(InputError, match="already"):
        recorder.start(tmp_path / "third.mcap")
    recorder.stop()
    assert (tmp_path / "rec.mcap").read_text() == "precious"
    assert [entry.name for entry in tmp_path.iterdir()] == ["rec.mcap"]  # nothing came: no file
    recorder.start(tmp_path / "folder")
    recorder.stop()
    assert [entry.name for entry in tmp_path.iterdir()] == ["rec.mcap"]
    with pytest.raises(InputError, match="no recording is in progress"):
        recorder.stop()


STREAM = """
import sys, time
sys.path.insert(0, {tests!r})
from tests.live.wire import NOW, depth, gas
from bubbleviz.live import Recorder
recorder = Recorder()
recorder.start({path!r})
k = 0
while True:
    now = time.time_ns()
    recorder.push(depth(now, k, arrival=now))
    recorder.push(gas(now, 1e5 + k, arrival=now))
    print(k, flush=True)
    k += 1
    time.sleep(0.004)
"""


@pytest.mark.parametrize(
    ("name", "seed"),
    [("rec.mcap", 0), pytest.param("rec.mcap", 1, marks=pytest.mark.long), ("folder", 2)],
)
def test_a_recorder_that_is_killed_leaves_all_but_the_last_second(tmp_path, name, seed):
    path = tmp_path / name
    code = STREAM.format(tests=str(Path(__file__).parents[2]), path=str(path))
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    for _ in range(random.Random(seed).randint(250, 300)):  # more than a second
        process.stdout.readline()
    os.kill(process.pid, signal.SIGKILL)
    killed_ns = time.time_ns()
    process.communicate()
    with Recording(path) as recording:
        numbers = [number_shown(recording[k]) for k in range(len(recording))]
        assert numbers == list(range(len(numbers)))  # without a gap, from the first
        assert killed_ns - recording.stamps_ns[-1] < 1_000_000_000
        assert recording.bag.note
        assert recording[5].gas_pressure_pa == 1e5 + 5
    assert "note" in info(path).to_text()
    file = path if path.is_file() else path / "folder.mcap"
    with file.open("rb") as stream:  # mcap's own, for streams without an end
        images = 0
        try:
            for record in StreamReader(stream).records:
                images += type(record).__name__ == "Message" and len(record.data) > 1000
        except Exception:
            pass
    assert images == len(numbers)


@pytest.mark.parametrize("pause_s", [0.002, 0.0])
def test_a_full_disk_ends_the_recording_and_keeps_the_messages_so_far(tmp_path, pause_s):
    """In a process whose files may not grow beyond 2.5 MB, at a pace or all at once."""
    path = tmp_path / "rec.mcap"
    code = f"""
        import resource, signal, sys, time
        sys.path.insert(0, {str(Path(__file__).parents[2])!r})
        import numpy as np
        from tests.live.wire import IMAGE, NOW, PERIOD, image, arrived
        from bubbleviz.live import Recorder
        from bubbleviz.recordings import ros2_types
        ros2_types()
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (2_500_000, 2_500_000))
        recorder, rng = Recorder(), np.random.default_rng(0)
        recorder.start({str(path)!r})
        for k in range(500):
            noise = rng.integers(1, 60_000, (48, 64), dtype="<u2").view(np.uint8).ravel()
            stamp = NOW + k * PERIOD
            recorder.push(arrived("/cam/depth", IMAGE, image(stamp, k, data=noise), stamp))
            time.sleep({pause_s})
        status = recorder.stop()
        print(status.messages, status.size_bytes, status.problem)
    """
    said = python(code)
    assert "recording stopped (File too large)" in said
    told = re.search(r"its first ([0-9.]+) s were saved \((\d+) messages", said)
    assert told is not None
    with Recording(path) as recording:
        assert 150 < len(recording) < 500
        assert len(recording) == int(told[2])
        assert recording.times_s[-1] == pytest.approx(float(told[1]), abs=0.06)
        np.testing.assert_allclose(
            recording.times_s, np.arange(len(recording)) * PERIOD * 1e-9, atol=1e-6
        )
    assert path.stat().st_size == int(said.split()[1])


def test_failed_replacement_restores_the_earlier_recording(tmp_path, small_sensor_file):
    path = tmp_path / "earlier.mcap"
    path.write_bytes(b"an earlier recording")
    code = f"""
        import resource, signal
        import bubbleviz as bv
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
        sensor, path = {str(small_sensor_file)!r}, {str(path)!r}
        try:
            source = "synthetic:?rate=100&noise=0.01&frames=4"
            bv.record(source, path, sensor=sensor, overwrite=True)
        except bv.InputError as error:
            print(error)
    """
    assert "nothing was saved, the earlier recording was restored;" in python(code)
    assert path.read_bytes() == b"an earlier recording"
