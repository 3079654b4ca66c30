"""A video of the 3-D view: the window draws frame by frame, a thread writes."""

from __future__ import annotations

from pathlib import Path
from queue import Empty, Full, Queue
from typing import TYPE_CHECKING

import numpy as np
from PySide6.QtCore import QObject, Qt, QTimer, Signal

from bubbleviz.output.mp4_writer import open_mp4
from bubbleviz.wording import count_of
from bubbleviz_ui.view3d.scene_text import text_at
from bubbleviz_ui.view3d.tools.still_picture import still

if TYPE_CHECKING:
    from bubbleviz.frames.frame import Frame
    from bubbleviz.progress import Progress
    from bubbleviz_ui.engine.controller import Controller
    from bubbleviz_ui.view3d.render_view import View

WAITING = 2
"""Pictures that may wait for the encoder; 1920×1080 has 6 MB."""
CAPTION_SIZE = 16  # px
LOOK_S = 0.1
"""How often the writer looks whether it is still wanted."""


class VideoExport(QObject):
    """Goes through frames, and hands a picture of each to `write`, which runs in a thread.

    Parameters
    ----------
    controller : Controller
    view : View
    frames : range
    size : (int, int)
        Width and height, pixels.
    path : Path
    fps : float
    captioned : bool
        Write frame number and time into the pictures.
    """

    _taken = Signal()

    def __init__(
        self,
        controller: Controller,
        view: View,
        frames: range,
        size: tuple[int, int],
        path: Path,
        fps: float,
        *,
        captioned: bool,
    ) -> None:
        super().__init__()
        self._controller, self._state, self._view = controller, controller.state, view
        self._frames, self._size, self._path, self._fps = frames, size, path, fps
        # at the bottom of the picture, where nothing else is written
        self._caption = text_at(view, CAPTION_SIZE, (0.5, 0.015)) if captioned else None
        if self._caption is not None:
            self._caption.GetTextProperty().SetJustificationToCentered()
        self._drawn = 0
        self._settling: Frame | None = None
        self._pictures: Queue[np.ndarray] = Queue(WAITING)
        self._before = self._state.frame
        self._active = True
        self._taken.connect(self._go_on, Qt.ConnectionType.QueuedConnection)
        controller.shown.connect(self._go_on)
        self._state.set_playing(False)
        QTimer.singleShot(0, self._go_on)

    def end(self) -> None:
        """Draw nothing any more; the cursor goes back to where it was."""
        if self._active:
            self._active = False
            self._controller.shown.disconnect(self._go_on)
            self._state.seek(self._before)

    def write(self, progress: Progress) -> str:
        """Write the video; in a thread, while the window draws. What was done, in a sentence.

        Raises
        ------
        InputError
            The file exists or cannot be written.
        Cancelled
            By `progress`; nothing is left then.
        """
        count = len(self._frames)
        with open_mp4(self._path, self._fps) as writer:
            for done in range(count):
                writer.add(self._picture(progress, done / count))
                self._taken.emit()
        return f"Exported {count_of(count, 'frame')} to {self._path}, {self._fps:g} a second"

    def _picture(self, progress: Progress, done: float) -> np.ndarray:
        while True:
            progress("drawing", done)
            try:
                return self._pictures.get(timeout=LOOK_S)
            except Empty:
                continue

    def _go_on(self, _: object = None) -> None:
        """Draw the next frame once it is shown, and settled as when one stays at it, else ask.

        Nothing is done while there is no room for its picture.
        """
        if not self._active or self._drawn == len(self._frames) or self._pictures.full():
            return
        wanted, result = self._frames[self._drawn], self._controller.result
        if result is None or result.frame.index != wanted:
            self._state.set_playing(False)
            self._state.seek(wanted)
            return
        if not self._controller.settled:
            if self._settling is not result.frame:
                self._settling = result.frame
                self._controller.settle()
            return
        try:
            self._pictures.put_nowait(self._still(wanted))
        except Full:
            return
        self._drawn += 1
        QTimer.singleShot(0, self._go_on)

    def _still(self, frame: int) -> np.ndarray:
        """Picture of the view, with its frame and time where they are wanted."""
        caption, facts = self._caption, self._state.facts
        if caption is None or facts is None:
            return still(self._view, *self._size)
        time_text = self._state.units.time.text(float(facts.times_s[frame]))
        caption.SetInput(f"frame {frame} · {time_text}")
        self._view.renderer.AddViewProp(caption)
        try:
            return still(self._view, *self._size)
        finally:
            self._view.renderer.RemoveViewProp(caption)
