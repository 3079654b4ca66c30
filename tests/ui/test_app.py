"""Entry points of the window: screenshots, off-screen runs, interrupts, messages."""

import os
import socket
import tempfile
import textwrap
from dataclasses import replace
from pathlib import Path
from threading import Event

import numpy as np
import pytest
from fakes import DentSource, record, small_sensor
from PySide6.QtCore import QTimer
from PySide6.QtGui import QImage
from PySide6.QtWidgets import QApplication
from window_driver import as_pixels, pressure_coloured, run_python

from bubbleviz.errors import InputError
from bubbleviz.sensor import load_sensor
from bubbleviz_ui.app import run_window, screenshot
from bubbleviz_ui.engine import source
from bubbleviz_ui.engine.source import Source
from bubbleviz_ui.main_window import MainWindow
from bubbleviz_ui.shell.display import has_display
from bubbleviz_ui.window_session import Startup, window_session

PROGRAM = """
from pathlib import Path
from fakes import small_sensor
from bubbleviz.errors import InputError
from bubbleviz_ui.app import run_window, screenshot
from bubbleviz_ui.window_session import Startup
try:
    {what}
except InputError as error:
    sys.exit(str(error))
"""
WINDOW = """
import os, signal
from fakes import small_sensor
from bubbleviz_ui.app import screen_for_pictures
from bubbleviz_ui.window_session import Startup, window_session
with screen_for_pictures(1280, 800), window_session(Startup(small_sensor())) as session:
    window, view, state = session.window, session.window.view, session.state
    window.show()
{body}
"""


def run(what, **environment):
    """Run a call in a process without a display."""
    return run_python(PROGRAM.format(what=what), display=False, **environment)


def in_window(body):
    """Run `body` in a process with a window that plays the synthetic press."""
    done = run_python(WINDOW.format(body=textwrap.indent(textwrap.dedent(body), "    ")))
    assert done.returncode == 0, done.stderr
    return done.stdout


def png_size(path):
    image = QImage(str(path), "PNG")
    return image.width(), image.height()


def test_screenshot_shows_the_whole_window(tmp_path):
    out = tmp_path / "frame.png"
    program = f"""
    from bubbleviz_ui.engine import controller
    from bubbleviz_ui.window_session import WindowSession
    controller.COLD_SOLVE_DELAY_MS = 3000
    save = WindowSession.save
    WindowSession.save = lambda self, out: (print(self.state.final), save(self, out))
    screenshot(Startup(small_sensor(), frame=75), Path({str(out)!r}))"""
    done = run(program, QT_QPA_PLATFORM="offscreen")  # as servers set it; it has no OpenGL
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["True"]  # its numbers are final
    assert png_size(out) == (1280, 800)
    assert len(pressure_coloured(as_pixels(QImage(str(out)))[:700, :1000])) > 200


def test_screenshot_refuses_to_overwrite_and_a_missing_frame(qtbot, tmp_path):
    with (
        pytest.raises(InputError, match="has no frame 100000"),
        window_session(Startup(small_sensor(), frame=100_000)),
    ):
        pytest.fail("it opened")
    out = tmp_path / "frame.png"
    out.write_text("mine")
    with pytest.raises(InputError, match="exists already"):
        screenshot(Startup(small_sensor(), frame=0), out)
    assert out.read_text() == "mine"


@pytest.mark.long
def test_without_a_display_screenshots_are_written_and_listed(tmp_path):
    short = "import bubbleviz_ui.app as app; app.OFFSCREEN_SECONDS = 0.5; "
    done = run(short + "sys.exit(run_window(Startup(small_sensor())))", TMPDIR=str(tmp_path))
    assert done.returncode == 0, done.stderr
    said, *wrote = done.stdout.splitlines()
    assert "no display" in said and wrote
    for line in wrote:
        assert png_size(Path(line.removeprefix("wrote "))) == (1280, 800)


@pytest.mark.long
def test_screenshot_during_playback_shows_one_frame():
    printed = in_window("""
    def save(out):
        print(state.frame, session.controller.result.frame.index)
    session.save, drawn = save, []
    session.controller.shown.connect(lambda result: drawn.append(result.frame.index))
    for _ in range(5):
        count = len(drawn)
        session.wait_for(lambda: len(drawn) > count + 3, "playing")
        session.save_still(None)
        assert state.playing
    """)
    lines = [line.split() for line in printed.splitlines()]
    assert len(lines) == 5 and all(at_cursor == shown for at_cursor, shown in lines)


@pytest.mark.parametrize("pictures", [1, pytest.param(4, marks=pytest.mark.long)])
def test_ctrl_c_while_drawing_exits_cleanly(pictures):
    body = f"""
    count = view.render_count
    def interrupt():
        if view.render_count - count == {pictures}:
            os.kill(os.getpid(), signal.SIGINT)
    view.rendered.connect(interrupt)
    sys.exit(session.run())
    """
    done = run_python(WINDOW.format(body=body))
    assert (done.returncode, done.stderr) == (130, "")


@pytest.mark.long
def test_ctrl_c_during_imports_exits_cleanly():
    done = run_python("""
import os, signal
from fakes import small_sensor
from bubbleviz_ui.app import screen_for_pictures
from bubbleviz_ui.window_session import Startup, window_session

class InterruptedImport:
    def find_spec(self, name, *_):
        if name == "pyvistaqt":
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, InterruptedImport())
try:
    with screen_for_pictures(1280, 800), window_session(Startup(small_sensor())):
        print("opened")
except KeyboardInterrupt:
    print("ended" if "pyvistaqt" in sys.modules else "cut off")
""")
    assert done.returncode == 0, done.stderr
    assert done.stdout == "ended\n"


@pytest.mark.long
def test_benchmark_counts_renders():
    replay = "from benchmarks.window import replay_rate; replay_rate.WARM_UP_S = 0.2; "
    done = run(replay + "print(sorted(replay_rate.replay_fps(small_sensor(), None, 1.0).items()))")
    assert done.returncode == 0, done.stderr
    assert "median_fps" in done.stdout and "dropped_frames" in done.stdout


@pytest.mark.parametrize("recorded", [False, True], ids=["simulation", "recording"])
def test_window_is_shown_while_its_source_is_prepared_and_can_be_closed(
    qapp, monkeypatch, tmp_path, recorded
):
    prepared, seen, startup = Event(), list[str](), Startup(small_sensor())
    opening = source.open_recording if recorded else source.SYNTHETIC.open

    def slowly(*what, **how):
        assert prepared.wait(60.0)
        return opening(*what, **how)

    def close():
        for window in QApplication.topLevelWidgets():
            if window.isVisible() and isinstance(window, MainWindow) and window.busy.isVisible():
                picture = as_pixels(window.view.grabFramebuffer())
                middle, corner = (
                    picture[picture.shape[0] // 2, picture.shape[1] // 2],
                    picture[0, 0],
                )
                if not recorded and np.abs(middle.astype(int) - corner).sum() < 100:
                    continue  # the membrane at rest is not drawn yet
                seen.append(window.busy.label.text())
                prepared.set()  # closing waits for the solver
                window.close()

    if recorded:
        startup = Startup(small_sensor(), record(tmp_path / "a.mcap", DentSource(small_sensor())))
        monkeypatch.setattr(source, "open_recording", slowly)
    else:
        monkeypatch.setattr(source, "SYNTHETIC", replace(source.SYNTHETIC, open=slowly))
    timer = QTimer(interval=20)
    timer.timeout.connect(close)
    timer.start()
    assert run_window(startup) == 0
    timer.stop()
    told = "Opening a.mcap" if recorded else "being simulated"
    assert told in seen[0] and not QApplication.topLevelWidgets()


def test_no_window_stays_for_a_recording_that_cannot_be_opened(qapp, tmp_path):
    with pytest.raises(InputError, match=r"missing\.mcap"):
        run_window(Startup(small_sensor(), tmp_path / "missing.mcap"))
    assert not QApplication.topLevelWidgets()


def test_real_press_opens_with_its_preset_and_shows_contact_at_the_poker(drive, punyo_press):
    driver = drive()
    driver.window.files.open(punyo_press)
    driver.wait(lambda: driver.state.facts.frames == 90)
    driver.state.set_playing(False)
    assert driver.window.controller.sensor.camera.width == 640
    driver.seek(75)
    assert driver.result.frame.depth_m.shape == (480, 640)
    assert len(driver.pressure_pixels()) > 50
    driver.seek(10)
    assert len(driver.pressure_pixels()) == 0
    # with the sensor file of another camera
    driver.open("press", Source.of_recording(punyo_press), load_sensor("pico_flexx_75mm"))
    driver.wait_for_message("640×480")


def test_unusable_display_gives_one_line_of_error(tmp_path):
    assert has_display(os.environ)
    assert not has_display({"DISPLAY": ":4711"})
    assert not has_display({"DISPLAY": ""})
    gone = {"WAYLAND_DISPLAY": "wayland-0", "XDG_RUNTIME_DIR": str(tmp_path)}
    assert not has_display(gone)
    start = "sys.exit(run_window(Startup(small_sensor())))"
    with tempfile.TemporaryDirectory(prefix="w") as folder, socket.socket(socket.AF_UNIX) as screen:
        screen.bind(f"{folder}/wayland-0")  # a path this short fits a socket's name
        screen.listen()
        no_x = {"WAYLAND_DISPLAY": "wayland-0", "XDG_RUNTIME_DIR": folder}
        for told, environment in (("xvfb", {"PATH": str(tmp_path)}), ("XWayland", no_x)):
            done = run(start, **environment)
            assert done.returncode == 1
            assert len(done.stderr.strip().splitlines()) == 1 and told in done.stderr


def test_session_survives_the_references_to_none_that_pyside_loses():
    """None starts with some 10⁵ references; PySide6 6.12.0 on Python 3.11 loses one a call."""
    done = run_python("""
from bubbleviz_ui.window_session import Startup, application
app = application()
for _ in range(400_000):
    app.sendPostedEvents()
print("alive")
""")
    assert done.stdout == "alive\n", done.stderr[:300]
