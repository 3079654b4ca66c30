"""Live window from the command line."""

from pathlib import Path

import pytest
from click.testing import CliRunner
from live_bench import sensor_file
from window_driver import run_bubbleviz

from bubbleviz.cli.command_line import main


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
    done = CliRunner().invoke(main, ["open", *arguments])  # refused before a window opens
    assert done.exit_code == 2 and done.stderr.count("\n") == 1, done.stderr


def test_invalid_source_gives_one_line_of_error(tmp_path):
    done = run_bubbleviz("open", "--source", "replay:missing.mcap", cwd=tmp_path)
    assert done.returncode == 2
    assert "missing.mcap" in done.stderr and done.stderr.count("\n") == 1, done.stderr


@pytest.mark.long
def test_live_window_without_a_display_writes_pictures(tmp_path):
    name = sensor_file(tmp_path)
    done = run_bubbleviz("open", "--source", "synthetic:?frames=5", "--sensor", name, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    written = [Path(line.removeprefix("wrote ")) for line in done.stdout.splitlines()[1:]]
    assert len(written) == 3 and all(path.stat().st_size > 10_000 for path in written)
