"""The exports of one window: one at a time, away from it, with progress and a way out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject, Signal

from bubbleviz.output.pose_columns import pose_columns
from bubbleviz.pipeline import FrameOptions
from bubbleviz_ui.engine.jobs import Done, Job, Jobs
from bubbleviz_ui.engine.requests import Failed, FrameRequest
from bubbleviz_ui.export.export_kinds import Kind
from bubbleviz_ui.export.video_export import VideoExport
from bubbleviz_ui.model.messages import UserMessage

if TYPE_CHECKING:
    from bubbleviz.files.pose_writer import PoseRow
    from bubbleviz_ui.engine.controller import Controller
    from bubbleviz_ui.view3d.render_view import View

STILL_FPS = 30.0
"""Of a video of a single frame."""
TOPIC = "export"
"""Of messages."""


class Exporting(QObject):
    """Exports what is open.

    Parameters
    ----------
    controller : Controller
    view : View
    poses : callable
        Poses found so far, by frame.

    Attributes
    ----------
    changed : Signal
        An export began or ended.
    progressed : Signal
        What it is at, and the share of it that is done.
    said : Signal
        A `UserMessage`: what was done, or why not.
    """

    changed = Signal()
    progressed = Signal(str, float)
    said = Signal(object)

    def __init__(
        self, controller: Controller, view: View, poses: Callable[[], dict[int, PoseRow]]
    ) -> None:
        super().__init__()
        self._controller, self._state, self._view = controller, controller.state, view
        self._poses = poses
        self._video: VideoExport | None = None
        self._jobs = Jobs("export")
        self._jobs.progressed.connect(self.progressed)
        controller.failed.connect(self._on_failed)
        controller.opened.connect(self._on_opened)

    @property
    def busy(self) -> bool:
        """An export goes on."""
        return self._jobs.busy

    def why_not(self) -> str:
        """Why nothing can be exported now; empty when something can."""
        facts = self._state.facts
        if facts is None or self._controller.sensor is None:
            return "Nothing is open yet."
        if facts.nothing:
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
        rate = float("nan") if facts is None else facts.rate_hz / step * self._state.choices.speed
        return min(max(rate, 1.0), 120.0) if rate > 0.0 else STILL_FPS

    def start(self, kind: Kind, frames: range, path: Path, *, captioned: bool = True) -> None:
        """Export frames as a kind to a file, or a new folder, of that name.

        With `captioned` a video has frame number and time in its pictures.
        """
        open_source, sensor = self._controller.opening.source, self._controller.sensor
        if self.busy or open_source is None or sensor is None or not frames:
            return
        choices = self._state.choices
        if kind.is_video:
            size, fps = choices.picture_size, self.fps(frames.step)
            self._video = VideoExport(
                self._controller, self._view, frames, size, path, fps, captioned=captioned
            )
            job: Job = self._video.write
        else:
            # with the first export: the window starts without the writers of all kinds
            from bubbleviz_ui.export.file_export import export_to_files

            poses = {frame: pose_columns(asdict(row)) for frame, row in self._poses().items()}
            how = (FrameOptions(*choices.rule), choices.options, poses)
            job = partial(export_to_files, open_source, sensor, frames, path, kind.what, *how)
        self._jobs.run(job, partial(self._on_done, path))
        self.progressed.emit("starting", 0.0)
        self.changed.emit()

    def cancel(self) -> None:
        """Stop; nothing of it is left."""
        if self.busy:
            self._jobs.cancel()
            self._end_video()
            self.changed.emit()

    def close(self) -> None:
        """Stop, and wait for the thread."""
        self._jobs.cancel()
        self._jobs.close()
        self._end_video()

    def _end_video(self) -> None:
        video, self._video = self._video, None
        if video is not None:
            video.end()

    def _on_done(self, path: Path, done: Done) -> None:
        self._end_video()
        if done.message:
            self.said.emit(UserMessage("error", done.message, done.details, topic=TOPIC))
        else:
            self.said.emit(UserMessage("notice", str(done.answer), file=path, topic=TOPIC))
        self.changed.emit()

    def _on_failed(self, failed: Failed) -> None:
        """A frame of a video that cannot be shown ends it; the window says why."""
        if self._video is not None and isinstance(failed.request, FrameRequest):
            self.cancel()

    def _on_opened(self, _: object) -> None:
        if self._video is not None:  # its frames are gone
            self.cancel()
