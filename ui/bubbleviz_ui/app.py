"""Entry points: interactive window, off-screen run without a display, or one screenshot.

Qt is imported with the first window, after the input was checked.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from bubbleviz.files import refuse_existing
from bubbleviz_ui.shell.display import has_display, private_display
from bubbleviz_ui.window_session import Startup, WindowClosedError, WindowSession, window_session

OFFSCREEN_SECONDS = 4.0
OFFSCREEN_PICTURES = 3
SIZE = 1280, 800  # px, of a screenshot


def run_window(startup: Startup, *, fresh: bool = True) -> int:
    """Show the window until it is closed.

    `fresh`: Neither restore the user's last session nor save this one.

    Without a display the session runs off-screen for a few seconds and writes screenshots to a new
    folder; their paths are printed.

    Returns int: Exit code.

    Raises InputError: The recording cannot be opened or does not fit the sensor, or the session
    cannot be read; the window is closed.
    """
    if has_display():
        keep_in = None if fresh else _user_file
        with suppress(WindowClosedError), window_session(startup, keep_in, at_once=True) as session:
            session.window.show()
            return session.run()
        return 0
    with (
        private_display(1300, 860),  # initial window and its frame
        window_session(startup) as session,
    ):
        print(f"no display: running off-screen for {OFFSCREEN_SECONDS:.0f} s", flush=True)
        for path in _offscreen(session):
            print(f"wrote {path}", flush=True)
    return 0


def screenshot(startup: Startup, out: Path, *, overwrite: bool = False) -> None:
    """Write a screenshot of the window at one frame.

    Raises InputError: There is no display, the recording cannot be opened or has no such frame, or
    the picture exists or cannot be written.
    """
    refuse_existing(out, overwrite=overwrite)
    with screen_for_pictures(*SIZE), window_session(startup) as session:
        session.window.resize(*SIZE)
        session.window.show()
        # so that numbers and scales do not depend on the frames solved before
        controller, state = session.controller, session.state
        session.wait_for(
            lambda: controller.cold_solved and (state.playing or not controller.worker.busy),
            "solving the frame",
        )
        session.wait_until_drawn()
        session.save(out)


def _user_file() -> Path:
    from bubbleviz_ui.session_saver import user_file  # loads Qt

    return user_file()


def _offscreen(session: WindowSession) -> Iterator[Path]:
    folder = Path(tempfile.mkdtemp(prefix="bubbleviz-"))
    session.window.show()
    for number in range(1, OFFSCREEN_PICTURES + 1):
        end = time.monotonic() + OFFSCREEN_SECONDS / OFFSCREEN_PICTURES
        session.wait_for(lambda end=end: time.monotonic() > end, "running")  # type: ignore[misc]
        path = folder / f"window-{number}.png"
        session.save_still(path)
        yield path


@contextmanager
def screen_for_pictures(width: int, height: int) -> Iterator[None]:
    """Display for a screenshot: a private Xvfb if installed, so that no window flashes up."""
    if sys.platform.startswith("linux") and (shutil.which("Xvfb") or not has_display()):
        with private_display(width, height):
            yield
    else:
        yield
