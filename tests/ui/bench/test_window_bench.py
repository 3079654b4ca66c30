"""Short runs of `python -m benchmarks.window`, without limits on times."""

import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from click.testing import CliRunner
from small_press import HEIGHTS, write_press
from window_driver import run_python

from benchmarks.window.__main__ import bench as main
from benchmarks.window.process_usage import thread_seconds
from bubbleviz.recordings import recording_writer
from bubbleviz.sensor import load_sensor, sensor_to_toml
from tests.small_press import changed

REPOSITORY = Path(__file__).parents[3]
SHORT_S, FULL_S = 1.5, 6.0
ENOUGH_S = 0.05
MONKEY = """
import json
from fakes import small_sensor
from benchmarks.window.monkey import monkey_run
report = monkey_run(small_sensor(), None, {seconds}, seed={seed}, memory=False)
print(json.dumps([report.actions, report.problems]))
"""


def monkey(seconds, seed, before=""):
    done = run_python(before + MONKEY.format(seconds=seconds, seed=seed))
    assert done.returncode == 0, done.stderr
    actions, problems = json.loads(done.stdout.splitlines()[-1])
    return actions, problems


def test_random_clicks_and_keys_raise_no_exception():
    """Short version of `python -m benchmarks.window monkey`."""
    actions, problems = monkey(FULL_S if "TEST_ALL" in os.environ else SHORT_S, seed=7)
    assert not problems, problems[0]
    assert actions > 0


@pytest.mark.long
def test_monkey_finds_an_exception_in_a_slot():
    broken = (
        "from bubbleviz_ui.model.session_state import SessionState\n"
        "SessionState.step = lambda *_: 1 / 0\n"  # a slot of actions and keys
    )
    _, problems = monkey(2.0 * FULL_S, seed=1, before=broken)
    assert any("ZeroDivisionError" in problem for problem in problems)


def test_computing_threads_are_reported_by_name():
    done, go_on = threading.Event(), threading.Event()

    def compute():
        while time.thread_time() < ENOUGH_S:  # time of this thread only
            pass
        done.set()
        go_on.wait()

    threads = [threading.Thread(target=compute, name="busy")]
    threads.append(threading.Thread(target=go_on.wait, name="idle"))
    for thread in threads:
        thread.start()
    assert done.wait(60.0)
    used = thread_seconds()
    go_on.set()
    for thread in threads:
        thread.join()
    assert used["busy"] > 0.5 * ENOUGH_S > used["idle"]


@pytest.fixture(scope="module")
def press(tmp_path_factory):
    """A recording of many pixels on a coarse mesh, and its sensor's file."""
    folder = tmp_path_factory.mktemp("press")
    preset, sensor = load_sensor("pico_flexx_75mm"), folder / "coarse.toml"
    sensor.write_text(sensor_to_toml(changed(preset, membrane={"nodes": 200})))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recording_writer, "CHUNK_BYTES", 1 << 16)  # one frame each
        return write_press(folder / "press.mcap", sensor, 4 * HEIGHTS), sensor


def bench(*arguments):
    command = [sys.executable, "-m", "benchmarks.window", *map(str, arguments), "--json"]
    return subprocess.run(
        command, capture_output=True, text=True, check=False, timeout=600, cwd=REPOSITORY
    )


@pytest.mark.long
def test_start_benchmark_waits_for_each_first_picture(press):
    recording, sensor = press
    done = bench("start", recording, "--sensor", sensor, "--runs", "1")
    assert done.returncode == 0, done.stderr
    measured = json.loads(done.stdout)
    assert measured["runs"] == 1
    assert 0.0 < measured["fastest_s"] <= measured["longest_s"]
    assert measured["cpu_s"] > 0.5


def test_seek_benchmark_waits_for_each_picture(qtbot, press):
    recording, sensor = press
    words = ["seek", recording, "--sensor", sensor, "--seeks", 2, "--json"]
    done = CliRunner().invoke(main, list(map(str, words)), catch_exceptions=False)
    assert done.exit_code == 0, done.output
    measured = json.loads(done.stdout)
    assert (measured["frames"], measured["seeks"]) == (20, 2)
    assert 1.0 < measured["median_ms"] <= measured["longest_ms"]


@pytest.mark.parametrize("what", ["start", "seek"])
def test_benchmark_reports_an_unopenable_file_in_one_line(what, tmp_path):
    done = CliRunner().invoke(main, [what, str(tmp_path / "missing.mcap")])
    assert done.exit_code == 2
    [line] = done.stderr.splitlines()
    assert "missing.mcap" in line
