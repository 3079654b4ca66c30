"""The commands, as processes: record, watch, publish."""

import json
import os
import signal
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader
from small_press import record, small_source
from streams import listens, messages_in, recorded
from wire import NOW, PERIOD, depth

import bubbleviz as bv
from benchmarks.window.live_soak import Publisher, free_port, gaps_in, sequences
from bubbleviz.api.frames import info
from bubbleviz.camera import ColourCamera, ColourImage, EncodedImage
from bubbleviz.errors import InputError
from bubbleviz.live import SessionOptions, ZenohSource, open_session, open_stream
from bubbleviz.recordings import IMAGE, Frame, Recording, RecordingWriter
from bubbleviz.sensor import load_sensor
from tests.program import facts_of, output_of, refusal, run, start


def write_plain(path, frames):
    """Images of one depth, of another size than any preset's."""
    depth_m = np.full((48, 64), 0.1, np.float32)
    record(path, (Frame(k, 0.01 * k, depth_m) for k in range(frames)))


def has_frames(path):
    """Whether a recording in the making opens, with some frames."""
    try:
        return path.exists() and info(path).frames > 0
    except InputError:
        return False


def test_live_gas_pressure_in_another_unit(tmp_path, small_sensor_file):
    frames = (replace(each, gas_pressure_pa=1039.1) for each in small_source(small_sensor_file))
    source = f"replay:{record(tmp_path / 'hpa.mcap', frames)}"
    told = refusal("watch", "--source", source, "--sensor", small_sensor_file)
    assert source in told and "is in hPa, not in Pa" in told and "multiply it by 100" in told


def test_record_for_a_duration(tmp_path, small_sensor_file):
    out = tmp_path / "rec.mcap"
    words = ("--sensor", small_sensor_file, "--out", out, "--duration", 0.6, "--json")
    source = "synthetic:?rate=100&frames=4"
    facts = json.loads(output_of("record", "--source", source, *words))
    told = info(out)
    assert told.frames == facts["frames"] > 20
    assert told.gaps == 0
    assert told.note == ""
    assert facts["size_bytes"] == out.stat().st_size
    again = tmp_path / "again"
    assert "wrote" in output_of("record", "--source", f"replay:{out}?speed=9", "--out", again)
    assert (again / "metadata.yaml").exists()


def test_stopping_record_leaves_a_complete_file(tmp_path, small_sensor_file, eventually):
    out = tmp_path / "rec.mcap"
    source = "synthetic:?rate=100&frames=4"
    process = start("record", "--source", source, "--sensor", small_sensor_file, "--out", out)
    eventually(lambda: has_frames(out))
    process.send_signal(signal.SIGINT)
    stdout, stderr = process.communicate(timeout=240)
    assert (process.returncode, stderr) == (0, "")
    assert "wrote" in stdout
    with out.open("rb") as file:
        assert make_reader(file, validate_crcs=True).get_summary() is not None
    with Recording(out) as recording:
        assert recording.bag.note == ""


def test_images_of_another_camera_are_refused_in_one_line(tmp_path):
    path = tmp_path / "rec.mcap"
    write_plain(path, 8)
    for sensor, said in (
        ("pico_flexx_75mm", "images are 64×48 pixels but the camera of sensor"),
        ("auto", "no preset has a camera of 64×48 pixels"),
    ):
        assert said in refusal("watch", "--source", f"replay:{path}", "--sensor", sensor)


def test_recording_without_messages_is_reported_and_leaves_no_file(tmp_path, monkeypatch):
    monkeypatch.setattr("bubbleviz.live.opening.FIRST_MESSAGE_S", 0.3)
    out, source = tmp_path / "rec.mcap", f"zenoh:tcp/127.0.0.1:{free_port()}"
    record = ("record", "--source", source, "--out", out, "--duration", 0.1)
    watch = ("watch", "--source", source, "--sensor", "pico_flexx_75mm", "--out", out)
    for words in (record, watch):
        assert "nothing listens at" in refusal(*words)
    silent = SessionOptions("silent", listen=source.removeprefix("zenoh:"))
    with open_session(silent):
        for words, said in ((record, "no message arrived"), (watch, "no depth image arrived")):
            assert said in refusal(*words)
    assert not out.exists()


def test_publish_watch_and_record_a_source_with_results(tmp_path, small_sensor_file, eventually):
    """Simulation → Zenoh → watch → recording, in processes of their own."""
    sensor, port = ("--sensor", small_sensor_file), free_port()
    endpoint = f"tcp/127.0.0.1:{port}"
    source = "synthetic:sphere?rate=30&frames=40"
    publisher = start("publish", "--source", source, *sensor, "--listen", endpoint, "--json")
    try:
        eventually(lambda: listens(port))
        for duration in (1.6, 10.0, 60.0):  # on a busy machine few frames are seen in a second
            out = tmp_path / f"{duration:.0f}"
            told = output_of(
                *("watch", "--source", f"zenoh:{endpoint}", *sensor, "--json", "--out", out),
                *("--duration", duration, "--publish", "tcp/127.0.0.1:0", "--object", "sphere"),
            )
            facts = json.loads(told)
            if facts["frames"] > 10 and facts["status"].get("ok", 0) > 3:
                break
    finally:
        publisher.terminate()
        stdout, stderr = publisher.communicate(timeout=240)
    assert (publisher.returncode, stderr) == (0, "")
    assert facts["frames"] > 10
    assert facts["status"].keys() <= {"ok", "no_contact"}
    assert facts["pressure_offset_pa"] is None or abs(facts["pressure_offset_pa"]) < 50.0
    told = info(out)
    topics = {topic.name: topic.count for topic in told.topics}
    assert topics["/bubbleviz/contact_patch"] == facts["frames"]
    assert topics["/bubbleviz/contact_wrench"] == facts["frames"]
    assert topics["/diagnostics"] >= 1
    assert 0 < topics["/bubbleviz/object_pose"] <= facts["status"]["ok"]
    assert told.frames >= facts["frames"]
    assert told.wrench is False  # ours is no measurement
    assert json.loads(stdout)["sent"]["/bubble/depth/image_raw"] >= told.frames


def untouched_recording(path, sensor_file, frames, off_pa):
    """The small membrane at rest, in weather that is `off_pa` from the sensor file's."""
    level_pa = load_sensor(sensor_file).pneumatics.reference_pressure_pa + off_pa
    (frame,) = (small_source(sensor_file, heights=(0.06,))[0],)
    with RecordingWriter(path) as writer:
        for k in range(frames):
            moment = {"index": k, "time_s": 0.01 * k, "stamp_ns": 10**7 * (k + 1)}
            writer.write(replace(frame, gas_pressure_pa=level_pa, **moment))
    return path


def test_an_untrusted_estimate_shows_no_force(tmp_path, small_sensor_file):
    path, camera = tmp_path / "rec.mcap", load_sensor(small_sensor_file).camera
    dark = np.zeros((camera.height, camera.width), np.float32)
    record(path, (Frame(k, 0.01 * k, dark) for k in range(5)))
    words = ("watch", "--source", f"replay:{path}", "--sensor", small_sensor_file)
    facts = facts_of(*words)
    assert list(facts["status"]) == ["no_data"]
    assert facts["max_force_n"] is None
    assert " N " not in output_of(*words)


def test_watch_warns_while_it_runs_that_no_frame_fits(tmp_path, small_sensor_file):
    path = untouched_recording(tmp_path / "rest.mcap", small_sensor_file, 60, 0.0)
    with bv.open(path) as frames:
        farther = (replace(each, depth_m=np.float32(1.5) * each.depth_m) for each in frames)
        record(tmp_path / "rec.mcap", farther)
    source = f"replay:{tmp_path / 'rec.mcap'}?speed=0.1"
    done = run("watch", "--source", source, "--sensor", small_sensor_file)
    while_running, at_end = done.stderr.split("bubbleviz: warning: ")[1:]
    assert "no frame looks like the membrane" in while_running and while_running[:8] == "rec.mcap"
    assert at_end.startswith("no frame looks like the membrane")


def test_watch_says_how_wrong_forces_by_constant_tension_may_be(tmp_path, small_sensor_file):
    path = untouched_recording(tmp_path / "rec.mcap", small_sensor_file, 3, 0.0)
    told = output_of("watch", "--source", f"replay:{path}", "--sensor", small_sensor_file)
    assert "model    constant tension" in told


@pytest.mark.parametrize("frames", [1, 6])
def test_the_last_frame_of_a_source_that_ends_is_solved(tmp_path, small_sensor_file, frames):
    path = untouched_recording(tmp_path / "rec.mcap", small_sensor_file, frames, 0.0)
    source, out = f"replay:{path}?speed=1000", tmp_path / "out.mcap"
    words = ("--source", source, "--sensor", small_sensor_file, "--out", out)
    assert facts_of("watch", *words)["frames"] >= 1
    sent = messages_in(out, "/bubbleviz/contact_wrench")
    assert max(message.publish_time for _, _, message in sent) == 10**7 * frames
    with bv.connect(source, small_sensor_file) as stream:
        last = list(bv.estimate(stream))[-1]
    assert last.index == frames - 1


@pytest.mark.parametrize(
    ("off_pa", "warned", "zero"),
    [(4e3, False, "--no-zero"), (-6e3, True, "--zero"), (-6e3, True, "--no-zero")],
)
def test_warning_for_a_gas_pressure_beyond_weather(
    tmp_path, small_sensor_file, off_pa, warned, zero
):
    path = untouched_recording(tmp_path / "rec.mcap", small_sensor_file, 60, off_pa)
    for speed in (1.0, 0.1, 0.02):  # on a busy machine few frames are seen in a second
        source = f"replay:{path}?speed={speed}"
        done = run("watch", "--source", source, "--sensor", small_sensor_file, zero, "--json")
        assert done.exit_code == 0, done.output
        if zero == "--no-zero" or json.loads(done.stdout)["pressure_offset_pa"] is not None:
            break
    where = "without contact" if zero == "--zero" else "in the source"
    said = [line for line in done.stderr.splitlines() if "more than weather" in line]
    assert len(said) == warned and all(where in line for line in said)


def test_a_published_recording_waits_for_its_first_subscriber(tmp_path, eventually):
    path, port = tmp_path / "rec.mcap", free_port()
    write_plain(path, 40)
    endpoint = f"tcp/127.0.0.1:{port}"
    common = ("publish", "--listen", endpoint, "--wait", "--json", "--source")
    publisher, arrived = start(*common, f"replay:{path}"), list[str]()
    source = ZenohSource(SessionOptions("test", endpoint))
    try:
        eventually(lambda: listens(port))
        source.start(lambda message: arrived.append(message.type))
        stdout, stderr = publisher.communicate(timeout=240)
        eventually(lambda: arrived.count(IMAGE) == 40)
    finally:
        source.stop()
        publisher.kill()
    assert (publisher.returncode, stderr) == (0, "")
    assert sum(json.loads(stdout)["sent"].values()) == len(arrived)
    assert "leave out --wait" in refusal(*common, "zenoh:")


def test_colour_images_are_published_with_the_pose_of_their_camera(tmp_path, small_sensor):
    path, port = tmp_path / "rec.mcap", free_port()
    pose = np.eye(4)
    pose[:3, 3] = 0.01, 0.0, 0.02
    encoded = EncodedImage("mono8", bytes([7]) * 48 * 64, 64, 48, 64)
    with RecordingWriter(path) as writer:
        for k in range(20):
            colour = ColourImage(lambda: encoded, 0, k / 30.0, ColourCamera(T_D_C=pose))
            depth = np.full((48, 64), 0.1, np.float32)
            writer.write(Frame(k, k / 30.0, depth, find_colour=lambda _, seen=colour: seen))
    endpoint = f"tcp/127.0.0.1:{port}"
    publisher = start("publish", "--source", f"replay:{path}?loop=1", "--listen", endpoint)
    stream = open_stream(f"zenoh:{endpoint}", small_sensor)
    stream.follow_colour()
    try:
        with stream:
            image = None
            while image is None or not image.camera.placed:
                frame = stream.take(1.0)
                image = None if frame is None else frame.colour
                assert publisher.poll() is None
    finally:
        publisher.kill()
        publisher.communicate(timeout=240)
    np.testing.assert_allclose(image.camera.T_D_C, pose)
    assert image.read() == encoded


@pytest.mark.long
def test_an_encrypted_endpoint_accepts_certificate_and_password(
    tmp_path, tls, eventually, monkeypatch
):
    path, out, port = tmp_path / "rec.mcap", tmp_path / "got.mcap", free_port()
    write_plain(path, 10)
    endpoint = f"tls/localhost:{port}"
    publisher = start(
        *("publish", "--source", f"replay:{path}?loop=1", "--listen", endpoint),
        *("--cert", tls.cert, "--key", tls.key, "--login", tls.login),
    )
    try:
        eventually(lambda: listens(port))
        source = f"zenoh:{endpoint}?ca={tls.ca}&login={tls.login}"
        output_of("record", "--source", source, "--out", out, "--duration", 0.3)
        assert info(out).frames > 0
        monkeypatch.setattr("bubbleviz.live.opening.FIRST_MESSAGE_S", 2.0)
        auto, named = ("--sensor", "auto"), ("--sensor", "pico_flexx_75mm")
        refused = f"zenoh:{endpoint}?ca={tls.ca}&login={tls.stranger}"
        more = ("--out", tmp_path / "no.mcap", "--duration", 0.1)
        for words in (("record", *more), ("watch", *auto), ("watch", *named)):
            assert "and user and password in login=" in refusal(*words, "--source", refused)
        more = ("--connect", endpoint, "--ca", tls.ca, "--duration", 0.1)
        said = refusal("publish", "--source", "synthetic:", *more)
        assert "if it requires user and password" in said
    finally:
        publisher.terminate()
        publisher.communicate(timeout=240)
    source, out = f"zenoh:{endpoint}?ca=nowhere.pem", tmp_path / "second.mcap"
    said = refusal("record", "--source", source, "--out", out)
    assert "nowhere.pem: no such file" in said


def test_every_image_is_recorded(small_sensor_file, tmp_path, monkeypatch):
    """By the publisher's count."""
    monkeypatch.setattr("bubbleviz.live.opening.FIRST_MESSAGE_S", 240.0)  # a process has to start
    out, seconds = tmp_path / "soak.mcap", 4.0 if "TEST_ALL" in os.environ else 1.5
    with Publisher(str(small_sensor_file), "synthetic:?rate=60&frames=4") as publisher:
        done = run(
            "record", "--source", publisher.uri, "--out", str(out), "--duration", f"{seconds}"
        )
    assert done.exit_code == 0, done.output
    counted = sequences(out)
    assert len(counted) > 50 * seconds
    assert gaps_in(counted) == (0, 0)


def test_a_publisher_that_ends_before_the_duration_is_no_failure(tmp_path, monkeypatch):
    """The recording is complete, although nothing answers any more when the time is over."""
    monkeypatch.setattr("bubbleviz.live.opening.FIRST_MESSAGE_S", 240.0)
    monkeypatch.setattr("bubbleviz.live.zenoh_source.DIAGNOSE_EVERY_S", 0.2)
    write_plain(tmp_path / "short.mcap", 8)
    endpoint, out = f"tcp/127.0.0.1:{free_port()}", tmp_path / "rec.mcap"
    source = ("--source", f"replay:{tmp_path / 'short.mcap'}")
    publisher = start("publish", *source, "--listen", endpoint, "--wait")
    words = ("--source", f"zenoh:{endpoint}", "--out", out, "--duration", 3.0, "--json")
    assert json.loads(output_of("record", *words))["frames"] == info(out).frames == 8
    publisher.communicate(timeout=240)


def test_a_file_with_a_hole_has_a_hole(tmp_path):
    """The count that decides is not blind."""
    messages = [depth(NOW + k * PERIOD, k)._replace(sequence=k) for k in (5, 6, 8, 8, 9)]
    counted = sequences(recorded(tmp_path / "rec.mcap", messages))
    assert counted.tolist() == [5, 6, 8, 8, 9]
    assert gaps_in(counted) == (1, 1)
