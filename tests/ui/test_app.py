"""The window without a person: pictures, no display, and what it says then."""

from __future__ import annotations

import os
import socket
import struct
import subprocess
import sys
import tempfile
import textwrap
from collections.abc import Sequence
from pathlib import Path

import pytest
from fakes import small_sensor
from PySide6.QtGui import QImage
from window_driver import Driver, warm

from bubbleviz.errors import InputError
from bubbleviz.frames.recording import Recording
from bubbleviz.sensor import load_sensor
from bubbleviz_ui.app import screenshot
from bubbleviz_ui.engine.source_openers import recording
from bubbleviz_ui.shell.display import has_display
from bubbleviz_ui.window_session import window_session

HERE = Path(__file__).parent
PROGRAM = """
import sys
sys.path.insert(0, {here!r})
from pathlib import Path
from fakes import small_sensor
from bubbleviz.errors import InputError
from bubbleviz_ui.app import run_window, screenshot
from benchmarks.window.replay_rate import replay_fps
try:
    {what}
except InputError as error:
    sys.exit(str(error))
"""

WINDOW = """
import os, signal, sys
sys.path.insert(0, {here!r})
from fakes import small_sensor
from bubbleviz_ui.app import screen_for_pictures
from bubbleviz_ui.window_session import window_session
with screen_for_pictures(1280, 800), window_session(small_sensor(), None, None) as session:
    window, view, state = session.window, session.window.view, session.state
    window.show()
{body}
"""


def run(
    what: str, hidden: Sequence[str] = ("DISPLAY", "WAYLAND_DISPLAY"), **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run a call in a process that has no display."""
    kept = {k: v for k, v in os.environ.items() if k not in hidden}
    return subprocess.run(
        [sys.executable, "-c", PROGRAM.format(here=str(HERE), what=what)],
        env={**kept, **environment}, capture_output=True, text=True, timeout=600, check=False,
        cwd=HERE.parents[1],
    )  # fmt: skip


def in_window(body: str) -> subprocess.CompletedProcess[str]:
    """Run `body` with a window that plays the synthetic press, as a process of its own."""
    code = WINDOW.format(here=str(HERE), body=textwrap.indent(textwrap.dedent(body), "    "))
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=600, check=False,
        cwd=HERE.parents[1],
    )  # fmt: skip


def png_size(path: Path) -> tuple[int, int]:
    head = path.read_bytes()[:24]
    assert head[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = struct.unpack(">II", head[16:24])
    return width, height


def test_screenshot_is_the_whole_window(tmp_path: Path) -> None:
    out = tmp_path / "frame.png"
    done = run(f"screenshot(small_sensor(), None, 75, Path({str(out)!r}))")
    assert done.returncode == 0, done.stderr
    assert png_size(out) == (1280, 800)
    image = QImage(str(out)).convertToFormat(QImage.Format.Format_RGB888)
    import numpy as np

    rows = np.frombuffer(image.constBits(), np.uint8).reshape(image.height(), -1)
    pixels = rows[:, : 3 * image.width()].reshape(image.height(), image.width(), 3)
    assert len(warm(pixels[:700, :1000])) > 200


def test_screenshot_refuses_to_overwrite_and_a_frame_that_is_not_there(
    qtbot: object, tmp_path: Path
) -> None:
    with (
        pytest.raises(InputError, match="has no frame 100000"),
        window_session(small_sensor(), None, 100_000),
    ):
        pytest.fail("it opened")
    out = tmp_path / "frame.png"
    out.write_text("mine")
    with pytest.raises(InputError, match="exists already"):
        screenshot(small_sensor(), None, 0, out)
    assert out.read_text() == "mine"


@pytest.mark.long
def test_without_a_display_the_session_runs_and_names_its_pictures(tmp_path: Path) -> None:
    short = "import bubbleviz_ui.app as app; app.OFFSCREEN_SECONDS = 0.5; "
    done = run(short + "sys.exit(run_window(small_sensor()))", TMPDIR=str(tmp_path))
    assert done.returncode == 0, done.stderr
    said, *wrote = done.stdout.splitlines()
    assert "no display" in said and wrote
    for line in wrote:
        assert png_size(Path(line.removeprefix("wrote "))) == (1280, 800)


@pytest.mark.long
def test_a_picture_of_a_session_that_plays_is_of_one_frame() -> None:
    done = in_window("""
    def save(out):
        print(state.frame, session.controller.result.frame.index, len(drawn))
    session.save, drawn = save, []
    session.controller.shown.connect(lambda result: drawn.append(result.frame.index))
    for _ in range(5):
        count = len(drawn)
        session.wait_for(lambda: len(drawn) > count + 3, "playing")
        session.save_still(None)
        assert state.playing
    """)
    assert done.returncode == 0, done.stderr
    lines = [line.split() for line in done.stdout.splitlines()]
    assert len(lines) == 5
    for at_cursor, shown, _ in lines:
        assert at_cursor == shown


@pytest.mark.parametrize("pictures", [1, pytest.param(4, marks=pytest.mark.long)])
def test_ctrl_c_while_a_picture_is_drawn_ends_in_order(pictures: int) -> None:
    done = in_window(f"""
    count = view.render_count
    def interrupt():
        if view.render_count - count == {pictures}:
            os.kill(os.getpid(), signal.SIGINT)
    view.rendered.connect(interrupt)
    sys.exit(session.run())
    """)
    assert done.returncode == 130
    assert done.stderr == ""


@pytest.mark.long
def test_ctrl_c_while_something_opens_ends_in_order() -> None:
    done = in_window("""
    os.kill(os.getpid(), signal.SIGINT)
    try:
        session.wait_for(lambda: False, "nothing")
    except KeyboardInterrupt:
        print("ended")
    """)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "ended\n"


IMPORTING = """
import os, signal, sys
sys.path.insert(0, {here!r})
from fakes import small_sensor
from bubbleviz_ui.app import screen_for_pictures
from bubbleviz_ui.window_session import window_session

class InterruptedImport:
    def find_spec(self, name, *_):
        if name == "pyvistaqt":
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, InterruptedImport())
try:
    with screen_for_pictures(1280, 800), window_session(small_sensor(), None, None):
        print("opened")
except KeyboardInterrupt:
    print("ended" if "pyvistaqt" in sys.modules else "cut off")
"""


@pytest.mark.long
def test_ctrl_c_while_libraries_are_imported_ends_in_order() -> None:
    done = subprocess.run(
        [sys.executable, "-c", IMPORTING.format(here=str(HERE))], capture_output=True, text=True,
        timeout=600, check=False, cwd=HERE.parents[1],
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout == "ended\n"


def test_without_a_display_and_without_xvfb_one_clear_line(tmp_path: Path) -> None:
    done = run("sys.exit(run_window(small_sensor()))", PATH=str(tmp_path))
    assert done.returncode == 1
    assert len(done.stderr.strip().splitlines()) == 1 and "xvfb" in done.stderr


def test_a_recording_that_cannot_be_opened_never_becomes_a_window(tmp_path: Path) -> None:
    missing = tmp_path / "missing.mcap"
    done = run(f"run_window(small_sensor(), Path({str(missing)!r}))")
    assert done.returncode == 1 and "missing.mcap" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.long
def test_benchmark_counts_renders() -> None:
    short = "import benchmarks.window.replay_rate as bench; bench.WARM_UP_S = 0.2; "
    done = run(short + "print(sorted(replay_fps(small_sensor(), None, 1.0).items()))")
    assert done.returncode == 0, done.stderr
    assert "median_fps" in done.stdout and "dropped_frames" in done.stdout


def test_the_real_press_is_painted_where_the_poker_is(drive, punyo_press: Path) -> None:  # type: ignore[no-untyped-def]
    driver: Driver = drive(
        lambda _: Recording(punyo_press), load_sensor("punyo_oval_d405"), frame=75
    )
    assert len(driver.warm_pixels()) > 50
    driver.seek(10)
    assert len(driver.warm_pixels()) == 0


def test_a_recording_of_another_camera_brings_its_preset(drive, punyo_press: Path) -> None:  # type: ignore[no-untyped-def]
    driver: Driver = drive()
    driver.window.open_file(punyo_press)
    driver.wait(lambda: driver.state.facts.frames == 90)
    assert driver.window.controller.sensor.camera.width == 640
    driver.wait(lambda: driver.window.controller.result.frame.depth_m.shape == (480, 640))
    preset = load_sensor("pico_flexx_75mm")
    driver.window.controller.opening.open("press", recording(punyo_press), lambda: preset)
    driver.wait(driver.window.message.isVisible)
    assert "640×480" in driver.window.message.label.text()


def test_a_display_that_does_not_answer_is_none(tmp_path: Path) -> None:
    assert has_display(os.environ)
    assert not has_display({"DISPLAY": ":4711"})
    assert not has_display({"DISPLAY": ""})
    gone = {"WAYLAND_DISPLAY": "wayland-0", "XDG_RUNTIME_DIR": str(tmp_path)}
    assert not has_display(gone)


def test_wayland_without_an_x_server_is_one_clear_line() -> None:
    with tempfile.TemporaryDirectory(prefix="w") as folder, socket.socket(socket.AF_UNIX) as screen:
        screen.bind(f"{folder}/wayland-0")  # a path this short fits a socket's name
        screen.listen()
        wayland = {"WAYLAND_DISPLAY": "wayland-0", "XDG_RUNTIME_DIR": folder}
        done = run("sys.exit(run_window(small_sensor()))", hidden=("DISPLAY",), **wayland)
    assert done.returncode == 1
    assert len(done.stderr.strip().splitlines()) == 1 and "XWayland" in done.stderr
