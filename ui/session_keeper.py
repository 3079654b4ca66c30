"""Keeps the session: what of the window goes into a file, comes back from it, and when."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import BaseModel
from PySide6.QtCore import QByteArray, QObject, QSaveFile, QStandardPaths, QTimer, Signal

from bubbleviz.errors import InputError
from bubbleviz.frames.source import FrameSource
from bubbleviz.sensor import Sensor, load_sensor
from ui.requests import Failed, Opened, OpenRequest
from ui.session_file import (
    MOST_RECENT,
    SYNTHETIC,
    SavedCamera,
    SavedSession,
    UserFile,
    for_colleague,
    found,
    name_of,
    plain_choices,
    read_session,
    read_user_file,
)
from ui.sources import RecordingOpener, recording, sensor_for, synthetic
from ui.state import Event, SourceChanged

if TYPE_CHECKING:
    from ui.main_window import MainWindow

EVERY_MS = 3000
"""How much of a session a crash may cost."""


def user_file() -> Path:
    """Where the user's session lives, in the folder the system has for such files."""
    place = QStandardPaths.StandardLocation.AppConfigLocation
    return Path(QStandardPaths.writableLocation(place)) / "session.json"


class SessionKeeper(QObject):
    """Session files of one window.

    Attributes
    ----------
    recent_changed : Signal
        Another file is among the recent ones.
    recent : tuple of str
        Files opened, the newest first.
    hinted : bool
        The user has read the first-run hint.
    """

    recent_changed = Signal()

    def __init__(self, window: MainWindow) -> None:
        super().__init__(window)
        self._window = window
        self.recent: tuple[str, ...] = ()
        self.hinted = False
        self._opened: Opened | None = None
        self._pending: tuple[SavedSession, str] | None = None  # and the source it is for
        self._problem = ""
        self._file: Path | None = None
        self._written: UserFile | None = None
        self._timer = QTimer(self)
        self._timer.setInterval(EVERY_MS)
        self._timer.timeout.connect(lambda: self._autosave())
        window.controller.opened.connect(self._on_opened)
        window.controller.failed.connect(self._on_failed)
        window.hint.understood.clicked.connect(self._on_hint_read)
        window.state.subscribe(self._on_event)

    # -- the user's own file ------------------------------------------------------------------

    def keep_in(self, file: Path) -> SavedSession:
        """Keep the session in a file from now on; returns what it held.

        A file that cannot be read is a message, and a new session.
        """
        self._file = file
        try:
            user = read_user_file(file)
        except InputError as error:
            user = UserFile()
            self._window.message.say(str(error))
        self.recent, self.hinted = user.recent, user.hinted
        self._window.hint.setVisible(not self.hinted)
        self.recent_changed.emit()
        self._timer.start()
        return user.session

    def save(self) -> None:
        """Write the user's file where something has changed, whole or not at all."""
        if self._file is None or self._opened is None:
            return
        user = UserFile(session=self.snapshot(), recent=self.recent, hinted=self.hinted)
        if user != self._written:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            write_whole(self._file, user)
            self._written = user

    def close(self) -> None:
        """Write for the last time."""
        self._timer.stop()
        with suppress(InputError, OSError):  # a full disk must not keep the window open
            self.save()

    # -- sessions -----------------------------------------------------------------------------

    def snapshot(self) -> SavedSession:
        """Session as it is now."""
        window, state = self._window, self._window.state
        source, sensor = self._names()
        moved = window.scene.moved_by_user
        return SavedSession(
            source=source,
            sensor=sensor,
            frame=state.frame,
            play_range=state.play_range,
            markers=state.markers,
            choices=plain_choices(state.choices),
            camera=_camera(window) if moved else None,
            geometry=_text(window.saveGeometry()),
            layout=_text(window.saveState()),
            shortcuts=window.shortcuts.changed,
        )

    def save_as(self, path: Path) -> None:
        """Write the session for a colleague; keys and colours of the window stay the user's."""
        saved = for_colleague(self.snapshot(), path)
        choices = {k: v for k, v in saved.choices.items() if k != "theme"}
        try:
            write_whole(path, saved.model_copy(update={"choices": choices, "shortcuts": {}}))
        except InputError as error:
            self._window.message.say(str(error))
        else:
            self._remember(str(path.absolute()))

    def open(self, path: Path) -> None:
        """Open a session file; what of it cannot be opened is a message, the rest is restored."""
        try:
            saved = read_session(path)
        except InputError as error:
            self._window.message.say(str(error))
            return
        self._remember(str(path.absolute()))
        saved = saved.model_copy(
            update={"choices": {"theme": self._window.state.choices.theme, **saved.choices}}
        )
        self.use(saved)
        self.open_source(saved, path)

    def use(self, saved: SavedSession) -> None:
        """Take choices and layout of a session."""
        window, choices = self._window, saved.chosen
        with window.settings.unrecorded():
            window.state.choose(**vars(choices))
        if saved.geometry:
            window.restoreGeometry(_bytes(saved.geometry))
        if saved.layout:
            window.restoreState(_bytes(saved.layout))
        window.status.setVisible("status" in choices.panels)

    def open_source(self, saved: SavedSession, file: Path | None = None) -> bool:
        """Ask for the source of a session, to come back to the same frame of it.

        Returns
        -------
        bool
            Whether there is one to open.
        """
        sensor, problems = self._sensor(saved, file), list[str]()
        if saved.sensor is not None and sensor is None:
            problems.append(f"sensor {saved.sensor} is not there")
        opener: Callable[[Sensor], FrameSource] | None = None
        path = None
        if saved.source == SYNTHETIC:
            opener = synthetic
        elif saved.source is not None:
            path = found(saved.source, file)
            opener = recording(path) if path is not None else None
            if path is None:
                problems.append(f"recording {saved.source} is not there")
        if problems:
            origin = f"{file}: " if file is not None else "Last session: "
            self._problem = f"{origin}{' and '.join(problems)}; the rest is restored."
        if opener is None:
            if self._opened is not None:  # else something will be opened in its place
                self._tell_problem()
            return False
        path_found = str(path.absolute()) if path is not None else SYNTHETIC
        self._pending = saved, path_found
        self._window.controller.open(
            saved.source or "",
            opener,
            self._sensor_opener(opener, sensor),
            frame=saved.frame,
            playing=opener is synthetic,
            live=opener is synthetic,
        )
        return True

    def expect(self, saved: SavedSession, path: Path) -> None:
        """Take range, markers and view of a session if this is its recording."""
        if saved.source is not None and Path(saved.source) == path.absolute():
            self._pending = saved, str(path.absolute())

    def reload(self) -> None:
        """Open recording and sensor anew from their files."""
        opened, state = self._opened, self._window.state
        if opened is None or state.facts is None:
            return
        opener = opened.request.open_source
        if isinstance(opener, RecordingOpener):
            opener = replace(opener)
        sensor = opened.sensor
        path = sensor.resolve(sensor.file)
        from_file = bool(sensor.file) and path.exists()
        self._window.controller.open(
            opened.request.what,
            opener,
            (lambda: load_sensor(path)) if from_file else (lambda: sensor),
            frame=state.frame,
            playing=state.playing,
            live=state.facts.live,
        )

    def _autosave(self) -> None:
        try:
            self.save()
        except (InputError, OSError) as error:
            self._timer.stop()
            self._window.message.say(f"The session is not saved any more: {error}")

    # -- inside -------------------------------------------------------------------------------

    def _names(self) -> tuple[str | None, str | None]:
        """Source and sensor by name, as far as they have one."""
        if self._opened is None:
            return None, None
        opener, source = self._opened.request.open_source, None
        if isinstance(opener, RecordingOpener):
            source = str(opener.path.absolute())
        elif opener is synthetic:
            source = SYNTHETIC
        return source, name_of(self._opened.sensor)

    def _sensor(self, saved: SavedSession, file: Path | None) -> str | Path | None:
        """What to load the sensor from; None where it is not there."""
        if saved.sensor is None:
            return None
        path = found(saved.sensor, file)
        if path is not None:
            return path
        is_file = saved.sensor.endswith(".toml")
        return None if is_file else saved.sensor

    def _sensor_opener(
        self, opener: Callable[[Sensor], object], name: str | Path | None
    ) -> Callable[[], Sensor]:
        if name is not None:
            return lambda: load_sensor(name)
        present = self._window.controller.sensor or load_sensor("pico_flexx_75mm")
        if isinstance(opener, RecordingOpener):
            path = opener.path
            return lambda: sensor_for(path, present)
        return lambda: present

    def _on_opened(self, opened: Opened) -> None:
        self._opened = opened
        opener, sensor = opened.request.open_source, name_of(opened.sensor)
        if sensor is not None and Path(sensor).is_absolute():
            self._remember(sensor)
        if isinstance(opener, RecordingOpener):
            self._remember(str(opener.path.absolute()))

    def _on_failed(self, failed: Failed) -> None:
        if isinstance(failed.request, OpenRequest):
            if self._pending is not None and self._opened is None:
                self._problem = f"Last session: {failed.message}; the rest is restored."
            self._pending = None

    def _on_event(self, event: Event) -> None:
        """Once the source is open: what belongs to it."""
        if not isinstance(event, SourceChanged):
            return
        self._tell_problem()
        pending, self._pending = self._pending, None
        if pending is None or pending[1] != self._names()[0]:
            return
        saved = pending[0]
        with self._window.settings.unrecorded():
            state = self._window.state
            state.choose_range(saved.play_range)
            state.choose_markers(tuple(k for k in saved.markers if k < event.facts.frames))
        if saved.camera is not None:
            camera = self._window.view.camera
            for name in ("position", "focal_point", "up", "view_angle"):
                setattr(camera, name, getattr(saved.camera, name))
            self._window.view.refresh()

    def _on_hint_read(self) -> None:
        self.hinted = True

    def _tell_problem(self) -> None:
        if self._problem:
            self._window.message.say(self._problem)
            self._problem = ""

    def _remember(self, path: str) -> None:
        recent = (path, *(other for other in self.recent if other != path))[:MOST_RECENT]
        if recent != self.recent:
            self.recent = recent
            self.recent_changed.emit()


def write_whole(path: Path, what: BaseModel) -> None:
    """Write a file whole or not at all; one that is there is replaced.

    Raises
    ------
    InputError
        It cannot be written.
    """
    file = QSaveFile(str(path))
    text = what.model_dump_json(indent=1).encode()
    opened = file.open(QSaveFile.OpenModeFlag.WriteOnly)
    if not (opened and file.write(text) == len(text) and file.commit()):
        raise InputError(f"{path}: cannot be written ({file.errorString()}); choose another place")


def _camera(window: MainWindow) -> SavedCamera:
    camera = window.view.camera
    return SavedCamera(
        position=tuple(camera.position),
        focal_point=tuple(camera.focal_point),
        up=tuple(camera.up),
        view_angle=camera.view_angle,
    )


def _text(data: QByteArray) -> str:
    return bytes(data.toBase64().data()).decode()


def _bytes(text: str) -> QByteArray:
    return QByteArray.fromBase64(text.encode())
