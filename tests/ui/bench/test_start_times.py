"""`python -m benchmarks.window start` and `seek` measure a real window, and judge no times."""

from __future__ import annotations

import json
import subprocess
import sys
from io import BytesIO
from pathlib import Path

import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from small_press import HEIGHTS, write_press

from benchmarks.window.__main__ import bench as main
from bubbleviz.frames import recording_writer
from bubbleviz.sensor import load_sensor, sensor_to_toml

REPOSITORY = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def press(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A recording of many pixels on a coarse mesh, and its sensor's file."""
    folder = tmp_path_factory.mktemp("press")
    preset, sensor = load_sensor("pico_flexx_75mm"), folder / "coarse.toml"
    coarse = preset.membrane.model_copy(update={"nodes": 200})
    sensor.write_text(sensor_to_toml(preset.model_copy(update={"membrane": coarse})))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recording_writer, "CHUNK_BYTES", 1 << 16)  # a frame each, as of real cameras
        return write_press(folder / "press.mcap", sensor, 4 * HEIGHTS), sensor


def bench(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "benchmarks.window", *map(str, arguments), "--json"]
    return subprocess.run(
        command, capture_output=True, text=True, check=False, timeout=600, cwd=REPOSITORY
    )


@pytest.mark.long
def test_start_waits_for_the_picture_of_each_process(press: tuple[Path, Path]) -> None:
    recording, sensor = press
    done = bench("start", recording, "--sensor", sensor, "--runs", "1")
    assert done.returncode == 0, done.stderr
    measured = json.loads(done.stdout)
    assert measured["runs"] == 1
    assert 0.0 < measured["fastest_s"] <= measured["longest_s"]
    assert measured["cpu_s"] > 0.5


def test_seek_waits_for_the_picture_of_each_frame(press: tuple[Path, Path]) -> None:
    recording, sensor = press
    done = bench("seek", recording, "--sensor", sensor, "--seeks", "2")
    assert done.returncode == 0, done.stderr
    measured = json.loads(done.stdout)
    assert (measured["frames"], measured["seeks"]) == (20, 2)
    assert 1.0 < measured["median_ms"] <= measured["longest_ms"]


@pytest.mark.parametrize("what", ["start", "seek"])
def test_what_cannot_be_opened_is_said_in_one_line(what: str, tmp_path: Path) -> None:
    done = CliRunner().invoke(main, [what, str(tmp_path / "missing.mcap")])
    assert done.exit_code == 2
    [line] = done.stderr.splitlines()
    assert "missing.mcap" in line


@pytest.mark.long
def test_a_frame_that_cannot_be_read_ends_the_seeks(
    press: tuple[Path, Path], tmp_path: Path
) -> None:
    recording, sensor = press
    spoilt = tmp_path / "spoilt.mcap"
    data = bytearray(recording.read_bytes())
    summary = make_reader(BytesIO(data)).get_summary()
    assert summary is not None
    chunk = summary.chunk_indexes[12]  # of frame 12, one of the first
    end = chunk.chunk_start_offset + chunk.chunk_length
    data[end - 2_000 : end] = bytes(2_000)
    spoilt.write_bytes(data)
    done = bench("seek", spoilt, "--sensor", sensor, "--seeks", "12")
    assert done.returncode == 2
    [line] = done.stderr.splitlines()
    assert "spoilt.mcap: message 12" in line
