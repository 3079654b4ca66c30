"""Format of session files: open source, cursor, settings, layout. No Qt."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal
from urllib.parse import quote, unquote

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from bubbleviz.errors import InputError
from bubbleviz.files import SUFFIXES, portable_path, whole_file
from bubbleviz.live import SessionPreset
from bubbleviz.sensor import Sensor, save_sensor, sensor_to_toml
from bubbleviz_ui.engine.source import SYNTHETIC
from bubbleviz_ui.model.settings import SETTINGS, USER_SETTINGS, ComparedSetting, Settings

# File names in live sources.


ON_DISK = ("replay", "realsense")
"""URI schemes whose path may be a file."""
SAFE = "/:\\ "
"""Characters of a path that are not percent-encoded."""

Rename = Callable[[str], str]


def with_paths(live: SessionPreset, rename: Rename) -> SessionPreset:
    """Live sensors with all names of sensor files and recordings replaced."""
    places = tuple(
        place.model_copy(
            update={"sensor": rename(place.sensor), "source": source_with(place.source, rename)}
        )
        for place in live.sensors
    )
    title = source_with(live.title, rename)  # a single sensor's title is its source
    return live.model_copy(update={"title": title, "sensors": places})


def with_sensor(live: SessionPreset, number: int, sensor: str) -> SessionPreset:
    places = list(live.sensors)
    places[number] = places[number].model_copy(update={"sensor": sensor})
    return live.model_copy(update={"sensors": tuple(places)})


def source_with(source: str, rename: Rename) -> str:
    """A live source with its file name, if any, replaced."""
    scheme, colon, rest = source.partition(":")
    place, question, options = rest.partition("?")
    if scheme not in ON_DISK or not place:
        return source
    return f"{scheme}{colon}{quote(rename(unquote(place)), safe=SAFE)}{question}{options}"


MAX_RECENT = 10  # in the menu
MAX_DISTANCE_M = 1e3  # of a viewpoint
Finite = Annotated[float, Field(allow_inf_nan=False)]
Point = tuple[Finite, Finite, Finite]


class SavedCamera(BaseModel):
    """Camera of the 3-D view: points in B, m; view angle in degrees."""

    model_config = ConfigDict(frozen=True)

    position: Point
    focal_point: Point
    up: Point
    view_angle: float = Field(gt=0.0, lt=180.0)

    @model_validator(mode="after")
    def _is_a_view(self) -> SavedCamera:
        place, centre, up = (np.array(p) for p in (self.position, self.focal_point, self.up))
        if max(np.abs(p).max() for p in (place, centre, up)) > MAX_DISTANCE_M:
            raise ValueError("a coordinate of the viewpoint, in metres, is beyond 1 km")
        if not np.linalg.norm(np.cross(centre - place, up)) > 0.0:
            raise ValueError("the viewpoint has no direction, or one parallel to its up vector")
        return self


class SavedSession(BaseModel):
    """Contents of a session file; unknown keys of later versions are ignored."""

    model_config = ConfigDict(frozen=True)

    schema_version: Literal[1] = 1
    # Path of a recording, or `synthetic:`; None for a source that cannot be opened by name
    source: str | None = None
    depth_topic: str | None = None  # Of that recording, if chosen by the user
    truth: str | None = None  # TRUTH.npz of that recording, if chosen by the user
    live: SessionPreset | None = None  # Connected live sensors
    sensor: str | None = None  # Sensor file or preset
    frame: int = Field(default=0, ge=0)
    play_range: tuple[int, int] | None = None
    markers: tuple[int, ...] = ()
    choices: dict[str, Any] = {}  # Fields of `Settings`
    camera: SavedCamera | None = None  # If moved by the user
    # geometry, layout: Position of the window and its docks, Qt's data in Base64
    geometry: str = ""
    layout: str = ""
    # What the operator dragged: width of the right side, heights of docks above their size hints
    dragged: dict[str, int] = {}
    tabbed_sides: tuple[str, ...] = ()  # Where its docks are tabs for lack of room
    shortcuts: dict[str, str] = {}  # Changed keys by action

    @property
    def settings(self) -> Settings:
        """The settings; values unknown to this version have their defaults."""
        return usable_settings(self.choices)


class UserFile(BaseModel):
    """The user's file: last session, recent files, and whether the hint was read."""

    session: SavedSession = SavedSession()
    recent: tuple[str, ...] = ()  # Newest first
    hinted: bool = False  # The first-run hint was read


def plain_settings(settings: Settings) -> dict[str, Any]:
    """Settings as JSON values."""
    fields: dict[str, Any] = SETTINGS.dump_python(settings, mode="json")
    return {k: sorted(v) if isinstance(getattr(settings, k), frozenset) else v
            for k, v in fields.items()}  # fmt: skip


def usable_settings(fields: dict[str, Any]) -> Settings:
    """Settings of a file; invalid fields have their defaults."""
    usable: dict[str, Any] = {}
    for name, value in fields.items():
        try:
            usable[name] = Settings.valid(
                name, getattr(SETTINGS.validate_python({name: value}), name)
            )
        except (ValidationError, AttributeError):
            continue
    settings = Settings(**usable)
    comparable = all(
        ComparedSetting.valid("solver", s.solver) == s.solver for s in settings.compared
    )
    return settings if comparable else replace(settings, compared=Settings.compared)


def portable(saved: SavedSession, file: Path) -> SavedSession:
    """Session with paths relative to its file, so that the folder can be moved or sent.

    Settings of the user, such as keys and theme, are removed.
    """
    folder = file.absolute().parent

    def relative(name: str) -> str:
        return portable_path(name, folder) if Path(name).is_absolute() else name

    theirs = _renamed(saved, relative)
    choices = {k: v for k, v in theirs.choices.items() if k not in USER_SETTINGS}
    return theirs.model_copy(update={"choices": choices, "shortcuts": {}})


def _renamed(saved: SavedSession, rename: Callable[[str], str]) -> SavedSession:
    """Session with all file names replaced."""
    choices = dict(saved.choices)
    if isinstance(choices.get("pose_object"), str):
        choices["pose_object"] = rename(choices["pose_object"])
    return saved.model_copy(
        update={
            "source": None if saved.source is None else rename(saved.source),
            "truth": None if saved.truth is None else rename(saved.truth),
            "sensor": None if saved.sensor is None else rename(saved.sensor),
            "live": None if saved.live is None else with_paths(saved.live, rename),
            "choices": choices,
        }
    )


def absolute(name: str, file: Path | None = None) -> str:
    """Absolute path of a file of a session: as named, relative to the session file, or next to it.

    The unchanged name if there is no such file.
    """
    places = [Path(name)]
    if file is not None:
        folder = file.absolute().parent
        places = [folder / name, folder / Path(name).name]
    return next((str(place.absolute()) for place in places if place.exists()), name)


def missing(saved: SavedSession) -> dict[str, str]:
    """Missing files of a session with absolute paths, by the field they belong to."""
    named = {"recording": saved.source, "truth": saved.truth, "sensor": saved.sensor}
    if saved.source == SYNTHETIC.name:
        del named["recording"]
    if saved.sensor is not None and not saved.sensor.endswith(".toml"):
        del named["sensor"]  # a preset
    obj = saved.choices.get("pose_object")
    if isinstance(obj, str) and Path(obj).suffix.lower() in SUFFIXES:
        named["object"] = obj
    return {what: name for what, name in named.items() if name and not Path(name).exists()}


def read_session(path: Path) -> SavedSession:
    """Read a session file; its paths are absolute, unless the file is missing.

    Raises InputError: It cannot be read or is not a session.
    """
    return _renamed(_read(path, SavedSession), lambda name: absolute(name, path))


def read_user_file(path: Path) -> UserFile:
    """Read the user's file, or create a new one.

    Raises InputError: It cannot be read, and was renamed.
    """
    if not path.exists():
        return UserFile()
    try:
        return _read(path, UserFile)
    except InputError as error:
        aside = path.with_suffix(".unreadable")
        path.replace(aside)
        raise InputError(
            f"{path}: the last session cannot be read, so the window starts without it; it is "
            f"kept as {aside.name}"
        ) from error


def _read(path: Path, kind: type[Any]) -> Any:
    try:
        return kind.model_validate_json(path.read_bytes())
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"{path}: cannot be read ({reason}); choose another file") from error
    except ValidationError as error:
        problem = error.errors()[0]
        where = ".".join(str(part) for part in problem["loc"]) or "file"
        raise InputError(
            f"{path}: no session that this version can read ({where}: {problem['msg']}); choose "
            "another file"
        ) from error


# Copies of unsaved sensors next to a session file.

FILE = "sensor.toml"


def copy_next_to(sensor: Sensor, file: Path) -> Path:
    """Copy a sensor with its files into a folder next to a session file.

    The folder's name contains a hash of its contents, so that the same sensor is copied only once.

    Returns Path: The sensor file in that folder.

    Raises InputError: A file of the sensor is missing, or the copy cannot be written.
    """
    digest = hashlib.sha256(sensor_to_toml(sensor).encode())
    for path in filter(Path.is_file, sensor.files):
        digest.update(path.read_bytes())
    folder = file.absolute().parent / f"{file.stem}_sensor_{digest.hexdigest()[:8]}"
    if not folder.exists():
        with whole_file(folder) as temporary:
            temporary.mkdir()
            save_sensor(sensor, temporary / FILE)
    return folder / FILE


def is_copy_next_to(sensor: Sensor, file: Path) -> bool:
    return sensor.folder.absolute() in _folders(file)


def remove_other_copies(file: Path, kept: Path | None) -> None:
    """Remove all copies of sensors next to a session file, except `kept`."""
    for folder in _folders(file):
        if kept is None or folder != kept.parent:
            shutil.rmtree(folder, ignore_errors=True)


def _folders(file: Path) -> list[Path]:
    return list(file.absolute().parent.glob(f"{file.stem}_sensor_????????"))
