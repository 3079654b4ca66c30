"""Files that the window opens and saves: chosen in dialogs, dropped, recent, or just written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from PySide6.QtCore import QObject, QUrl
from PySide6.QtGui import QDesktopServices

from bubbleviz.errors import UnknownCameraError
from bubbleviz.files import SESSION_SUFFIX, SUFFIXES, TRUTH_SUFFIX
from bubbleviz_ui.engine.solver import OpenRequest
from bubbleviz_ui.engine.source import RECORDINGS, PlacedSensor, Source
from bubbleviz_ui.engine.worker import Failed
from bubbleviz_ui.panel_window import PanelWindow
from bubbleviz_ui.session_saver import SessionSaver
from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.file_dialogs import (
    SENSOR_FILES,
    file_to_open,
    file_to_save,
    files_to_open,
    folder_to_open,
    last_sensor,
    name_of_output,
)

SESSIONS = f"Sessions (*{SESSION_SUFFIX});;All files (*)"
TRUTHS = "Ground truth (*.npz);;All files (*)"
OPENED_BY_WINDOW = (".mcap", ".toml", SESSION_SUFFIX)
"""Suffixes of written files that the window itself opens; others go to the desktop."""


class Files(QObject):
    """Opens files in a window, by their suffix."""

    def __init__(self, window: PanelWindow, saver: SessionSaver) -> None:
        super().__init__(window)
        self._window, self._saver, self._opening = window, saver, window.controller.opening
        window.view.dropped_files.connect(self._open_dropped)
        window.notice.open_requested.connect(self._open_written)
        window.controller.failed.connect(self._on_failed)

    def open(self, path: Path) -> None:
        """Open a sensor, object mesh, session, ground truth or recording."""
        window = self._window
        if path.suffix.lower() == ".toml":
            self._opening.open_sensor_file(path)
        elif path.suffix.lower() in SUFFIXES:
            with window.undo_recorder.one_step("object"):
                window.panels["pose"].show()
                window.state.include("layers", "object", True)
                window.pose.use_file(path)
        elif path.suffix.lower() == SESSION_SUFFIX:
            self._saver.open(path)
        elif path.suffix.lower() == TRUTH_SUFFIX:
            self._opening.use_ground_truth(path)
        else:
            self._opening.open_recording(path)

    def open_recordings(self, paths: list[Path], sensor_file: Path | None = None) -> None:
        """Open a recording, or the first two as two sensors, side by side."""
        if len(paths) == 1:
            self._opening.open_recording(paths[0], sensor_file)
            return
        sensors = [
            PlacedSensor(
                path.stem,
                colour,
                Source.of_recording(path),
                self._opening.sensor_of(path, sensor_file),
                np.eye(4),
            )
            for path, colour in zip(paths[:2], theme.COMPARED, strict=True)
        ]
        self._opening.open_group(sensors)

    def close(self) -> None:
        """Close the recording or the live source; a running recording is completed."""
        self._window.live_controller.disconnect_all()
        self._opening.close_source()

    # -- chosen in a dialog -------------------------------------------------------------------

    def choose(self, title: str, kinds: str, of: str, use: Callable[[Path], object]) -> None:
        """Ask for a file and use it."""
        path = file_to_open(self._window, title, kinds, of=of)
        if path is not None:
            use(path)

    def choose_recordings(self) -> None:
        """Ask for a recording to open, or two."""
        paths = files_to_open(self._window, "Open recording", RECORDINGS, of="recording")
        if paths:
            self.open_recordings(paths)

    def choose_folder(self) -> None:
        """Ask for the folder of a recording to open."""
        path = folder_to_open(self._window, "Open recording folder", of="recording")
        if path is not None:
            self._opening.open_recording(path)

    def save_session(self) -> None:
        proposed = name_of_output(self._window.state.title, f"session{SESSION_SUFFIX}")
        path = file_to_save(self._window, "Save session as", proposed, SESSIONS, of="session")
        if path is not None:
            self._saver.save_as(path)

    def save_screenshot(self) -> None:
        """Ask where to save a picture of the window."""
        kinds = "PNG images (*.png)"
        proposed = name_of_output(self._window.state.title, "window.png")
        path = file_to_save(self._window, "Save screenshot", proposed, kinds, of="picture")
        if path is not None:
            self._window.save_screenshot(path)

    def _on_failed(self, failed: Failed) -> None:
        """Ask for the sensor file of a recording that fits none, and open it again."""
        error, request = failed.error, failed.request
        source = request.source if isinstance(request, OpenRequest) else None
        if isinstance(error, UnknownCameraError) and source is not None and source.path is not None:
            title = f"Sensor file for images of {error.size[0]}×{error.size[1]} pixels"
            known = last_sensor(error.size)
            path = file_to_open(self._window, title, SENSOR_FILES, of="sensor", proposed=known)
            if path is not None:
                again = source.path, path, source.truth, source.depth_topic
                self._opening.open_recording(*again)

    # -- dropped or written -------------------------------------------------------------------

    def _open_dropped(self, paths: list[Path]) -> None:
        """Open the first file; a recording with a sensor file and ground truth dropped with it.

        Two recordings are opened as two sensors.
        """
        by_suffix = {path.suffix.lower(): path for path in reversed(paths)}
        others = {".toml", SESSION_SUFFIX, TRUTH_SUFFIX, *SUFFIXES}
        recordings = [path for path in paths if path.suffix.lower() not in others]
        sensor, truth = by_suffix.get(".toml"), by_suffix.get(TRUTH_SUFFIX)
        if len(recordings) > 1:
            self.open_recordings(recordings, sensor)
        elif recordings and (sensor is not None or truth is not None):
            self._opening.open_recording(recordings[0], sensor, truth)
        else:
            self.open(paths[0])

    def _open_written(self, path: Path) -> None:
        """Open a written file in the window, or with the desktop's program for it."""
        if path.suffix.lower() in OPENED_BY_WINDOW and path.exists():
            self.open(path)
        elif not (path.exists() and QDesktopServices.openUrl(QUrl.fromLocalFile(str(path)))):
            why = "no longer exists"
            if path.exists():
                why = "no program of the desktop opens it; install one for this kind of file"
            self._window.messages.add("error", f"{path}: {why}")
