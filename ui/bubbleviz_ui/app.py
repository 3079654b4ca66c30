"""Starting the window: with a person before it, off-screen for a while, or for one picture.

Qt is imported with the first window: bad input is refused without it.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bubbleviz.files import refuse_existing
from bubbleviz.live import SessionPreset
from bubbleviz.sensor import Sensor
from bubbleviz_ui.model.scene_presets import ScenePreset
from bubbleviz_ui.shell.display import has_display, private_display
from bubbleviz_ui.window_session import WindowSession, window_session

OFFSCREEN_SECONDS = 4.0  # s; chosen: enough to see it live
OFFSCREEN_PICTURES = 3  # saved in that time


def run_window(
    sensor: Sensor,
    # What to replay; None for the built-in synthetic press as a live sensor
    recording: Path | None = None,
    frame: int | None = None,  # Stay at this frame; None plays from the first
    scene: ScenePreset | None = None,  # What is visible; None for the window's default
    *,
    # Leave the user's last session alone; else come back to it, and keep this one
    fresh: bool = True,
    live: SessionPreset | None = None,  # Live sensors in place of a recording
    saved: Path | None = None,  # Session file to restore in place of a recording
    truth: Path | None = None,  # TRUTH.npz of a recording that was simulated
) -> int:
    """Show the window until it is closed.

    Without a display the same session runs off-screen for a few seconds and its pictures are
    written to a new folder, whose files are named on standard output.

    Returns int: Exit code.

    Raises InputError: The recording cannot be opened or does not fit the sensor, or the session
    cannot be read; no window appears.
    """
    if has_display():
        keep_in = None if fresh else _user_file
        with window_session(
            sensor, recording, frame, scene, keep_in, live, saved, truth
        ) as session:
            session.window.show()
            return session.run()
    with (
        private_display(1300, 860),  # the window at first and its frame
        window_session(sensor, recording, frame, scene, None, live, saved, truth) as session,
    ):
        print(f"no display: running off-screen for {OFFSCREEN_SECONDS:.0f} s", flush=True)
        for path in _offscreen(session):
            print(f"wrote {path}", flush=True)
    return 0


def screenshot(
    sensor: Sensor,
    recording: Path | None,
    frame: int,
    out: Path,
    scene: ScenePreset | None = None,
    size: tuple[int, int] = (1280, 800),
    truth: Path | None = None,
    *,
    overwrite: bool = False,
) -> None:
    """Write a picture of the whole window at one frame.

    Raises InputError: There is nothing to draw on, the recording cannot be opened, has no such
    frame, or the picture exists or cannot be written.
    """
    refuse_existing(out, overwrite=overwrite)
    with (
        screen_for_pictures(*size),
        window_session(sensor, recording, frame, scene, truth=truth) as session,
    ):
        session.window.resize(*size)
        session.window.show()
        session.settle()
        session.save(out)


def _user_file() -> Path:
    from bubbleviz_ui.session_files.session_saver import user_file  # loads Qt

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
    """A screen for a picture: a private one where there is Xvfb, so nothing flashes up."""
    if sys.platform.startswith("linux") and (shutil.which("Xvfb") or not has_display()):
        with private_display(width, height):
            yield
    else:
        yield
