"""Stopped commands leave complete files or none; complete ones are on the disk."""

import os
import signal
import subprocess
import sys

import psutil
import pytest

import bubbleviz as bv
from tests.program import COMMAND, output_of
from tests.recordings.bagmaker import PERIOD, START, BagMaker

WRITING = {
    "simulate": "simulate --sensor SENSOR --object sphere --pose POSE --frames 100000 "
    "--out O/r.mcap --truth O/t.npz",
    "estimate": "estimate LONG --sensor SENSOR --out O/r.npz --csv O/r.csv",
    "export": "export LONG --sensor SENSOR --what depth,vtk --out O/files",
    "convert": "convert LONG O/r.mcap",
    "pose": "pose LONG --sensor SENSOR --object cylinder --init POSE --out O/p.csv",
}


@pytest.fixture(scope="module")
def given(sensor, press, tmp_path_factory):
    """A sensor, a short press, and an image of it a thousand times."""
    with bv.open(press) as recording:
        depth = recording[1].depth_m
    bag = BagMaker("mcap plain")
    for k in range(1000):
        bag.image(START + k * PERIOD, depth)
    names = {
        "SENSOR": sensor,
        "PRESS": press,
        "LONG": bag.write(tmp_path_factory.mktemp("given")),
        "POSE": "0 0 0.044 0 0 0 1",
    }
    return {key: str(value) for key, value in names.items()}


def words_of(line, given, folder):
    return [given.get(word, word.replace("O/", f"{folder}/")) for word in line.split()]


def stopped(words, folder, by, eventually):
    """Stop a command that writes a file or has worked for 2 s; its exit code and stderr."""

    def works():
        times = psutil.Process(process.pid).cpu_times()
        return any(folder.iterdir()) or times.user > 2.0 or process.poll() is not None

    with subprocess.Popen([*COMMAND, *words], stdout=-3, stderr=-1, text=True) as process:
        eventually(works)
        process.send_signal(by)
        return process.wait(), process.stderr.read()


@pytest.mark.parametrize(
    "name",  # the table of `pose` is written as that of `estimate`, `simulate` as `convert`
    [
        pytest.param(each, marks=pytest.mark.long if each in ("simulate", "pose") else ())
        for each in WRITING
    ],
)
def test_a_terminated_command_leaves_no_file(name, given, tmp_path, eventually):
    """SIGTERM, as of `timeout` and systemd, while it writes."""
    done = stopped(words_of(WRITING[name], given, tmp_path), tmp_path, signal.SIGTERM, eventually)
    assert list(tmp_path.iterdir()) == []
    assert done == (143, "")


def test_the_next_command_removes_what_a_killed_one_left(given, tmp_path, eventually):
    for name in ("estimate", "export"):
        words = words_of(WRITING[name], given, tmp_path)
        assert stopped(words, tmp_path, signal.SIGKILL, eventually)[0] == -signal.SIGKILL
    assert list(tmp_path.iterdir())
    output_of("convert", given["PRESS"], tmp_path / "new.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["new.mcap"]


ONTO_DISK = {
    "r.npz": "estimate PRESS --sensor SENSOR --out O/r.npz",
    "r.csv": "estimate PRESS --sensor SENSOR --out O/r.npz --csv O/r.csv",
    "plots.png": "export PRESS --sensor SENSOR --out O/plots.png",
    "files": "export PRESS --sensor SENSOR --what depth --out O/files",
    "sensor.toml": "",
}


@pytest.mark.parametrize("name", ONTO_DISK)
def test_a_file_is_on_the_disk_before_it_has_its_name(name, given, tmp_path, monkeypatch):
    synced, fsync, path = [], os.fsync, tmp_path / name

    def note(descriptor):
        synced.append((os.fstat(descriptor).st_ino, path.exists()))
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", note)
    if words := words_of(ONTO_DISK[name], given, tmp_path):
        output_of(*words)
    else:
        bv.save_sensor(bv.load_sensor(given["SENSOR"]), path)
    files = [path] if path.is_file() else list(path.rglob("*.png"))
    assert files and all((each.stat().st_ino, False) in synced for each in files)
    assert (tmp_path.stat().st_ino, True) in synced


SWALLOWING = """
import threading
from bubbleviz.cli.command_line import main

@main.command()
def busy():
    print("busy", flush=True)
    try:
        threading.Event().wait()
    except BaseException:
        pass
    threading.Event().wait()

main(["busy"])
"""


def test_a_command_ends_though_a_library_catches_the_exception_that_ends_it():
    command = [sys.executable, "-c", SWALLOWING]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "busy\n"
        process.terminate()
        try:
            assert process.wait(60) == 128 + signal.SIGTERM
        finally:
            process.kill()
