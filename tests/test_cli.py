"""The command line: help without heavy imports, errors on one line."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner

from bubbleviz.cli import OneLineErrors, main
from bubbleviz.errors import InputError, SolveError
from bubbleviz.frames.frame import Frame
from bubbleviz.frames.writer import RecordingWriter

HEAVY = (
    "numpy",
    "scipy",
    "pydantic",
    "osqp",
    "open3d",
    "pyvista",
    "vtkmodules",
    "PySide6",
    "rosbags",
)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "rec.mcap"
    with RecordingWriter(path) as writer:
        for k in range(3):
            writer.write(Frame(k, k / 30.0, np.full((3, 4), 0.1, dtype=np.float32)))
    return path


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys; from bubbleviz.cli import main; main(['--help'], standalone_mode=False); "
        f"print('LOADED', [m for m in {HEAVY!r} if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "Commands:" in done.stdout
    assert done.stdout.rstrip().endswith("LOADED []")


def test_every_command_has_help() -> None:
    for name in main.commands:
        done = CliRunner().invoke(main, [name, "--help"])
        assert done.exit_code == 0
        assert "Usage:" in done.stdout


def test_info(recording: Path) -> None:
    done = CliRunner().invoke(main, ["info", str(recording)])
    assert done.exit_code == 0
    assert "3 in 0.067 s, 30.00 Hz" in done.stdout
    done = CliRunner().invoke(main, ["info", str(recording), "--json"])
    assert json.loads(done.stdout)["frames"] == 3


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["info", "nope.mcap"], "nope.mcap: no such recording; check the path"),
        (["info"], "Missing argument 'REC'; see bubbleviz info --help"),
        (["info", "--nope", "x"], "--nope"),
        (["fly"], "No such command 'fly'; see bubbleviz --help"),
    ],
)
def test_wrong_usage_and_bad_input_are_one_line_and_exit_code_2(
    arguments: list[str], words: str
) -> None:
    done = CliRunner().invoke(main, arguments, prog_name="bubbleviz")
    assert done.exit_code == 2
    assert done.stdout == ""
    assert done.stderr.startswith("bubbleviz: ")
    assert words in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_truncated_recording_through_the_real_command(recording: Path) -> None:
    recording.write_bytes(recording.read_bytes()[:-40])
    command = [sys.executable, "-c", "from bubbleviz.cli import main; main()", "info"]
    done = subprocess.run([*command, str(recording)], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "truncated" in done.stderr


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (InputError("a: two\nlines"), 2, "bubbleviz: a: two lines\n"),
        (SolveError("no answer"), 1, "bubbleviz: no answer\n"),
        (KeyboardInterrupt(), 130, "bubbleviz: stopped\n"),
        (click.BadParameter("must be odd"), 2, "must be odd"),
    ],
)
def test_errors_of_commands(error: BaseException, code: int, line: str) -> None:
    @click.group(cls=OneLineErrors)
    def group() -> None:
        pass

    @group.command()
    def fail() -> None:
        raise error

    done = CliRunner().invoke(group, ["fail"])
    assert done.exit_code == code
    assert line in done.stderr
    assert "Traceback" not in done.output
