"""Connections that fail, end, break and recover."""

import os

from live_bench import IMAGE, connected_bench, messages_by_type, record_dents, sensor_file
from window_driver import text_actors

from benchmarks.window.live_soak import free_port
from bubbleviz.live import STALE_AFTER_S
from bubbleviz_ui.engine.sensor_client import RequestDelay
from bubbleviz_ui.live.connection import single
from bubbleviz_ui.live.live_controller import UPDATE_MS
from tests.live.streams import robot

SHORT, FULL = 1, 3
"""Number of times the robot is killed."""


def test_failed_and_ended_connections_give_messages(open_bench, tmp_path):
    live, port = connected_bench(open_bench), free_port()
    name, control = sensor_file(live.folder), live.live_controller
    for source, words in (
        ("replay:missing.mcap", "missing.mcap"),
        ("zenoh:nonsense", "nonsense"),
        ("realsense:", "realsense"),
    ):
        live.window.message.hide()
        control.connect_to(single(source, name))
        live.wait_for_message(words)
        assert control.connection is None and control.run is not None
    live.wait_for_frames(3)
    live.window.live.leave.click()
    # an absent robot is awaited until cancelled
    control.connect_to(single(f"zenoh:tcp/127.0.0.1:{port}", name))
    live.wait(lambda: f"nothing listens at 127.0.0.1:{port}" in live.window.live.state.text())
    live.window.live.leave.click()
    assert control.connection is None
    # after the end of a source the frames in memory stay
    path = record_dents(tmp_path / "rec.mcap", presses=1)
    slowly = f"replay:{path}?speed=0.2"  # slow machines skip some frames, not the last
    control.connect_to(single(slowly, name))
    live.wait(lambda: "ended" in live.window.live.state.text())
    live.wait(lambda: live.state.facts.frames > 1)  # a slow machine solves the last one after that
    live.state.seek(1)
    live.wait(lambda: live.shown_frame == 1)
    layers = live.state.settings.layers | {"wireframe", "cloud"}
    live.state.change(layers=layers)
    live.wait(lambda: live.window.controller.result.cloud_m is not None)
    live.window.live.leave.click()
    assert control.run is None
    live.state.seek(0)
    live.wait(lambda: live.shown_frame == 0)


def readout_opacity(bench):
    return text_actors(bench)[0].GetTextProperty().GetOpacity()


def numbers(bench):
    """Labels outside the view with the force of the frame shown."""
    window = bench.window
    return window.status.labels["force"], window.kappa.force, window.kappa.area


def test_killed_robot_is_detected_and_reconnects_and_invalid_messages_are_counted(open_bench):
    bench = open_bench()
    port, name = free_port(), sensor_file(bench.folder)
    with robot(port):
        bench.connect(single(f"zenoh:tcp/127.0.0.1:{port}", name))
        bench.record()
        arrived: list[int] = []
        kind = lambda message: message.type == IMAGE  # noqa: E731
        bench.run.frames[0].stream.listen(
            lambda message: arrived.append(message.arrival_ns) if kind(message) else None
        )
        bench.wait(lambda: len(arrived) > 20)
    for turn in range(1, 1 + (FULL if "TEST_ALL" in os.environ else SHORT)):
        bench.wait(lambda: "live" not in bench.window.live.state.text())
        assert any(word in bench.window.live.state.text() for word in ("stale", "reconnecting"))
        assert readout_opacity(bench) < 1.0 and not any(n.isEnabled() for n in numbers(bench))
        with robot(port, 10_000 * turn):
            bench.wait_for_frames(3)
            bench.wait(lambda: "live" in bench.window.live.state.text())
            assert len(bench.state.facts.gaps) >= turn
            assert readout_opacity(bench) == 1.0 and all(n.isEnabled() for n in numbers(bench))
    path = bench.stop()
    assert set(arrived) <= {message.log_time for message in messages_by_type(path)[IMAGE]}
    assert STALE_AFTER_S + UPDATE_MS / 1000.0 < 1.0
    # invalid messages are counted and shown
    bench.window.live.leave.click()
    port = free_port()
    with robot(port, 0, "bad"):
        bench.connect(single(f"zenoh:tcp/127.0.0.1:{port}", sensor_file(bench.folder)))
        stream = bench.run.frames[0].stream
        bench.wait(lambda: min(stream.counters.wrong_size, stream.counters.bad_stamps) > 0)
        bench.wait(lambda: stream.counters.undecodable > 2)
        bench.window.live.update_status()
        text = bench.window.live.counts.toolTip()
        assert text.index("of wrong size") < text.index("gas zero")  # the end may be elided
        for words in ("undecodable", "of wrong size", "with bad stamps", "/cam/depth: "):
            assert words in text
        bench.wait_for_frames(5)


def test_request_delay_adapts_to_the_waiting_time_of_results():
    """With 50 ms per picture and 15 ms per solve."""
    delay = RequestDelay()
    for _ in range(40):
        delay.update(max(0.050 - 0.015 - delay.delay_s, 0.0))
    assert 0.028 < delay.delay_s < 0.035  # the result arrives just before the window is ready
    for _ in range(40):
        delay.update(0.0)
    assert delay.delay_s == 0.0


def test_results_that_wait_only_now_and_then_do_not_delay_requests():
    """As beside a second camera, whose pictures take 30 ms."""
    delay = RequestDelay()
    for k in range(200):
        delay.update(0.030 if k % 3 else 0.001)
        assert delay.delay_s < 0.050  # while it knows no others
    assert delay.delay_s == 0.0
