"""Real Zenoh sessions on loopback, with a robot in its own process."""

import os
import signal
import time

import psutil
import pytest
from robot import KEYS, TOKENS, attachment, open_session
from streams import robot
from wire import HEIGHT, IMAGE, WIDTH, compressed_depth, image, number_shown

from benchmarks.window.live_soak import free_port
from bubbleviz.errors import InputError
from bubbleviz.live import (
    Credentials,
    Recorder,
    SessionOptions,
    ZenohPublisher,
    open_stream,
    zenoh_session,
    zenoh_session as zenoh_keys,
)
from bubbleviz.recordings import Message

SHORT, FULL = 2, 20
"""How often the robot is killed: in `make test`, and in `make test-all`."""


def stream_of(port, sensor, options=""):
    return open_stream(f"zenoh:tcp/127.0.0.1:{port}{options}", sensor)


def first_frame(stream, send):
    """Send until a frame has arrived."""
    frame = None
    while frame is None:
        send()
        frame = stream.take(0.05)
    return frame


@pytest.mark.parametrize("layout", ["rmw", "dds"])
def test_topics_are_discovered_and_frames_assembled(layout, small_sensor):
    port = free_port()
    with robot(port, layout=layout), stream_of(port, small_sensor) as stream:
        found = [stream.take(30.0) for _ in range(10)]
        assert all(frame is not None for frame in found)
        last = found[-1]
        assert last.depth_m.shape == (HEIGHT, WIDTH)
        assert last.intrinsics is not None
        assert last.gas_pressure_pa == pytest.approx(1e5 + number_shown(last))
        assert [tuple(topic) for topic in stream.source.topics] == [
            ("/cam/camera_info", "sensor_msgs/msg/CameraInfo"),
            ("/cam/depth", IMAGE),
            ("/gas", "sensor_msgs/msg/FluidPressure"),
        ]
        assert stream.status().state == "live"
        counters = stream.counters
        assert (counters.undecodable, counters.bad_stamps, counters.missed) == (0, 0, 0)


def test_hostile_announcements_and_types_do_not_stop_the_source(small_sensor, tmp_path):
    """Names that Zenoh refuses or takes for patterns, and a type that no file can describe."""
    port, recorder = free_port(), Recorder()
    image_type, topic = "sensor_msgs::msg::dds_::Image_", KEYS["rmw"]["/cam/depth"]
    names = ("%", "%%", "%*", "%**", "%a$*", "%a%%b", "%" + 60 * "a%", "%cam%depth")
    tokens = [f"@ros2_lv/0/b3f7/0/{k}/MP/%/%/n/{name}/{image_type}/RIHS01_00/:" for k, name in
              enumerate(names) if "*" not in name]  # fmt: skip
    tokens += ["@/b3f7/@ros2_lv/MP/§/sensor_msgs§msg§Image/:::"]
    assert all(zenoh_keys.parse_token(token, 0) is None for token in (*tokens[:-2], tokens[-1]))
    recorder.start(tmp_path / "rec.mcap")
    with open_session(str(port)) as camera:
        held = [camera.liveliness().declare_token(key) for key in tokens]
        with stream_of(port, small_sensor) as stream:
            recorder.listen_to(stream)
            frames, sent = 0, 0
            while frames < 3:
                extra = {"attachment": attachment(sent)}
                camera.put(topic.replace("Image_", "Bomb_"), b"\0\1\0\0", **extra)
                camera.put(topic, image(time.time_ns()), **extra)
                frames, sent = frames + (stream.take(0.05) is not None), sent + 1
            assert stream.status().state == "live"
        assert len(held) == len(tokens)
    status = recorder.stop()
    assert status.problem == "" and status.messages >= 3


@pytest.mark.parametrize("raw_too", [False, True])
def test_compressed_depth_is_used_without_raw_depth(small_sensor, raw_too):
    """Else the robot would have to compress every image for nobody."""
    port, topics = free_port(), set[str]()
    squeezed, raw = "cam/depth/image/compressedDepth", "cam/depth/image"
    token = "@/b3f7/@ros2_lv/MP/{}/sensor_msgs§msg§{}/:::"
    announced = [token.format(squeezed.replace("/", "§"), "CompressedImage")]
    if raw_too:
        announced.append(token.format(raw.replace("/", "§"), "Image"))
    with open_session(str(port)) as camera:
        held = [camera.liveliness().declare_token(key) for key in announced]
        with stream_of(port, small_sensor) as stream:
            stream.listen(lambda message: topics.add(message.topic))
            frames = 0
            while frames < 3:
                camera.put(squeezed, compressed_depth(time.time_ns()))
                if raw_too:
                    camera.put(raw, image(time.time_ns()))
                frame = stream.take(0.05)
                frames += frame is not None
                assert frame is None or frame.depth_m.shape == (HEIGHT, WIDTH)
        assert len(held) == len(announced)
    assert topics == {f"/{raw if raw_too else squeezed}"}


def test_hanging_robot_is_stale_and_recovers(small_sensor, eventually):
    port = free_port()
    with robot(port) as process, stream_of(port, small_sensor) as stream:
        assert stream.take(30.0) is not None
        os.kill(process.pid, signal.SIGSTOP)
        eventually(lambda: stream.status().state == "stale")
        assert "no image for" in stream.status().text
        os.kill(process.pid, signal.SIGCONT)
        stream.take()
        assert stream.take(30.0) is not None
        assert stream.status().state == "live"


def test_another_type_under_the_same_name_is_counted(small_sensor, eventually):
    """Other invalid messages of a robot: ui/live/test_live_links.py."""
    port = free_port()
    depth = KEYS["rmw"]["/cam/depth"]
    other = f"0/cam/depth/std_msgs::msg::dds_::String_/{'RIHS01_' + '0' * 64}"
    with (
        open_session(str(port)) as node,
        stream_of(port, small_sensor, "?depth=/cam/depth") as stream,
    ):
        eventually(lambda: (node.put(depth, image(time.time_ns())), stream.take(0.05))[1])
        assert stream.counters.wrong_type == 0
        node.put(other, b"\0\1\0\0\4\0\0\0abc\0")
        eventually(lambda: stream.counters.wrong_type == 1)


def test_connection_through_an_rmw_zenoh_router(small_sensor, eventually):
    """Nodes are peers that discover each other by the router, whose client we are."""
    port = free_port()
    with open_session(str(port), "router"), open_session(str(port), "node") as node:
        tokens = [node.liveliness().declare_token(key) for key in TOKENS["rmw"]]
        with stream_of(port, small_sensor) as stream:
            key = KEYS["rmw"]["/cam/depth"]
            first_frame(stream, lambda: node.put(key, image(time.time_ns())))
            assert ("/cam/depth", IMAGE) in stream.source.topics
            # and back: results of ours reach the node
            got: list[bytes] = []
            subscriber = node.declare_subscriber(
                "0/bubbleviz/**", lambda sample: got.append(sample.payload.to_bytes())
            )
            endpoint = f"tcp/127.0.0.1:{port}"
            with ZenohPublisher(SessionOptions("us", connect=endpoint)) as out:
                eventually(lambda: (out.put(Message("/bubbleviz/depth", IMAGE, b"result")), got)[1])
            assert got[0] == b"result"
            subscriber.undeclare()
        for token in tokens:
            token.undeclare()


def test_messages_lost_by_sequence_number_are_counted(small_sensor, eventually):
    port = free_port()
    key = KEYS["rmw"]["/cam/depth"]
    with open_session(str(port)) as node, stream_of(port, small_sensor, "?depth=/cam/depth") as s:
        eventually(lambda: (node.put(key, b"", attachment=attachment(1)), s.counters.received)[1])
        for sequence in (2, 3, 6, 7, 7, 10):
            node.put(key, image(time.time_ns()), attachment=attachment(sequence))
        eventually(lambda: s.counters.frames == 6)
        assert s.counters.missed == 4


def test_two_sensors_are_independent(small_sensor):
    ports = free_port(), free_port()
    with (
        robot(ports[0]),
        robot(ports[1], 30_000),
        stream_of(ports[0], small_sensor) as left,
        stream_of(ports[1], small_sensor) as right,
    ):
        depths = []
        for stream in (left, right):
            frame = stream.take(30.0)
            depths.append(float(frame.depth_m[0, 0]))
        assert depths[0] < 20.0 < depths[1]


def test_default_endpoint_is_local_only(small_sensor, eventually):
    """A client opens no port; a listener only the given one."""
    port, other = free_port(), free_port()
    with robot(port), stream_of(port, small_sensor) as stream:
        eventually(lambda: stream.status().state == "live")
        assert listening() == set()
    with open_stream(f"zenoh:?listen=tcp/127.0.0.1:{other}", small_sensor):
        assert listening() == {("127.0.0.1", other)}


def listening():
    """Addresses this process listens at."""
    found = psutil.Process().net_connections("tcp")
    return {tuple(each.laddr) for each in found if each.status == psutil.CONN_LISTEN}


def test_endpoints_are_refused_in_one_line(small_sensor):
    for place in ("tcp/192.168.1.7", "?listen=tls/[::1]", "tcp/:7447", "tcp/::1:7447"):
        with pytest.raises(InputError, match="is no host with a port; give it as tcp"):
            open_stream(f"zenoh:{place}", small_sensor).start()


@pytest.mark.parametrize("option", ["depth=/cam/*", "colour=/cam//rgb", "pressure=a%20b"])
def test_invalid_topic_name_is_refused_in_one_line(small_sensor, option):
    with pytest.raises(InputError, match="is not a topic name; give one such as") as caught:
        open_stream(f"zenoh:?listen=tcp/127.0.0.1:{free_port()}&{option}", small_sensor).start()
    assert "\n" not in str(caught.value)


@pytest.fixture
def refusal(small_sensor, eventually):
    """Message of a refused source: `refusal(endpoint, ca=…, login=…)`."""

    def ask(endpoint, **given):
        options = "&".join(f"{name}={value}" for name, value in given.items())
        with open_stream(f"zenoh:{endpoint}?{options}", small_sensor) as stream:
            eventually(lambda: stream.source.problem)
            assert stream.status().state == "connecting"
            text = stream.status().text
            assert text.endswith(f" ({stream.name})") and endpoint in stream.name
            return text.removeprefix("refused: ").removesuffix(f" ({stream.name})")

    return ask


def test_refused_and_unreachable_endpoints_are_distinguished(
    small_sensor, tls, eventually, refusal, monkeypatch
):
    """Zenoh itself reports both as failed connections."""
    monkeypatch.setattr("bubbleviz.live.zenoh_session.TIMEOUT_S", 0.5)
    port = free_port()
    at = f"tls/localhost:{port}"
    with open_stream(f"zenoh:{at}?ca={tls.ca}&login={tls.login}", small_sensor) as waits:
        eventually(lambda: waits.source.problem)
        assert waits.status().text.startswith(f"nothing listens at localhost:{port};")
        with listener(at, Credentials(cert=tls.cert, key=tls.key, login=tls.login)):
            eventually(lambda: waits.source.link == "up")
            assert waits.source.problem == ""
            signed = "the certificate of localhost is not signed by"
            give = "give the certificate of its authority as ca="
            assert refusal(at) == f"{signed} an authority that this computer trusts; {give}"
            assert refusal(at, ca=tls.other) == f"{signed} ca={tls.other}; {give}"
            assert "not valid for '127.0.0.1'" in refusal(f"tls/127.0.0.1:{port}", ca=tls.ca)
            assert "in PEM form" in refusal(at, ca=tls.login)
            no_session = f"localhost:{port} answers but opens no Zenoh session; check the port"
            assert (
                refusal(at, ca=tls.ca)
                == f"{no_session}; if it requires user and password, give login="
            )
            check = f"{no_session}, and user and password in login={tls.stranger}"
            assert refusal(at, ca=tls.ca, login=tls.stranger) == check
            assert refusal(f"tcp/localhost:{port}").endswith("if it requires encryption, use tls/")


def test_an_unknown_host_is_reported(refusal):
    """RFC 6761 reserves .invalid."""
    assert refusal("tcp/robot.invalid:7447").startswith(
        "the host name robot.invalid cannot be resolved"
    )


def test_a_missing_or_wrong_certificate_is_reported(tls, refusal):
    at = f"tls/localhost:{free_port()}"
    with listener(at, Credentials(ca=tls.ca, cert=tls.cert, key=tls.key)):  # it wants ours, too
        missing = "if it asks for a certificate of this computer, give cert= and key="
        assert refusal(at, ca=tls.ca).endswith(missing)
        assert f"not accept cert={tls.other}," in refusal(
            at, ca=tls.ca, cert=tls.other, key=tls.other_key
        )
    with listener(at, Credentials(cert=tls.other, key=tls.other_key)):
        assert "is the authority's own" in refusal(at, ca=tls.other)


def test_a_refused_reconnection_is_reported(small_sensor, tls, eventually, monkeypatch):
    """The robot restarts with another certificate; then its port is closed."""
    monkeypatch.setattr("bubbleviz.live.zenoh_source.DIAGNOSE_EVERY_S", 0.2)
    at = f"tls/localhost:{free_port()}"
    with open_stream(f"zenoh:{at}?ca={tls.ca}&depth=/quiet", small_sensor) as stream:
        with listener(at, Credentials(cert=tls.cert, key=tls.key)) as robot:
            first_frame(stream, lambda: robot.put("quiet", image(time.time_ns())))
        with listener(at, Credentials(cert=tls.other, key=tls.other_key)):
            eventually(lambda: "is not signed by" in stream.status().text)
            assert stream.status().state == "reconnecting"
            assert stream.status().text.endswith(f"of its authority as ca= ({stream.name})")
        eventually(lambda: "nothing listens at localhost" in stream.status().text)
        with listener(at, Credentials(cert=tls.cert, key=tls.key)) as robot:
            first_frame(stream, lambda: robot.put("quiet", image(time.time_ns())))
            eventually(lambda: stream.source.problem == "")


def test_a_reconnected_camera_of_another_size_is_reported(small_sensor, eventually):
    port = free_port()
    with open_session(str(port)) as camera, stream_of(port, small_sensor, "?depth=/q") as stream:
        first_frame(stream, lambda: camera.put("q", image(time.time_ns())))
        other = {"height": 24, "width": 32, "step": 64}

        def refused():
            camera.put("q", image(time.time_ns(), **other))
            return "images are 32×24 pixels" in stream.status().text

        eventually(refused)
        assert stream.status().state == "stale"
        assert stream.status().text.endswith(
            f"has {WIDTH}×{HEIGHT}; choose the sensor file of this camera ({stream.name})"
        )
        first_frame(stream, lambda: camera.put("q", image(time.time_ns())))
        eventually(lambda: stream.status().problem == "")


def listener(endpoint, credentials):
    return zenoh_session.open_session(SessionOptions("robot", None, endpoint, credentials))


def test_attachments_of_robots():
    found = zenoh_keys.unpack_attachment(attachment(77))
    assert (found.sequence, found.publisher) == (77, bytes(range(16)))
    assert zenoh_keys.pack_attachment(found._replace(stamp_ns=1))[16:] == attachment(77)[16:]
    for junk in (None, b"", b"x" * 33, b"x" * 77, b"x" * 5):
        assert zenoh_keys.unpack_attachment(junk) is None
