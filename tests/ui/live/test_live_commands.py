"""The live window from the command line, and its benchmarks in small."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from live_bench import sensor_file

from bubbleviz.cli.command_line import main

CODE = "from bubbleviz.cli.command_line import main; main()"
BRIEFLY = "import bubbleviz_ui.app as app; app.OFFSCREEN_SECONDS = 0.5; "


def run(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run bubbleviz in a process that has no display."""
    kept = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    return subprocess.run(
        [sys.executable, "-c", BRIEFLY + CODE, *arguments],
        env=kept, capture_output=True, text=True, timeout=600, check=False, cwd=cwd,
    )  # fmt: skip


def test_open_takes_one_of_recording_source_and_session() -> None:
    for arguments in (  # refused before there is a window
        ["open"],
        ["open", "rec.mcap", "--source", "synthetic:"],
        ["open", "--source", "synthetic:", "--frame", "0"],
        ["open", "--session", "dual_nut", "--sensor", "pico_flexx_75mm"],
    ):
        done = CliRunner().invoke(main, arguments)
        assert done.exit_code == 2 and done.stderr.count("\n") == 1, done.stderr


def test_a_source_that_cannot_be_is_one_line(tmp_path: Path) -> None:
    done = run("open", "--source", "replay:missing.mcap", cwd=tmp_path)
    assert done.returncode == 2
    assert "missing.mcap" in done.stderr and done.stderr.count("\n") == 1, done.stderr


@pytest.mark.long
def test_the_live_window_without_a_display_writes_pictures(tmp_path: Path) -> None:
    name = sensor_file(tmp_path)
    done = run("open", "--source", "synthetic:?frames=5", "--sensor", name, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    written = [Path(line.removeprefix("wrote ")) for line in done.stdout.splitlines()[1:]]
    assert len(written) == 3 and all(path.stat().st_size > 10_000 for path in written)


@pytest.mark.long
def test_the_soak_of_the_window_in_small(tmp_path: Path) -> None:
    name, out = sensor_file(tmp_path), tmp_path / "soak.mcap"
    done = run("bench", "live", "--window", "--minutes", "0.05", "--sensor", name,
               "--out", str(out), "--json", cwd=tmp_path)  # fmt: skip
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["recorded"] == report["sent"] > 60
    assert report["missing"] == report["repeated"] == 0
    assert report["pictures_hz"] > 0 and out.exists()
