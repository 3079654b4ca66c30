"""`bubbleviz bench start` and `bench seek` measure a real window; the times are not judged."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = "import sys; from bubbleviz.cli.command_line import main; sys.exit(main(sys.argv[1:]))"


def bench(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", PROGRAM, "bench", *map(str, arguments), "--json"]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)


def test_start_waits_for_the_picture_of_each_process(punyo_press: Path) -> None:
    done = bench("start", punyo_press, "--runs", "1")
    assert done.returncode == 0, done.stderr
    measured = json.loads(done.stdout)
    assert measured["runs"] == 1
    assert 0.0 < measured["fastest_s"] <= measured["longest_s"]
    assert measured["cpu_s"] > 0.5


def test_seek_waits_for_the_picture_of_each_frame(punyo_press: Path) -> None:
    done = bench("seek", punyo_press, "--seeks", "5")
    assert done.returncode == 0, done.stderr
    measured = json.loads(done.stdout)
    assert (measured["frames"], measured["seeks"]) == (90, 5)
    assert 1.0 < measured["median_ms"] <= measured["longest_ms"]


@pytest.mark.parametrize("what", ["start", "seek"])
def test_what_cannot_be_opened_is_said_in_one_line(what: str, tmp_path: Path) -> None:
    done = bench(what, tmp_path / "missing.mcap")
    assert done.returncode == 2
    [line] = done.stderr.splitlines()
    assert "missing.mcap" in line


def test_a_frame_that_cannot_be_read_ends_the_seeks(punyo_press: Path, tmp_path: Path) -> None:
    spoilt = tmp_path / "spoilt.mcap"
    data = bytearray(next(punyo_press.glob("*.mcap")).read_bytes())
    place = 46 * len(data) // 88  # of frame 46, one of the first
    data[place : place + 2_000] = bytes(2_000)
    spoilt.write_bytes(data)
    done = bench("seek", spoilt, "--seeks", "12")
    assert done.returncode == 2
    [line] = done.stderr.splitlines()
    assert "spoilt.mcap: message 46" in line
