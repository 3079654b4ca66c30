"""Exports of a window: one at a time, in a thread, with progress and cancellation."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from queue import Empty, Full, Queue
from typing import TYPE_CHECKING

import numpy as np
from PySide6.QtCore import QObject, Qt, QTimer, Signal

from bubbleviz.output import open_mp4, pose_columns
from bubbleviz.wording import count_of
from bubbleviz_ui.engine.worker import Failed, Worker
from bubbleviz_ui.model.demand import Demand
from bubbleviz_ui.view3d.text import text_at
from bubbleviz_ui.view3d.tools import picture_of

if TYPE_CHECKING:
    from bubbleviz.output import PoseRow
    from bubbleviz.progress import Progress
    from bubbleviz.recordings import Frame
    from bubbleviz_ui.engine.controller import Controller
    from bubbleviz_ui.view3d.render_view import View


# Kinds of exports. No Qt.


@dataclass(frozen=True)
class Kind:
    """One kind of export."""

    title: str
    tip: str
    suffixes: dict[str, str]  # File suffixes by title of the format; empty: a folder of files
    what: str = ""  # For a folder: key of `bubbleviz.output.export_plan.KINDS`

    @property
    def is_video(self) -> bool:
        """Whether it is a video of the 3-D view, rendered by the window."""
        return ".mp4" in self.suffixes.values()

    @property
    def filters(self) -> str:
        """File filters in Qt's syntax."""
        return ";;".join(f"{title} (*{suffix})" for title, suffix in self.suffixes.items())

    def with_suffix(self, path: Path, chosen_filter: str) -> Path:
        """Path with the suffix of the chosen filter, unless it has a suffix of this kind."""
        if not self.suffixes or path.suffix.lower() in self.suffixes.values():
            return path
        title = chosen_filter.split(" (")[0]
        suffix = self.suffixes.get(title, next(iter(self.suffixes.values())))
        return path.with_name(path.name + suffix)


KINDS = (
    Kind("Table", "Numbers of each frame, units in the columns' names; with the poses computed "
         "so far", {"CSV": ".csv", "Parquet": ".parquet"}),
    Kind("Plots", "Force, gas pressure, patch, residual and run time over time, for print",
         {"PNG": ".png", "SVG": ".svg", "PDF": ".pdf"}),
    Kind("ParaView series", "Membrane with displacement and pressure, one VTK file per frame", {},
         "vtk"),
    Kind("Membrane series", "Deformed membrane, one PLY file per frame", {}, "ply"),
    Kind("Patch clouds", "Measured points in the contact patch with pressure, one PLY file per "
         "frame", {}, "patch"),
    Kind("Depth pictures", "Depth image in colours, one PNG file per frame", {}, "depth"),
    Kind("Pressure pictures", "Contact pressure at each pixel in colours, one PNG file per frame",
         {}, "pressure"),
    Kind("Video of the view", "The 3-D view as it is now, frame by frame", {"MP4": ".mp4"}),
)  # fmt: skip
"""In the order of the dialog."""


# Video of the 3-D view: the window draws the frames, a thread encodes them.

MAX_QUEUED = 2
"""Pictures waiting for the encoder; 6 MB each at 1920×1080."""
CAPTION_SIZE = 16  # px
POLL_S = 0.1
"""Period at which the writer checks for cancellation."""


class VideoExport(QObject):
    """Draws frames one by one, and passes the pictures to `write`, which runs in a thread."""

    _picture_written = Signal()

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
        # at the bottom, where there is no other text
        self._caption = text_at(view, CAPTION_SIZE, (0.5, 0.015)) if captioned else None
        if self._caption is not None:
            self._caption.GetTextProperty().SetJustificationToCentered()
        self._drawn = 0
        self._cold_solving: Frame | None = None
        self._pictures: Queue[np.ndarray] = Queue(MAX_QUEUED)
        self._before = self._state.frame
        self._active, self._scaled = True, False
        self._picture_written.connect(self._draw_next, Qt.ConnectionType.QueuedConnection)
        controller.shown.connect(self._draw_next)
        self._state.set_playing(False)
        controller.client.scaled.connect(self._on_scaled)
        QTimer.singleShot(0, self._scale)

    def end(self) -> None:
        """Stop drawing and restore the cursor."""
        if self._active:
            self._active = False
            self._controller.client.scale_to(())
            self._controller.shown.disconnect(self._draw_next)
            self._state.seek(self._before)

    def write(self, progress: Progress) -> str:
        """Write the video, in a thread while the window draws; returns a summary.

        Raises InputError: The file exists or cannot be written; Cancelled: By `progress`; the
        unfinished file is removed.
        """
        count = len(self._frames)
        with open_mp4(self._path, self._fps) as writer:
            for done in range(count):
                picture = None
                while picture is None:
                    progress("drawing", done / count)
                    with suppress(Empty):
                        picture = self._pictures.get(timeout=POLL_S)
                writer.add(picture)
                self._picture_written.emit()
        return f"Exported {count_of(count, 'frame')} to {self._path}, {self._fps:.3g} per second"

    def _scale(self) -> None:
        """Have all frames known first, as the scales must not change in the video."""
        if self._active:
            self._controller.client.scale_to(self._frames)

    def _on_scaled(self) -> None:
        self._scaled = True
        self._draw_next()

    def _draw_next(self, _: object = None) -> None:
        """Draw the next frame once its cold solve is shown, else request that.

        Returns at once while the queue is full.
        """
        if not (self._active and self._scaled) or self._pictures.full():
            return
        if self._drawn == len(self._frames):
            return
        wanted, result = self._frames[self._drawn], self._controller.result
        if result.frame.index != wanted:
            self._state.set_playing(False)
            self._state.seek(wanted)
            return
        if not self._controller.cold_solved:
            if self._cold_solving is not result.frame:
                self._cold_solving = result.frame
                self._controller.cold_solve()
            return
        try:
            self._pictures.put_nowait(self._captioned_picture(wanted))
        except Full:
            return
        self._drawn += 1
        QTimer.singleShot(0, self._draw_next)

    def _captioned_picture(self, frame: int) -> np.ndarray:
        caption, state = self._caption, self._state
        if caption is None:
            return picture_of(self._view, *self._size)
        time_text = state.units.time.text(float(state.facts.times_s[frame]))
        caption.SetInput(f"frame {frame} · {time_text}")
        self._view.renderer.AddViewProp(caption)
        try:
            return picture_of(self._view, *self._size)
        finally:
            self._view.renderer.RemoveViewProp(caption)


SINGLE_FRAME_FPS = 30.0
"""Frame rate of a video of a single frame."""
TOPIC = "export"
"""Topic of messages."""


class Exporting(QObject):
    """Exports the open source.

    `poses`: Returns the poses found so far, by frame.
    """

    changed = Signal()  # An export began or ended
    progressed = Signal(str, float)  # Description of the step, and its completed share

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
        return self._worker.busy

    def why_not(self) -> str:
        """Why nothing can be exported now; empty if export is possible."""
        facts = self._state.facts
        if facts.is_empty:
            return "No recording is open; open one (Ctrl+O) to export its frames."
        if facts.grows:
            return "Live frames cannot be exported; record them (Ctrl+R) and open the recording."
        return ""

    def frames(self, *, all_frames: bool, step: int = 1) -> range:
        """Every `step`-th frame of the played range, or of all frames."""
        count = self._state.facts.frames
        first, last = self._state.play_range or (0, count - 1)
        return range(0, count, step) if all_frames else range(first, last + 1, step)

    def fps(self, step: int) -> float:
        """Frame rate of a video at the speed of playback."""
        rate = self._state.facts.rate_hz / step * self._state.settings.speed
        return min(max(rate, 1.0), 120.0) if rate > 0.0 else SINGLE_FRAME_FPS

    def start(self, kind: Kind, frames: range, path: Path, *, captioned: bool = True) -> None:
        """Export frames to a file or new folder.

        `captioned`: Write frame number and time into the pictures of a video.
        """
        opened = self._controller.opening.current
        if self.busy or opened is None or not frames:
            return
        settings = self._state.settings
        if kind.is_video:
            size, fps = settings.picture_size, self.fps(frames.step)
            self._video = VideoExport(
                self._controller, self._view, frames, size, path, fps, captioned=captioned
            )
            job: Callable[[Progress], str] = self._video.write
        else:
            # imports all writers: not at start
            from bubbleviz_ui.export.file_export import export_to_files

            poses = {frame: pose_columns(row) for frame, row in self._poses().items()}
            job = partial(
                export_to_files,
                opened.request.source.open,
                opened.sensor,
                frames,
                path,
                kind.what,
                Demand.of(settings),
                opened.request.options,  # those of the zeros
                opened.zeros,
                poses,
            )
        function = partial(job, self._worker.progress)
        self._worker.submit(function, partial(self._on_done, path), self._on_refused)
        self.progressed.emit("starting", 0.0)
        self.changed.emit()

    def cancel(self) -> None:
        """Stop and remove unfinished files."""
        if self.busy:
            self._worker.cancel()
            self._end_video()
            self.changed.emit()

    def close(self) -> None:
        """Stop, and ask the thread to end."""
        self._worker.cancel()
        self._worker.close(0.0)
        self._end_video()

    def _end_video(self) -> None:
        video, self._video = self._video, None
        if video is not None:
            video.end()

    def _on_done(self, path: Path, done: str) -> None:
        self._end_video()
        self._state.messages.add("notice", done, file=path, topic=TOPIC)
        self.changed.emit()

    def _on_refused(self, failed: Failed) -> None:
        self._end_video()
        self._state.messages.add("error", failed.message, failed.details, topic=TOPIC)
        self.changed.emit()

    def _on_failed(self, failed: Failed) -> None:
        """Cancel a video if a frame cannot be shown; the window shows the error."""
        if self._video is not None and failed.key in {"frame", "cold_solve"}:
            self.cancel()

    def _on_opened(self, _: object) -> None:
        if self._video is not None:  # its source was closed
            self.cancel()
