"""Starting the window: with a person before it, off-screen for a while, or for one picture."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from bubbleviz.errors import InputError
from bubbleviz.sensor import Sensor
from ui.display import has_display, private_display

if TYPE_CHECKING:
    from PySide6.QtWidgets import QApplication

OFFSCREEN_SECONDS = 4.0
OFFSCREEN_PICTURES = 3
PATIENCE_S = 60.0
"""How long a picture may take before something is called broken."""


def run_window(sensor: Sensor, recording: Path | None = None, frame: int | None = None) -> int:
    """Show the window until it is closed.

    Without a display the same session runs off-screen for a few seconds and its pictures are
    written to a new folder, whose files are named on standard output.

    Parameters
    ----------
    sensor : Sensor
    recording : Path, optional
        What to replay; None for the built-in synthetic press as a live sensor.
    frame : int, optional
        Stay at this frame; None plays from the first.

    Returns
    -------
    int
        Exit code.

    Raises
    ------
    InputError
        The recording cannot be opened or does not fit the sensor; no window appears.
    """
    if has_display():
        with _session(sensor, recording, frame) as session:
            session.window.show()
            return session.application.exec()
    with private_display(1280, 800), _session(sensor, recording, frame) as session:
        print(f"no display: running off-screen for {OFFSCREEN_SECONDS:.0f} s", flush=True)
        for path in _offscreen(session):
            print(f"wrote {path}", flush=True)
    return 0


def screenshot(
    sensor: Sensor,
    recording: Path | None,
    frame: int,
    out: Path,
    size: tuple[int, int] = (1280, 800),
) -> None:
    """Write a picture of the whole window at one frame.

    Raises
    ------
    InputError
        There is nothing to draw on, the recording cannot be opened, has no such frame, or the
        picture exists or cannot be written.
    """
    if out.exists():
        raise InputError(f"{out}: exists already; choose another name or remove it")
    with _somewhere(*size), _session(sensor, recording, frame) as session:
        session.window.resize(*size)
        session.window.show()
        session.settle()
        session.save(out)


class _Session:
    """The application, one window, and the loop that waits for it."""

    def __init__(self, sensor: Sensor, recording: Path | None, frame: int | None) -> None:
        from ui.controller import Controller
        from ui.requests import Failed, Opened
        from ui.sources import recording as recording_opener
        from ui.sources import synthetic
        from ui.state import SessionState
        from ui.worker import Worker

        self.application = application()
        state = SessionState()
        self.controller = Controller(state, Worker())
        answers: list[Opened | Failed] = []
        self.controller.opened.connect(answers.append)
        self.controller.failed.connect(answers.append)
        self.controller.open(
            str(recording) if recording else "synthetic press",
            recording_opener(recording) if recording else synthetic,
            lambda: sensor,
            frame=frame or 0,
            playing=frame is None,
            live=recording is None,
        )
        from ui.main_window import MainWindow  # imports VTK while the solver thread opens

        self.window = MainWindow(state, self.controller)
        self.wait_for(lambda: bool(answers), "opening")
        if isinstance(answers[0], Failed):
            self.window.close()
            raise InputError(answers[0].message)
        if frame is not None and state.facts is not None and frame != state.frame:
            self.window.close()
            raise InputError(
                f"{recording or 'synthetic press'}: has no frame {frame}; "
                f"choose 0 to {state.facts.frames - 1}"
            )

    def wait_for(self, done: Callable[[], bool], what: str) -> None:
        """Run the event loop until something is done."""
        end = time.monotonic() + PATIENCE_S
        while not done():
            if time.monotonic() > end:
                raise InputError(f"{what} took more than {PATIENCE_S:.0f} s; given up")
            self.application.processEvents()
            time.sleep(0.002)

    def settle(self, pictures: int = 3) -> None:
        """Run until the window is laid out and has drawn what it shows."""
        view = self.window.view
        for _ in range(pictures):
            count = view.render_count
            view.refresh()
            self.wait_for(lambda count=count: view.render_count > count, "drawing")  # type: ignore[misc]
        self.window.show_rates()
        self.application.processEvents()

    def save(self, out: Path) -> None:
        """Write the picture of the window whole or not at all."""
        from PySide6.QtCore import QSaveFile

        file = QSaveFile(str(out))
        opened = file.open(QSaveFile.OpenModeFlag.WriteOnly)
        if not (opened and self.window.grab().save(file, "PNG") and file.commit()):
            raise InputError(f"{out}: cannot be written ({file.errorString()})")


@contextmanager
def _session(sensor: Sensor, recording: Path | None, frame: int | None) -> Iterator[_Session]:
    session = _Session(sensor, recording, frame)
    try:
        yield session
    finally:
        from PySide6.QtCore import QEvent
        from shiboken6 import isValid

        if isValid(session.window):
            session.window.close()
        session.application.sendPostedEvents(None, QEvent.Type.DeferredDelete)
        session.application.processEvents()


@contextmanager
def _somewhere(width: int, height: int) -> Iterator[None]:
    """A screen for a picture: a private one where there is Xvfb, so nothing flashes up."""
    import shutil

    if sys.platform.startswith("linux") and (shutil.which("Xvfb") or not has_display()):
        with private_display(width, height):
            yield
    else:
        yield


def _offscreen(session: _Session) -> Iterator[Path]:
    folder = Path(tempfile.mkdtemp(prefix="bubbleviz-"))
    session.window.show()
    for number in range(1, OFFSCREEN_PICTURES + 1):
        end = time.monotonic() + OFFSCREEN_SECONDS / OFFSCREEN_PICTURES
        session.wait_for(lambda end=end: time.monotonic() > end, "running")  # type: ignore[misc]
        path = folder / f"window-{number}.png"
        session.save(path)
        yield path


def application() -> QApplication:
    """The Qt application with the window's look; made once."""
    from PySide6.QtWidgets import QApplication

    from ui import theme

    existing = QApplication.instance()
    if isinstance(existing, QApplication):
        made = existing
    else:
        if os.environ.get("WAYLAND_DISPLAY") or os.environ.get("XDG_SESSION_TYPE") == "wayland":
            os.environ.setdefault("QT_QPA_PLATFORM", "xcb")  # VTK draws through X
        made = QApplication(["bubbleviz"])
    made.setApplicationName("bubbleviz")
    made.setStyle("Fusion")
    made.setPalette(theme.palette())
    made.setStyleSheet(theme.STYLE)
    return made
