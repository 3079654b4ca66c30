"""Saving, autosaving and restoring of the session."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

from pydantic import BaseModel
from PySide6.QtCore import QByteArray, QObject, QSaveFile, QStandardPaths, Qt, QTimer, Signal

from bubbleviz.errors import InputError
from bubbleviz.live import SessionPreset
from bubbleviz.sensor import Sensor
from bubbleviz_ui.engine.solver import Opened
from bubbleviz_ui.engine.source import SYNTHETIC, Source
from bubbleviz_ui.engine.worker import Failed
from bubbleviz_ui.model.messages import OPENING
from bubbleviz_ui.model.settings import USER_SETTINGS
from bubbleviz_ui.model.source_facts import name_of
from bubbleviz_ui.panel_window import PanelWindow
from bubbleviz_ui.session_files.session_file import (
    MAX_RECENT,
    SavedCamera,
    SavedSession,
    UserFile,
    absolute,
    copy_next_to,
    is_copy_next_to,
    missing,
    plain_settings,
    portable,
    read_session,
    read_user_file,
    remove_other_copies,
    with_paths,
    with_sensor,
)
from bubbleviz_ui.shell.file_dialogs import ask_yes_no
from bubbleviz_ui.view3d.render_view import View

EVERY_MS = 3000
"""Period of autosaving."""


def user_file() -> Path:
    """Path of the user's file, in the system's configuration folder."""
    place = QStandardPaths.StandardLocation.AppConfigLocation
    return Path(QStandardPaths.writableLocation(place)) / "session.json"


class SessionSaver(QObject):
    """Session files of one window; `keys` returns the changed ones by action."""

    recent_changed = Signal()

    def __init__(self, window: PanelWindow, keys: Callable[[], dict[str, str]]) -> None:
        super().__init__(window)
        self._window, self._keys = window, keys
        self.recent: tuple[str, ...] = ()  # Recent files, newest first
        self.hinted = False  # The first-run hint was read
        self._source: Source | None = None  # Open; None before the first
        self._absent: SavedSession | None = None  # its source is missing; another one is open
        self._connect_later: SessionPreset | None = None
        self._problems: list[str] = []
        self._origin = ""
        self._copied: tuple[Sensor, Path, Path] | None = None
        self._file: Path | None = None
        self._written: UserFile | None = None
        self._timer = QTimer(self, interval=EVERY_MS)
        self._timer.timeout.connect(lambda: self._autosave())
        window.controller.opened.connect(self._on_opened)
        window.hint.understood.clicked.connect(self._on_hint_read)
        window.state.source_changed.connect(self._on_source)

    # -- the user's own file ------------------------------------------------------------------

    def keep_in(self, file: Path) -> SavedSession:
        """Autosave the session to a file from now on; returns the session read from it.

        A file that cannot be read gives a message and a new session.
        """
        self._file = file
        try:
            user = read_user_file(file)
        except InputError as error:
            user = UserFile()
            self._window.messages.add("error", str(error))
        self.recent, self.hinted = user.recent, user.hinted
        cramped = bool(user.session.tabbed_sides)  # as when the window made these tabs
        self._window.hint.setVisible(not (self.hinted or cramped))
        self.recent_changed.emit()
        self._timer.start()
        return user.session

    def save(self) -> None:
        """Write the user's file atomically, if something has changed."""
        if self._file is None or self._source is None:
            return
        self._file.parent.mkdir(parents=True, exist_ok=True)
        user = UserFile(session=self.snapshot(self._file), recent=self.recent, hinted=self.hinted)
        if user != self._written:
            remedy = "make room for it or allow writing it, then restart the window"
            write_atomically(self._file, user, remedy)
            self._written = user

    def close(self) -> None:
        """Save a last time."""
        self._timer.stop()
        with suppress(InputError, OSError):  # a full disk must not keep the window open
            self.save()
            if self._file is not None and self._written is not None:
                sensor = self._written.session.sensor
                remove_other_copies(self._file, None if sensor is None else Path(sensor))

    # -- sessions -----------------------------------------------------------------------------

    def snapshot(self, file: Path | None = None) -> SavedSession:
        """Current session; an unsaved sensor is copied next to `file`.

        Raises InputError: The sensor cannot be copied.
        """
        window, choices = self._window, plain_settings(self._window.state.settings)
        saved = self._absent  # what is open instead does not replace its source
        if saved is None:
            saved = self._of_source(file)
        elif choices["pose_object"] is None:
            choices["pose_object"] = saved.choices.get("pose_object")
        return saved.model_copy(
            update={
                "choices": choices,
                "geometry": _base64(window.saveGeometry()),
                "layout": _base64(window.saveState()),
                "dragged": window.dragged,
                "tabbed_sides": tuple(str(side.name) for side in window.tabs.made),
                "shortcuts": self._keys(),
            }
        )

    def _of_source(self, file: Path | None) -> SavedSession:
        """What belongs to the open source."""
        window, state, source = self._window, self._window.state, self._source
        sensor = self._sensor_name(file)
        if source is None:
            return SavedSession(sensor=sensor)
        return SavedSession(
            source=source.name,
            depth_topic=source.depth_topic,
            truth=None if source.truth is None else str(source.truth.absolute()),
            live=self._live(sensor),
            sensor=sensor,
            frame=state.frame,
            play_range=state.play_range,
            markers=state.markers,
            camera=_camera(window.view) if window.scene.moved_by_user else None,
        )

    def save_as(self, path: Path) -> None:
        """Write a portable session file, without settings of the user."""

        def write() -> None:
            write_atomically(path, portable(self.snapshot(path), path))

        if self._window.messages.report("session", path, write):
            self._remember(str(path.absolute()))

    def open(self, path: Path) -> None:
        """Open a session file; parts that cannot be opened give messages."""
        try:
            saved = read_session(path)
        except InputError as error:
            self._window.messages.add("error", str(error), topic=OPENING)
            return
        self.restore(saved, path)

    def restore(self, saved: SavedSession, path: Path) -> bool:
        """Restore a session read from a file; returns whether its source is being opened."""
        self._remember(str(path.absolute()))
        saved = self._without_refused_sources(saved, path)
        present = plain_settings(self._window.state.settings)
        own = {name: present[name] for name in USER_SETTINGS}
        saved = saved.model_copy(update={"choices": {**saved.choices, **own}})
        return self.open_source(saved, partial(self.apply_settings, saved, f"{path}: "))

    def _without_refused_sources(self, saved: SavedSession, path: Path) -> SavedSession:
        """The session, without its live sensors if the user refuses to connect to them.

        A file from others may name computers, and files with passwords for them.
        """
        places = [] if saved.live is None else [each.source for each in saved.live.sensors]
        remote = [place for place in places if place.startswith("zenoh:")]
        question = "\n".join([f"{path.name} connects to", *remote, "Connect?"])
        if not remote or ask_yes_no(self._window, "Open session", question):
            return saved
        return saved.model_copy(update={"live": None})

    def apply_settings(self, saved: SavedSession, origin: str = "Last session: ") -> None:
        """Apply settings and layout of a session; `origin` begins messages about it."""
        window, settings = self._window, saved.settings
        missing_object = missing(saved).get("object")
        self._origin, self._problems = origin, []
        if missing_object is not None:
            settings = replace(settings, pose_object=None)
            self._problems.append(f"object {missing_object} is missing")
        with window.undo_recorder.unrecorded():
            window.state.change(**vars(settings))
            if saved.geometry:
                window.restoreGeometry(_bytes(saved.geometry))
            if saved.layout:
                window.restore_layout(_bytes(saved.layout), saved.dragged)
                named = Qt.DockWidgetArea.__members__
                window.tabs.made = {named[name] for name in saved.tabbed_sides if name in named}

    def open_source(
        self,
        saved: SavedSession,
        first: Callable[[], None] = lambda: None,  # Called before, unless opening is refused
    ) -> bool:
        """Open the source of a session at the same frame.

        A missing source gives a message, and is tried again at the next start, unless the user
        opens another one meanwhile.

        Returns bool: Whether it is being opened.
        """
        missing_files = missing(saved)
        lacks = [f"{k} {name} is missing" for k, name in missing_files.items() if k != "object"]

        def begin() -> None:
            first()
            self._problems += lacks

        source: Source | None = None
        if saved.source == SYNTHETIC.name:
            source = SYNTHETIC
        elif saved.source is not None and "recording" not in missing_files:
            truth = None if saved.truth is None or "truth" in missing_files else Path(saved.truth)
            source = Source.of_recording(Path(saved.source), truth, saved.depth_topic)
        if source is None:
            begin()
            self._restore_without_source(saved)
            return False
        sensor = None if "sensor" in missing_files else saved.sensor
        opening = self._window.controller.opening
        return opening.open(
            source,
            opening.sensor_of(source.path, sensor, source.depth_topic),
            frame=saved.frame,
            playing=source.live,
            before=begin,
            then=partial(self.finish, saved),
        )

    def finish(self, saved: SavedSession, failed: Failed | None = None) -> None:
        """Restore range, markers and viewpoint, as the source of a session is open.

        If it failed to open at the start, the session is kept for the next one.
        """
        if failed is not None:
            if self._source is None:
                self._problems, self._absent = [failed.message], saved
            return
        with self._window.undo_recorder.unrecorded():
            state = self._window.state
            state.set_range(saved.play_range)
            state.set_markers(tuple(k for k in saved.markers if k < state.facts.frames))
        if saved.camera is not None:
            camera = self._window.view.camera
            for name in ("position", "focal_point", "up", "view_angle"):
                setattr(camera, name, getattr(saved.camera, name))
            self._window.view.refresh()

    def _autosave(self) -> None:
        try:
            self.save()
        except (InputError, OSError) as error:
            self._timer.stop()
            self._window.messages.add("error", f"Autosave stopped: {error}")

    # -- inside -------------------------------------------------------------------------------

    def _sensor_name(self, file: Path | None) -> str | None:
        """The sensor in use: a preset, a file of the user, or its copy next to `file`."""
        sensor = self._window.controller.sensor
        if sensor is None:
            return None
        if file is None or not self._is_unsaved(sensor) or is_copy_next_to(sensor, file):
            return name_of(sensor)
        if self._copied is None or self._copied[0] is not sensor or self._copied[1] != file:
            self._copied = sensor, file, copy_next_to(sensor, file)
        return str(self._copied[2])

    def _is_unsaved(self, sensor: Sensor) -> bool:
        """Whether a sensor was not saved by the user."""
        copied = self._file is not None and is_copy_next_to(sensor, self._file)
        return not sensor.file or copied

    def _live(self, sensor: str | None) -> SessionPreset | None:
        """Connected live sensors, the selected one with its current sensor file."""
        controller = self._window.live_controller
        if controller.run is None or not self._is_live:
            return None
        live = with_paths(controller.run.preset, absolute)
        return live if sensor is None else with_sensor(live, self._window.controller.chosen, sensor)

    @property
    def _is_live(self) -> bool:
        return self._source is not None and self._source.stream is not None

    def _restore_without_source(self, saved: SavedSession) -> None:
        """Restore a session whose source is missing: connect its live sensors, or keep it."""
        if self._source is None:
            has_one = saved.source is not None or saved.live is not None
            self._absent, self._connect_later = saved if has_one else None, saved.live
        else:
            self._report_problems()
            if saved.live is not None:
                self._window.live_controller.connect_to(saved.live)

    def _on_opened(self, opened: Opened) -> None:
        before, self._source = self._source, opened.request.source
        source, sensor = self._source, name_of(opened.sensor)
        if before is not None and before is not source:
            if self._absent is not None and not self._is_live:
                # else it would replace the source that the user has opened
                self._window.live_controller.cancel()
            self._absent = None  # its source arrived, or the user opened another one
        if (
            sensor is not None
            and Path(sensor).is_absolute()
            and not self._is_unsaved(opened.sensor)
        ):
            self._remember(sensor)
        if source.path is not None:
            self._remember(str(source.path.absolute()))

    def _on_source(self) -> None:
        """A source is open: connect to the live one of the session that is missing."""
        self._report_problems()
        live, self._connect_later = self._connect_later, None
        if live is not None:
            self._window.live_controller.connect_to(live)

    def _on_hint_read(self) -> None:
        self.hinted = True

    def _report_problems(self) -> None:
        if self._problems:
            text = " and ".join(self._problems)
            self._window.messages.add("warning", f"{self._origin}{text}; the rest is restored.")
            self._problems = []

    def _remember(self, path: str) -> None:
        recent = (path, *(other for other in self.recent if other != path))[:MAX_RECENT]
        if recent != self.recent:
            self.recent = recent
            self.recent_changed.emit()


def write_atomically(path: Path, what: BaseModel, remedy: str = "choose another place") -> None:
    """Write or replace a file atomically.

    Raises InputError: It cannot be written.
    """
    file = QSaveFile(str(path))
    text = what.model_dump_json(indent=1).encode()
    opened = file.open(QSaveFile.OpenModeFlag.WriteOnly)
    if not (opened and file.write(text) == len(text) and file.commit()):
        raise InputError(f"{path}: cannot be written ({file.errorString()}); {remedy}")


def _camera(view: View) -> SavedCamera:
    camera = view.camera
    return SavedCamera(
        position=tuple(camera.position),
        focal_point=tuple(camera.focal_point),
        up=tuple(camera.up),
        view_angle=camera.view_angle,
    )


def _base64(data: QByteArray) -> str:
    return bytes(data.toBase64().data()).decode()


def _bytes(text: str) -> QByteArray:
    return QByteArray.fromBase64(text.encode())
