"""One window with its Qt application and event loop.

Qt and VTK are imported with the first window, after the input was checked.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from bubbleviz.errors import InputError
from bubbleviz.sensor import Sensor
from bubbleviz_ui.engine.upkeep import EXIT_CODE, Interrupt
from bubbleviz_ui.startup_imports import import_the_window

if TYPE_CHECKING:
    from PySide6.QtWidgets import QApplication

    from bubbleviz.live import SessionPreset
    from bubbleviz_ui.engine.worker import Failed
    from bubbleviz_ui.model.messages import UserMessage
    from bubbleviz_ui.model.scene_presets import ScenePreset
    from bubbleviz_ui.session_files.session_file import SavedSession


TIMEOUT_S = 300.0
"""Timeout of opening and drawing, generous for a busy machine."""
CONNECT_S = 5.0
"""Time after which the window is shown while a live source is still connecting."""
NO_OPENGL = frozenset({"offscreen", "minimal"})
"""Qt platforms without OpenGL, on which the 3-D view would never draw."""
SWITCH_S = 5e-4
"""Thread switch interval of Python while the solver runs; 5 ms by default."""


@dataclass(frozen=True)
class Startup:
    """What a window opens first."""

    sensor: Sensor
    recording: Path | None = None  # None: the built-in synthetic press as a live sensor
    frame: int | None = None  # Stay at this frame; None: play from the first
    scene: ScenePreset | None = None  # None: the window's default
    live: SessionPreset | None = None  # Live sensors instead of a recording
    saved: Path | None = None  # Session file to restore instead of a recording
    truth: Path | None = None  # TRUTH.npz of a simulated recording; None: the one next to it
    depth_topic: str | None = None  # Of the recording; None: the first


class WindowClosedError(Exception):
    """The window was closed while its first source was being opened."""


class WindowSession:
    """The application, one window and its event loop; see `window_session`."""

    def __init__(self) -> None:
        self.interrupt = Interrupt()
        import_the_window()
        from bubbleviz_ui.engine.controller import Controller
        from bubbleviz_ui.main_window import MainWindow
        from bubbleviz_ui.model.session_state import SessionState
        from bubbleviz_ui.session_files.session_file import SavedSession
        from bubbleviz_ui.view3d.render_view import detect_quality

        self.application = application()
        quality = detect_quality()
        self.interrupt.end(self.application)
        self.state = state = SessionState()
        self.controller = Controller(state)
        # before the solver thread: VTK and Open3D share modules, and importing them in two threads
        # at the same time can deadlock
        self.window = MainWindow(state, self.controller, quality)
        self._last = SavedSession()  # The user's
        self._shown = False  # Before its source is open

    def start(
        self, startup: Startup, saved: SavedSession | None, keep_in: Path | None, *, at_once: bool
    ) -> None:
        """Open the source given to `window_session`; `saved`: the session read from its file."""
        state, self._shows_at_once = self.state, at_once
        restored = keep_in is not None and self._restore(keep_in, startup)
        if saved is not None and startup.saved is not None:
            restored = self._source_opened(self.window.session_saver.restore(saved, startup.saved))
        if startup.scene is not None:
            self.window.use_scene(startup.scene)
        if startup.live is not None:
            self._connect(startup.live)
        elif not restored:
            self._open(startup)
        frame = startup.frame
        if frame is not None and not state.facts.is_empty and frame != state.frame:
            raise InputError(
                f"{startup.recording or 'synthetic press'}: has no frame {frame}; "
                f"choose 0 to {state.facts.frames - 1}"
            )

    def _open(self, startup: Startup) -> None:
        from bubbleviz_ui.engine.source import SYNTHETIC, Source

        ended, opening = list["Failed | None"](), self.controller.opening
        source, what = SYNTHETIC, "synthetic press, whose first frames are being simulated"
        if startup.recording is not None:
            of_recording = startup.recording, startup.truth, startup.depth_topic
            source, what = Source.of_recording(*of_recording), ""
        else:
            self.window.scene.show_at_rest(startup.sensor)
        opening.open(
            source,
            lambda: startup.sensor,
            what=what,
            frame=startup.frame or 0,
            playing=startup.frame is None,
            then=ended.append,
        )
        self._show_at_once()  # what only the first picture needs is made while the solver works
        self.wait_for(lambda: not opening.busy, "opening")
        for failed in filter(None, ended):
            if failed.details:
                raise RuntimeError(failed.details)  # a bug, not the user's file
            raise InputError(failed.message)
        last = self._last
        if (source.name, source.depth_topic) == (last.source, last.depth_topic):
            self.window.session_saver.finish(last)

    def _connect(self, live: SessionPreset) -> None:
        """Connect to live sensors; after `CONNECT_S` the window goes on waiting for them."""
        live_controller, problems = self.window.live_controller, list[str]()

        def note(message: UserMessage) -> None:
            if message.kind == "error":  # a warning is no reason not to start
                problems.append(message.text.rstrip("."))

        self.state.messages.added.connect(note)
        live_controller.connect_to(live)
        end = time.monotonic() + CONNECT_S
        self.wait_for(
            lambda: bool(problems) or not self.state.facts.is_empty or time.monotonic() > end,
            "connecting",
        )
        self.state.messages.added.disconnect(note)
        if problems:
            raise InputError(problems[0])

    def _restore(self, file: Path, startup: Startup) -> bool:
        """Restore the user's last session; returns whether its source is open now.

        Not its source if another one is to be opened. One that cannot be opened any more gives a
        message in the window.
        """
        session_saver = self.window.session_saver
        self._last = saved = session_saver.keep_in(file)
        session_saver.apply_settings(saved)
        with self.window.undo_recorder.unrecorded():
            self.window.shortcuts.use(saved.shortcuts)
        if any(each is not None for each in (startup.recording, startup.live, startup.saved)):
            return False
        return self._source_opened(session_saver.open_source(saved))

    def _source_opened(self, opening: bool) -> bool:
        """Wait for the source of a session if one was requested; whether it is open now."""
        if opening:
            self._show_at_once()
            self.wait_for(lambda: not self.controller.opening.busy, "opening")
        return opening and not self.state.facts.is_empty

    def _show_at_once(self) -> None:
        """Show the window before its source is open, if that was requested."""
        self._shown = self._shows_at_once
        if self._shown:
            self.window.show()

    def wait_for(self, done: Callable[[], bool], what: str) -> None:
        """Run the event loop until `done()`; KeyboardInterrupt after ^C.

        Raises WindowClosedError: The window that is shown at once was closed.
        """
        end = time.monotonic() + TIMEOUT_S
        while not done():
            self.raise_if_interrupted()
            if self._shown and not self.window.isVisible():
                raise WindowClosedError
            if time.monotonic() > end:
                raise InputError(
                    f"{what} took more than {TIMEOUT_S:.0f} s and was stopped; close other "
                    "programs and try again"
                )
            self.application.processEvents()
            time.sleep(0.002)

    def wait_until_drawn(self) -> None:
        """Run the event loop until layout and drawing are complete."""
        view = self.window.view
        for _ in range(3):
            count = view.render_count
            view.refresh()
            self.wait_for(lambda count=count: view.render_count > count, "drawing")  # type: ignore[misc]
        self.window.show_rates()
        self.application.processEvents()

    def save(self, out: Path) -> None:
        """Write a screenshot of the window atomically."""
        from bubbleviz_ui.shell.file_dialogs import write_picture

        write_picture(out, self.window.grab())

    def save_still(self, out: Path) -> None:
        """Write a screenshot during playback, with view and panels at the same frame."""
        playing, failures = self.state.playing, list[object]()
        failed = self.controller.failed.connect(failures.append)
        self.state.set_playing(False)
        self.wait_for(lambda: self._is_shown or bool(failures), "the frame")
        self.controller.failed.disconnect(failed)
        self.wait_until_drawn()
        self.save(out)
        self.state.set_playing(playing)

    @property
    def _is_shown(self) -> bool:
        return self.controller.result.frame.index == self.state.frame

    def raise_if_interrupted(self) -> None:
        """Raise KeyboardInterrupt after ^C; for custom event loops."""
        if self.interrupt.received:
            raise KeyboardInterrupt

    def run(self) -> int:
        """Run the event loop until the window is closed or ^C; returns the exit code."""
        return EXIT_CODE if self.interrupt.received else self.application.exec()

    def close(self) -> None:
        """Close the window without asking about unsaved work, and delete it."""
        from PySide6.QtCore import QEvent
        from shiboken6 import isValid

        if isValid(self.window):
            self.window.close_without_asking()
        self.controller.worker.close(TIMEOUT_S)  # closing did not wait for a long step
        self.application.sendPostedEvents(None, QEvent.Type.DeferredDelete)
        self.application.processEvents()
        self.interrupt.close()


@contextmanager
def window_session(
    startup: Startup, keep_in: Callable[[], Path] | None = None, *, at_once: bool = False
) -> Iterator[WindowSession]:
    """Session whose window is closed and deleted at the end.

    With `keep_in`, the user's last session is read from the file it returns, and this one is saved
    there. With `at_once`, the window is shown before its source is open, unless that is live.

    Raises WindowClosedError: It was closed then; InputError: The session cannot be read, or the
    recording cannot be opened, does not fit the sensor, or has no such frame; KeyboardInterrupt: ^C
    before the event loop runs.
    """
    saved = None if startup.saved is None else _read(startup.saved)  # before there is a window
    session = WindowSession()
    try:
        session.raise_if_interrupted()
        file = None if keep_in is None else keep_in()
        session.start(startup, saved, file, at_once=at_once)
        yield session
    finally:
        session.close()


def _read(saved: Path) -> SavedSession:
    from bubbleviz_ui.session_files.session_file import read_session

    return read_session(saved)


def application() -> QApplication:
    """The Qt application with the window's style; created once."""
    from PySide6.QtWidgets import QApplication

    from bubbleviz_ui.engine.upkeep import GarbageCollector, limit_heaps
    from bubbleviz_ui.shell import theme

    sys.setswitchinterval(SWITCH_S)
    limit_heaps()
    existing = QApplication.instance()
    if isinstance(existing, QApplication):
        made = existing
    else:
        if os.environ.get("WAYLAND_DISPLAY") or os.environ.get("XDG_SESSION_TYPE") == "wayland":
            os.environ.setdefault("QT_QPA_PLATFORM", "xcb")  # VTK draws through X
        linux = sys.platform.startswith("linux")
        if linux and os.environ.get("QT_QPA_PLATFORM") in NO_OPENGL:
            os.environ["QT_QPA_PLATFORM"] = "xcb"  # X server or Xvfb is running
        made = QApplication(["bubbleviz"])
    if made.findChild(GarbageCollector) is None:
        GarbageCollector(made)
    made.setApplicationName("bubbleviz")
    made.setStyle(theme.Style())
    theme.apply(made, theme.chosen("system", theme.system_scheme()))
    return made
