"""Recordings that we write are read by rosbags and by our reader."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from rosbags.highlevel import AnyReader

from bubbleviz.camera import Intrinsics
from bubbleviz.errors import InputError
from bubbleviz.recordings import Frame, Recording, RecordingWriter

CAMERA = Intrinsics(5, 4, 30.0, 31.0, 2.0, 1.5, "inverse_brown_conrady", (0.1, 0.2, 0.0, 0.0, 0.3))


def frame(k, shape=(4, 5)):
    depth = np.linspace(0.05, 0.2, shape[0] * shape[1], dtype=np.float32).reshape(shape) + 0.01 * k
    depth[0, 0] = np.nan
    return Frame(
        index=k,
        time_s=k / 30.0,
        depth_m=depth,
        intrinsics=CAMERA if shape == (4, 5) else None,
        gas_pressure_pa=106_000.0 + k,
        wrench=np.arange(6.0) + k,
        stamp_ns=10**18 + k * 33_333_333,
    )


@pytest.mark.parametrize("name", ["rec.mcap", "folder"])
def test_round_trip(tmp_path, name):
    path = tmp_path / name
    with RecordingWriter(path) as writer:
        for k in range(5):
            writer.write(frame(k))
    assert writer.count == 5
    assert [entry.name for entry in tmp_path.iterdir()] == [name]
    assert path.is_file() == (name == "rec.mcap")
    with Recording(path) as recording:
        assert len(recording) == 5
        for k in range(5):
            got, sent = recording[k], frame(k)
            np.testing.assert_array_equal(got.depth_m, sent.depth_m)
            assert got.intrinsics == CAMERA
            assert got.gas_pressure_pa == sent.gas_pressure_pa
            np.testing.assert_array_equal(got.wrench, sent.wrench)
            assert got.stamp_ns == sent.stamp_ns


def test_rosbags_reads_it(tmp_path):
    path = tmp_path / "rec.mcap"
    with RecordingWriter(path, encoding="16UC1") as writer:
        writer.write(frame(0))
    with AnyReader([path]) as reader:
        messages = {
            connection.msgtype: reader.deserialize(raw, connection.msgtype)
            for connection, _, raw in reader.messages()
        }
    image = messages["sensor_msgs/msg/Image"]
    assert (image.encoding, image.step) == ("16UC1", 10)
    expected = np.rint(np.nan_to_num(frame(0).depth_m) * 1000)
    np.testing.assert_array_equal(image.data.view(np.uint16).reshape(4, 5), expected)
    info = messages["sensor_msgs/msg/CameraInfo"]
    np.testing.assert_array_equal(info.k, [30, 0, 2, 0, 31, 1.5, 0, 0, 1])
    np.testing.assert_array_equal(info.d, [0.1, 0.2, 0, 0, 0.3])
    assert messages["sensor_msgs/msg/FluidPressure"].fluid_pressure == 106_000.0
    assert messages["geometry_msgs/msg/WrenchStamped"].wrench.torque.z == 5.0


@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(1, 40), st.integers(1, 40), st.sampled_from(["32FC1", "16UC1"]))
def test_any_size(tmp_path, height, width, encoding):
    path = tmp_path / "rec.mcap"
    path.unlink(missing_ok=True)
    sent = frame(0, (height, width))
    with RecordingWriter(path, encoding=encoding) as writer:
        writer.write(sent)
    with Recording(path) as recording:
        tolerance = 0.0 if encoding == "32FC1" else 0.5001e-3
        np.testing.assert_allclose(recording[0].depth_m, sent.depth_m, rtol=0, atol=tolerance)


def test_late_topics_are_written(tmp_path):
    path = tmp_path / "rec.mcap"
    with RecordingWriter(path) as writer:
        writer.write(Frame(0, 0.0, frame(0).depth_m))
        writer.write(frame(1))
    with Recording(path) as recording:
        assert recording.intrinsics == CAMERA
        assert recording[1].gas_pressure_pa == 106_001.0
        assert recording[0].gas_pressure_pa is None


def test_times_replace_missing_stamps(tmp_path):
    path = tmp_path / "rec.mcap"
    with RecordingWriter(path) as writer:
        for k in range(3):
            writer.write(Frame(k, k / 30.0, frame(k).depth_m))
    with Recording(path) as recording:
        np.testing.assert_allclose(recording.times_s, np.arange(3) / 30.0, atol=2e-9)


def test_failure_leaves_no_file(tmp_path):
    with pytest.raises(ZeroDivisionError), RecordingWriter(tmp_path / "rec.mcap") as writer:
        writer.write(frame(0))
        raise ZeroDivisionError
    with pytest.raises(InputError, match="no frames"), RecordingWriter(tmp_path / "rec.mcap"):
        pass
    assert list(tmp_path.iterdir()) == []
