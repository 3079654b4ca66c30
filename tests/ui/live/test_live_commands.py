"""Live window from the command line."""

from pathlib import Path

import pytest
from live_bench import sensor_file
from window_driver import run_bubbleviz

from tests.program import refusal


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["rec.mcap", "--source", "synthetic:"],
        ["--source", "synthetic:", "--frame", "0"],
        ["--session", "dual_nut", "--sensor", "pico_flexx_75mm"],
    ],
)
def test_open_accepts_only_one_of_recording_source_and_session(arguments):
    refusal("open", *arguments)  # before a window opens


def test_invalid_source_gives_one_line_of_error():
    assert "missing.mcap" in refusal("open", "--source", "replay:missing.mcap")


@pytest.mark.long
def test_live_window_without_a_display_writes_pictures(tmp_path):
    name = sensor_file(tmp_path)
    done = run_bubbleviz("open", "--source", "synthetic:?frames=5", "--sensor", name, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    written = [Path(line.removeprefix("wrote ")) for line in done.stdout.splitlines()[1:]]
    assert len(written) == 3 and all(path.stat().st_size > 10_000 for path in written)
