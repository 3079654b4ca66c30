"""Robots that announce, send or stop sending what they should not, by the commands alone."""

import json
import threading
import time
from contextlib import contextmanager

import numpy as np
import pytest
from robot import KEYS, TOKENS, open_session
from streams import messages_in
from wire import image, sent

from benchmarks.window.live_soak import free_port
from tests.colour.colour_bag import TRANSFORMS, add_pose
from tests.commands.limited import MEMORY, in_process
from tests.program import facts_of, run
from tests.recordings.bagmaker import PERIOD, START, BagMaker, depth_image

BEFORE, GAP_S, OUTAGE_S = 4, 1.5, 0.7
"""Frames before and after each gap, its length, and the time that is waited: less than half."""


@contextmanager
def camera_beside_a_token_without_a_topic(after):
    """A camera at 50 Hz; a node announces images on `/` after so many were listened to.

    Its source, and the time of the announcement.
    """
    port, stop, announced_ns = free_port(), threading.Event(), []
    token = "@ros2_lv/0/b3f7/0/9/MP/%/%/n/%/sensor_msgs::msg::dds_::Image_/RIHS01_00/:"

    def publish():
        publisher, heard = session.declare_publisher(KEYS["rmw"]["/cam/depth"]), 0
        while not stop.wait(0.02):
            if heard >= after and not announced_ns:
                held.append(session.liveliness().declare_token(token))
                announced_ns.append(time.time_ns())
            publisher.put(image(time.time_ns()))
            heard += publisher.matching_status.matching

    with open_session(str(port)) as session:
        held = [session.liveliness().declare_token(key) for key in TOKENS["rmw"]]
        thread = threading.Thread(target=publish)
        thread.start()
        try:
            yield f"zenoh:tcp/127.0.0.1:{port}", announced_ns
        finally:
            stop.set()
            thread.join()


@pytest.mark.parametrize(("command", "after"), [("record", 0), ("watch", 0), ("watch", 10)])
def test_a_token_without_a_topic_ends_nothing(small_sensor_file, tmp_path, command, after):
    out = tmp_path / "rec.mcap"
    with camera_beside_a_token_without_a_topic(after) as (source, announced_ns):
        words = ("--source", source, "--sensor", small_sensor_file, "--out", out)
        told = facts_of(command, *words, "--duration", 1)
    assert told["frames"] > 0
    *_, (_, _, last) = messages_in(out, "/cam/depth")
    assert last.log_time > announced_ns[0] + 2e8


def test_ever_new_static_poses_are_not_all_kept(tmp_path):
    """200 MB of them, each with a frame of reference of 1 MB."""
    bag = BagMaker("mcap plain")
    payload = sent(add_pose, "camera", "link 0000" + "x" * 10**6, (0.0, 0.0, 0.0))
    for k in range(10):
        bag.image(START + k * PERIOD, depth_image(k))
    for k in range(200):
        other = payload.replace(b"link 0000", b"link %04d" % k)
        bag.rows.append(("/tf_static", TRANSFORMS, START + k * PERIOD // 40, other))
    source = f"replay:{bag.write(tmp_path)}"
    done, peak = in_process(tmp_path, "record", "--source", source, "--out", tmp_path / "out.mcap")
    assert done.returncode == 0, done.stderr
    assert peak < MEMORY, f"{peak >> 20} MiB"


@pytest.mark.parametrize(("host", "warned"), [("127.0.0.1", 0), ("0.0.0.0", 1)])
def test_warning_for_an_endpoint_open_to_other_computers(small_sensor_file, host, warned):
    done = run(
        *("publish", "--source", "synthetic:?frames=4", "--sensor", small_sensor_file),
        *("--duration", "0.1", "--listen", f"tcp/{host}:{free_port()}"),
    )
    assert done.exit_code == 0, done.stderr
    assert done.stderr.count("\n") == warned
    remedy = "anyone on the network can connect; give --login to prevent that"
    assert done.stderr.count(remedy) == warned
    assert done.stderr.count("NOT ENCRYPTED") == warned


def test_watch_reports_an_outage_once_and_continues(small_sensor_file, tmp_path, monkeypatch):
    """The camera falls silent twice and comes back."""
    monkeypatch.setattr("bubbleviz.api.watching.STOPPED_AFTER_S", OUTAGE_S)
    bag = BagMaker("mcap file")
    for k in range(3 * BEFORE):
        stamp = START + round(1e9 * (0.1 * k + GAP_S * (k // BEFORE)))
        bag.image(stamp, np.zeros((48, 64), np.float32))
    source = f"replay:{bag.write(tmp_path)}"
    done = run("watch", "--source", source, "--sensor", small_sensor_file, "--json")
    assert done.exit_code == 0, done.output
    assert sum("no depth image for" in line for line in done.stderr.splitlines()) == 2
    assert json.loads(done.stdout)["frames"] > 2 * BEFORE
