"""The command line: help without heavy imports, errors on one line."""

import subprocess
import sys
from dataclasses import replace
from importlib.metadata import EntryPoints
from pathlib import Path
from unittest.mock import call, create_autospec

import click
import numpy as np
import pytest
from click.testing import CliRunner

import bubbleviz as bv
import bubbleviz_ui.app
from bubbleviz.cli.command_line import OneLineErrors, main
from bubbleviz.errors import InputError, SolveError
from bubbleviz.live import LiveSession
from bubbleviz.recordings import Frame, RecordingWriter
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor import load_sensor
from bubbleviz_ui.model.scene_presets import load_scene
from bubbleviz_ui.window_session import Startup
from tests.program import facts_of, output_of, refusal, run


def test_every_command_has_help():
    names = main.list_commands(click.Context(main))
    assert {"open", "window"} < set(names)
    for name in names:
        assert "Usage:" in output_of(name, "--help")


def test_every_command_has_the_short_option_for_help():
    for words in ([], ["estimate"], ["study"], ["study", "speed"]):
        # In a process of its own: click keeps the options of a group from its first use.
        command = [sys.executable, "-m", "bubbleviz", *words]
        said = [subprocess.check_output([*command, each], text=True) for each in ("-h", "--help")]
        assert said[0] == said[1] and "-h, --help" in said[0]


def test_runs_as_a_module():
    words = [sys.executable, "-m", "bubbleviz", "fly"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == "bubbleviz: No such command 'fly'; see bubbleviz --help\n"


def test_presets_are_listed_by_the_names_that_options_take():
    printed = facts_of("presets")
    assert {"pico_flexx_75mm", "punyo_oval_d405"} <= printed["sensors"].keys()
    for name, says in printed["sensors"].items():
        assert says.startswith(bv.load_sensor(name).name)
    assert printed["objects"]["cylinder"] == "24 × 24 × 40 mm"
    for name in printed["objects"]:
        assert load_object(name).name == name
    assert "  cylinder        24 × 24 × 40 mm\n" in output_of("presets")


def test_doctor_prints_what_a_bug_report_needs(tmp_path, monkeypatch):
    """Also where a driver crashes, which must not end the command, or is not installed."""
    (tmp_path / "pyvista.py").write_text("import os; os.abort()")
    (tmp_path / "pyrealsense2.py").write_text("import nothing_of_that_name")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setenv("DISPLAY", ":77")
    printed = facts_of("doctor")
    machine = printed["machine"]
    assert machine["bubbleviz"] == bv.__version__ and sys.version.startswith(machine["Python"])
    assert printed["libraries"]["numpy"] == np.__version__
    assert printed["environment"]["DISPLAY"] == ":77"
    assert machine["OpenGL"] == "no answer; the process ended with code -6"
    assert "[realsense]" in machine["cameras"]
    lines = output_of("doctor").splitlines()
    assert ["numpy", np.__version__] in [line.split() for line in lines]


INSTALL = '[window]"'


@pytest.mark.parametrize("words", [[], ["open", "x.mcap"]])
def test_without_the_window_one_line_says_what_to_install(monkeypatch, words):
    none = EntryPoints([])
    monkeypatch.setattr("bubbleviz.cli.command_line.entry_points", lambda **_: none)
    assert INSTALL in refusal(*words)


@pytest.mark.parametrize("library", ["PySide6", "pyvistaqt"])
def test_without_a_library_of_the_window_one_line_says_what_to_install(library):
    code = (
        f"import sys; sys.modules[{library!r}] = None\n"
        "from bubbleviz.cli.command_line import main; main(['--fresh'])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert library in done.stderr and INSTALL in done.stderr


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (InputError("a: two\nlines"), 2, "bubbleviz: a: two lines\n"),
        (SolveError("no answer"), 1, "bubbleviz: no answer\n"),
        (KeyboardInterrupt(), 130, "bubbleviz: stopped\n"),
        (click.BadParameter("must be odd"), 2, "must be odd"),
    ],
)
def test_errors_of_commands(error, code, line):
    @click.group(cls=OneLineErrors)
    def group():
        pass

    @group.command()
    def fail():
        raise error

    done = CliRunner().invoke(group, ["fail"])
    assert done.exit_code == code
    assert line in done.stderr
    assert "Traceback" not in done.output


# -- the window's commands, without the window --------------------------------------------------


@pytest.fixture
def pico_recording(tmp_path):
    """Recording with images of the size that one preset's camera has."""
    path = tmp_path / "pico.mcap"
    with RecordingWriter(path) as writer:
        writer.write(Frame(0, 0.0, np.full((171, 224), 0.1, dtype=np.float32)))
    return path


@pytest.fixture
def windows(monkeypatch):
    """Calls for the window or its picture, in place of doing it."""
    asked = create_autospec(bubbleviz_ui.app)  # refuses arguments that the functions do not take
    asked.run_window.return_value = 0
    for name in ("run_window", "screenshot"):
        monkeypatch.setattr(f"bubbleviz_ui.app.{name}", getattr(asked, name))
    return asked


def test_exit_code_of_the_window_is_that_of_the_command(windows, pico_recording):
    windows.run_window.return_value = 3
    assert run().exit_code == run("open", pico_recording).exit_code == 3


def test_open_accepts_a_colour_delay_for_recordings_and_live_sources(windows, pico_recording):
    delay = ["--colour-delay", "-0.055"]
    source = ["--source", f"replay:{pico_recording}", "--sensor", "pico_flexx_75mm"]
    for what in ([pico_recording], source):
        output_of("open", *what)
        output_of("open", *what, *delay)
    startups = [each.args[0] for each in windows.run_window.call_args_list]
    opened = [each.sensor for each in startups[:2]]
    opened += [LiveSession(each.live).sensors[0].sensor for each in startups[2:]]
    assert [each.camera.colour_delay_s for each in opened] == [0.0, -0.055] * 2
    assert "session file" in refusal("open", "--session", "dual_nut", *delay)


@pytest.mark.parametrize(
    ("words", "changes"),
    [
        ((), {}),
        (("open", "REC"), {}),
        (("open", "REC", "--sensor", "pico_flexx_75mm", "--frame", 7), {"frame": 7}),
        (("open", "REC", "--scene", "cloud"), {"scene": load_scene("cloud")}),
        (("open", "REC", "--truth", "truth.npz"), {"truth": Path("truth.npz")}),
    ],
)
def test_window_and_screenshot_start_as_told(windows, pico_recording, tmp_path, words, changes):
    """With the matching preset, which is named, or the synthetic sensor."""
    words, out = [pico_recording if word == "REC" else word for word in words], tmp_path / "a.png"
    recording = pico_recording if words else None
    told = output_of(*words) + output_of("--fresh", *words)
    assert ("pico_flexx_75mm" in told) == (bool(words) and "--sensor" not in words)
    startup = Startup(load_sensor("pico_flexx_75mm"), recording, **changes)
    expected = [call.run_window(startup, fresh=fresh) for fresh in (False, True)]
    if words:
        assert output_of(*words, "--screenshot", out).endswith(f"wrote {out}\n")
        pictured = replace(startup, frame=startup.frame or 0)
        expected.append(call.screenshot(pictured, out, overwrite=False))
    assert windows.mock_calls == expected


def test_a_failed_screenshot_tells_the_failure_alone(windows, pico_recording, tmp_path):
    windows.screenshot.side_effect = InputError("no such frame")
    told = refusal("open", pico_recording, "--screenshot", tmp_path / "a.png")
    assert told == "bubbleviz: no such frame\n"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["study"], "Missing command; see bubbleviz study --help"),
        (["open", "x.mcap", "--frame", "-1"], "--frame"),
        # one of recording, source and session
        (["open"], "--session"),
        (["open", "rec.mcap", "--source", "synthetic:"], "--source"),
        (["open", "--source", "synthetic:", "--frame", "0"], "--frame"),
        (["open", "--session", "dual_nut", "--sensor", "pico_flexx_75mm"], "--sensor"),
    ],
)
def test_wrong_usage_of_the_windows_commands(windows, words, message):
    assert message in refusal(*words)
    assert not windows.mock_calls
