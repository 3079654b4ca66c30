"""The exports of one window: one at a time, away from it, with progress and a way out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from queue import Empty, Full, Queue
from typing import TYPE_CHECKING

import numpy as np
from PySide6.QtCore import QObject, Qt, QTimer, Signal

from bubbleviz.output import open_mp4, pose_columns
from bubbleviz.pipeline import FrameOptions
from bubbleviz.wording import count_of
from bubbleviz_ui.engine.worker import Failed, Worker
from bubbleviz_ui.model.messages import UserMessage
from bubbleviz_ui.view3d.text import text_at
from bubbleviz_ui.view3d.tools import picture_of

if TYPE_CHECKING:
    from bubbleviz.output import PoseRow
    from bubbleviz.progress import Progress
    from bubbleviz.recordings import Frame
    from bubbleviz_ui.engine.controller import Controller
    from bubbleviz_ui.view3d.render_view import View


# What the window exports: how it is called, and what a name for it ends in. No Qt in here.


@dataclass(frozen=True)
class Kind:
    """One kind of export."""

    title: str  # title, tip: As the window calls it
    tip: str
    # What the name of its file may end in, by title; empty: a folder of files
    suffixes: dict[str, str]
    what: str = ""  # Of `bubbleviz.output.export_plan.KINDS`, for a folder

    @property
    def is_video(self) -> bool:
        """Pictures of the 3-D view, which only the window can make."""
        return ".mp4" in self.suffixes.values()

    @property
    def filters(self) -> str:
        """What a file dialog offers."""
        return ";;".join(f"{title} (*{suffix})" for title, suffix in self.suffixes.items())

    def named(self, path: Path, chosen_filter: str) -> Path:
        """Path with the filter's suffix where it has none of the kind's."""
        if not self.suffixes or path.suffix.lower() in self.suffixes.values():
            return path
        title = chosen_filter.split(" (")[0]
        suffix = self.suffixes.get(title, next(iter(self.suffixes.values())))
        return path.with_name(path.name + suffix)


KINDS = (
    Kind("Table", "Numbers of each frame, units in the columns' names; with poses where they "
         "were found", {"CSV": ".csv", "Parquet": ".parquet"}),
    Kind("Plots", "Force, gas pressure, patch, residual and times over time, for print",
         {"PNG": ".png", "SVG": ".svg", "PDF": ".pdf"}),
    Kind("ParaView series", "Membrane with displacement and pressure, one VTK file per frame", {},
         "vtk"),
    Kind("Membrane series", "Deformed membrane, one PLY file per frame", {}, "ply"),
    Kind("Patch clouds", "Points of the contact patch with pressure, one PLY file per frame", {},
         "patch"),
    Kind("Depth pictures", "Depth image, one PNG file per frame", {}, "depth"),
    Kind("Pressure pictures", "Contact pressure in the camera image, one PNG file per frame", {},
         "pressure"),
    Kind("Video of the view", "The 3-D view as it is now, frame by frame", {"MP4": ".mp4"}),
)  # fmt: skip
"""In the order they are offered."""


# A video of the 3-D view: the window draws frame by frame, a thread writes.


WAITING = 2
"""Pictures that may wait for the encoder; 1920×1080 has 6 MB."""
CAPTION_SIZE = 16  # px
LOOK_S = 0.1
"""How often the writer looks whether it is still wanted."""


class VideoExport(QObject):
    """Goes through frames, and hands a picture of each to `write`, which runs in a thread."""

    _taken = Signal()

    def __init__(
        self,
        controller: Controller,
        view: View,
        frames: range,
        size: tuple[int, int],  # Width and height, pixels
        path: Path,
        fps: float,
        *,
        captioned: bool,  # Write frame number and time into the pictures
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

        Raises InputError: The file exists or cannot be written; Cancelled: By `progress`; nothing
        is left then.
        """
        count = len(self._frames)
        with open_mp4(self._path, self._fps) as writer:
            for done in range(count):
                writer.add(self._picture(progress, done / count))
                self._taken.emit()
        return f"Exported {count_of(count, 'frame')} to {self._path}, {self._fps:g} per second"

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
        if not self._controller.cold_solved:
            if self._settling is not result.frame:
                self._settling = result.frame
                self._controller.cold_solve()
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
            return picture_of(self._view, *self._size)
        time_text = self._state.units.time.text(float(facts.times_s[frame]))
        caption.SetInput(f"frame {frame} · {time_text}")
        self._view.renderer.AddViewProp(caption)
        try:
            return picture_of(self._view, *self._size)
        finally:
            self._view.renderer.RemoveViewProp(caption)


STILL_FPS = 30.0
"""Of a video of a single frame."""
TOPIC = "export"
"""Of messages."""


class Exporting(QObject):
    """Exports what is open.

    `poses`: Poses found so far, by frame.
    """

    changed = Signal()  # An export began or ended
    progressed = Signal(str, float)  # What it is at, and the share of it that is done
    notified = Signal(object)  # A `UserMessage`: what was done, or why not

    def __init__(
        self, controller: Controller, view: View, poses: Callable[[], dict[int, PoseRow]]
    ) -> None:
        super().__init__()
        self._controller, self._state, self._view = controller, controller.state, view
        self._poses = poses
        self._video: VideoExport | None = None
        self._worker = Worker("export")
        self._worker.progressed.connect(self.progressed)
        controller.failed.connect(self._on_failed)
        controller.opened.connect(self._on_opened)

    @property
    def busy(self) -> bool:
        """An export goes on."""
        return self._worker.busy

    def why_not(self) -> str:
        """Why nothing can be exported now; empty when something can."""
        facts = self._state.facts
        if facts is None or self._controller.sensor is None:
            return "Nothing is open yet."
        if facts.is_empty:
            return "Nothing is open: open a recording (Ctrl+O) to export its frames."
        if facts.grows:
            return "A live source is exported from its recording: record it (Ctrl+R), then open it."
        return ""

    def frames(self, *, all_of_them: bool, step: int = 1) -> range:
        """Frames of the range that is played, or all; every `step`-th."""
        count = 0 if self._state.facts is None else self._state.facts.frames
        first, last = self._state.play_range or (0, count - 1)
        return range(0, count, step) if all_of_them else range(first, last + 1, step)

    def fps(self, step: int) -> float:
        """Pictures a second of a video that is as fast as playback."""
        facts = self._state.facts
        rate = float("nan") if facts is None else facts.rate_hz / step * self._state.settings.speed
        return min(max(rate, 1.0), 120.0) if rate > 0.0 else STILL_FPS

    def start(self, kind: Kind, frames: range, path: Path, *, captioned: bool = True) -> None:
        """Export frames as a kind to a file, or a new folder, of that name.

        With `captioned` a video has frame number and time in its pictures.
        """
        source, sensor = self._controller.opening.source, self._controller.sensor
        if self.busy or source is None or sensor is None or not frames:
            return
        settings = self._state.settings
        if kind.is_video:
            size, fps = settings.picture_size, self.fps(frames.step)
            self._video = VideoExport(
                self._controller, self._view, frames, size, path, fps, captioned=captioned
            )
            job: Callable[[Progress], str] = self._video.write
        else:
            # with the first export: the window starts without the writers of all kinds
            from bubbleviz_ui.export.file_export import export_to_files

            poses = {frame: pose_columns(row) for frame, row in self._poses().items()}
            how = (FrameOptions(*settings.patch_rule), settings.options, poses)
            job = partial(export_to_files, source.open, sensor, frames, path, kind.what, *how)
        function = partial(job, self._worker.progress)
        self._worker.submit(function, partial(self._on_done, path), self._on_refused)
        self.progressed.emit("starting", 0.0)
        self.changed.emit()

    def cancel(self) -> None:
        """Stop; nothing of it is left."""
        if self.busy:
            self._worker.cancel()
            self._end_video()
            self.changed.emit()

    def close(self) -> None:
        """Stop, and wait for the thread."""
        self._worker.cancel()
        self._worker.close()
        self._end_video()

    def _end_video(self) -> None:
        video, self._video = self._video, None
        if video is not None:
            video.end()

    def _on_done(self, path: Path, done: str) -> None:
        self._end_video()
        self.notified.emit(UserMessage("notice", done, file=path, topic=TOPIC))
        self.changed.emit()

    def _on_refused(self, failed: Failed) -> None:
        self._end_video()
        self.notified.emit(UserMessage("error", failed.message, failed.details, topic=TOPIC))
        self.changed.emit()

    def _on_failed(self, failed: Failed) -> None:
        """A frame of a video that cannot be shown ends it; the window says why."""
        if self._video is not None and failed.key in {"frame", "cold_solve"} and not failed.warning:
            self.cancel()

    def _on_opened(self, _: object) -> None:
        if self._video is not None:  # its frames are gone
            self.cancel()
