"""Make docs/press.webp, the window's own video of the real press.

Run as `.venv/bin/python docs/moving_picture.py ../shared/data/punyo_press_a docs/press.webp`.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from imageio_ffmpeg import get_ffmpeg_exe

from bubbleviz.files import whole_file
from bubbleviz.recordings import checked_sensor
from bubbleviz_ui.app import screen_for_pictures
from bubbleviz_ui.export.exporting import KINDS
from bubbleviz_ui.model.scene_presets import load_scene
from bubbleviz_ui.window_session import Startup, window_session

FRAMES = range(58, 90)  # approach, press, hold
SIZE = (720, 480)
SPEED = 0.5  # of real time


def film(recording: Path, out: Path) -> None:
    """Export an MP4 of the 3-D view, as File > Export does."""
    _, sensor = checked_sensor(recording, "auto")
    scene = load_scene("press")
    with (
        screen_for_pictures(1280, 800),
        window_session(Startup(sensor, recording, FRAMES.start, scene)) as session,
    ):
        window = session.window
        window.resize(1280, 800)
        window.show()
        session.wait_until_drawn()
        session.state.change(picture_size=SIZE, speed=SPEED)
        window.messages.added.connect(lambda message: print(message.text))
        video = next(kind for kind in KINDS if kind.is_video)
        window.exporting.start(video, FRAMES, out)
        session.wait_for(lambda: not window.exporting.busy, "exported")


def main() -> None:
    """Film, then turn the film into a picture that READMEs show."""
    recording, out = map(Path, sys.argv[1:])
    with tempfile.TemporaryDirectory() as folder, whole_file(out) as temporary:
        film(recording, Path(folder) / "press.mp4")
        subprocess.run(
            [get_ffmpeg_exe(), "-loglevel", "error", "-i", f"{folder}/press.mp4", "-loop", "0",
             "-quality", "68", str(temporary)],
            check=True,
        )  # fmt: skip


if __name__ == "__main__":
    main()
