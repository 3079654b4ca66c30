"""Sources that cannot be reached, end, break and come back, in the real window."""

import os

from live_bench import IMAGE, connected, contents, record_dents, sensor_file

from benchmarks.window.live_soak import free_port
from bubbleviz.live import STALE_AFTER_S
from bubbleviz_ui.engine.sensor_client import RequestDelay
from bubbleviz_ui.live.connection import single
from bubbleviz_ui.live.live_controller import UPDATE_MS
from tests.live.streams import robot

SHORT, FULL = 1, 3
"""How often a robot is killed."""


def test_what_cannot_be_connected_or_ends_is_a_sentence_and_the_rest_goes_on(open_bench, tmp_path):
    live, port = connected(open_bench), free_port()
    name, control = sensor_file(live.folder), live.live_controller
    for source, words in (
        ("replay:missing.mcap", "missing.mcap"),
        ("zenoh:nonsense", "nonsense"),
        ("realsense:", "realsense"),
    ):
        live.window.message.hide()
        control.connect_to(single(source, name))
        live.told(words)
        assert control.connection is None and control.run is not None
    live.follow(3)
    live.window.live.leave.click()
    # a robot that is not there is waited for until one cancels
    control.connect_to(single(f"zenoh:tcp/127.0.0.1:{port}", name))
    live.wait(lambda: f"nothing listens at 127.0.0.1:{port}" in live.window.live.state.text())
    live.window.live.leave.click()
    assert control.connection is None
    # after the end of a source one goes on with what there is
    path = record_dents(tmp_path / "rec.mcap", presses=1)
    slowly = f"replay:{path}?speed=0.2"  # slow machines leave some out, not the last
    control.connect_to(single(slowly, name))
    live.wait(lambda: "ended" in live.window.live.state.text())
    live.state.seek(1)
    live.wait(lambda: live.shown == 1)
    layers = live.state.settings.layers | {"wireframe", "cloud"}
    live.state.change(layers=layers)
    live.wait(lambda: live.window.controller.result.cloud_m is not None)
    live.window.live.leave.click()
    assert control.run is None
    live.state.seek(0)
    live.wait(lambda: live.shown == 0)


def test_a_killed_robot_is_noticed_and_reconnects(open_bench):
    """Once or three times; `python -m benchmarks.window restarts` does it twenty times."""
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
        with robot(port, 10_000 * turn):
            bench.follow(3)
            bench.wait(lambda: "live" in bench.window.live.state.text())
            assert len(bench.state.facts.gaps) >= turn
    path = bench.stop()
    assert set(arrived) <= {message.log_time for message in contents(path)[IMAGE]}
    assert STALE_AFTER_S + UPDATE_MS / 1000.0 < 1.0


def test_the_solver_is_held_back_by_what_its_results_waited():
    """As in a window that takes 50 ms for a picture while the solver takes 15."""
    delay = RequestDelay()
    for _ in range(40):
        delay.update(max(0.050 - 0.015 - delay.delay_s, 0.0))
    assert 0.028 < delay.delay_s < 0.035  # the result is there just before the window is
    for _ in range(40):
        delay.update(0.0)
    assert delay.delay_s == 0.0


def test_garbage_is_counted_shown_and_survived(open_bench):
    bench = open_bench()
    port = free_port()
    with robot(port, 0, "bad"):
        bench.connect(single(f"zenoh:tcp/127.0.0.1:{port}", sensor_file(bench.folder)))
        stream = bench.run.frames[0].stream
        bench.wait(lambda: min(stream.counters.wrong_size, stream.counters.bad_stamps) > 0)
        bench.wait(lambda: stream.counters.undecodable > 2)
        bench.window.live.update_status()
        text = bench.window.live.counts.toolTip()
        for words in ("undecodable", "of wrong size", "with bad stamps", "/cam/depth: "):
            assert words in text
        bench.follow(5)
