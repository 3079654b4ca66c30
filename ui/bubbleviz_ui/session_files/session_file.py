"""A session as a file: what was open, where in it, and everything the user chose. No Qt in here."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal
from urllib.parse import quote, unquote

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, model_validator

from bubbleviz.errors import InputError
from bubbleviz.files import SUFFIXES, presets_folder, whole_file
from bubbleviz.live import SessionPreset
from bubbleviz.sensor import Sensor, sensor_to_toml
from bubbleviz_ui.engine.source import SYNTHETIC
from bubbleviz_ui.model.settings import USER_SETTINGS, ComparedSetting, Settings

# Live sensors in a session file: what of the disk they name. No Qt in here.


ON_DISK = ("replay", "realsense")
"""Schemes whose place may be a file."""
SAFE = "/:\\ "
"""What a place may have as it is."""

Rename = Callable[[str], str]


def with_paths(live: SessionPreset, rename: Rename) -> SessionPreset:
    """The same live sensors with other names for every sensor file and recording."""
    places = tuple(
        place.model_copy(
            update={"sensor": rename(place.sensor), "source": source_with(place.source, rename)}
        )
        for place in live.sensors
    )
    title = source_with(live.title, rename)  # of a single sensor: its source
    return live.model_copy(update={"title": title, "sensors": places})


def with_sensor(live: SessionPreset, number: int, sensor: str) -> SessionPreset:
    """The same live sensors, one of them with another sensor file."""
    places = list(live.sensors)
    places[number] = places[number].model_copy(update={"sensor": sensor})
    return live.model_copy(update={"sensors": tuple(places)})


def source_with(source: str, rename: Rename) -> str:
    """A source with another name for the file it plays, where it plays one."""
    scheme, colon, rest = source.partition(":")
    place, question, options = rest.partition("?")
    if scheme not in ON_DISK or not place:
        return source
    return f"{scheme}{colon}{quote(rename(unquote(place)), safe=SAFE)}{question}{options}"


MOST_RECENT = 10  # in the menu
FARTHEST_M = 1e3  # of a point of view
Finite = Annotated[float, Field(allow_inf_nan=False)]
Point = tuple[Finite, Finite, Finite]
_SETTINGS = TypeAdapter(Settings)


class SavedCamera(BaseModel):
    """Point of view in B: m, and the angle of view in degrees."""

    model_config = ConfigDict(frozen=True)

    position: Point
    focal_point: Point
    up: Point
    view_angle: float = Field(gt=0.0, lt=180.0)

    @model_validator(mode="after")
    def _is_a_view(self) -> SavedCamera:
        place, centre, up = (np.array(p) for p in (self.position, self.focal_point, self.up))
        if max(np.abs(p).max() for p in (place, centre, up)) > FARTHEST_M:
            raise ValueError("the viewpoint is not in metres")
        if not np.linalg.norm(np.cross(centre - place, up)) > 0.0:
            raise ValueError("the viewpoint lacks a direction or an up vector")
        return self


class SavedSession(BaseModel):
    """What a session file holds; keys of later versions are passed over."""

    model_config = ConfigDict(frozen=True)

    schema_version: Literal[1] = 1
    # A recording's path or `synthetic:`; None when a source cannot be opened by name
    source: str | None = None
    truth: str | None = None  # TRUTH.npz of that recording, where the user has named one
    live: SessionPreset | None = None  # Live sensors that were connected
    sensor: str | None = None  # Sensor file or preset
    frame: int = Field(default=0, ge=0)
    play_range: tuple[int, int] | None = None
    markers: tuple[int, ...] = ()
    choices: dict[str, Any] = {}  # Fields of `Settings`
    camera: SavedCamera | None = None  # Where the user has moved the view
    # geometry, layout: The window's place and its docks, Base64 of what Qt makes of them
    geometry: str = ""
    layout: str = ""
    shortcuts: dict[str, str] = {}  # Keys by action, where the user has changed them

    @property
    def chosen(self) -> Settings:
        """The settings; what this version does not know is left at its default."""
        return usable_settings(self.choices)


class UserFile(BaseModel):
    """The user's own file: the last session, and what belongs to no session."""

    session: SavedSession = SavedSession()
    recent: tuple[str, ...] = ()  # Files opened, the newest first
    hinted: bool = False  # The first-run hint was read


def plain_settings(settings: Settings) -> dict[str, Any]:
    """Settings as JSON has them."""
    fields: dict[str, Any] = _SETTINGS.dump_python(settings, mode="json")
    return {k: sorted(v) if isinstance(getattr(settings, k), frozenset) else v
            for k, v in fields.items()}  # fmt: skip


def usable_settings(fields: dict[str, Any]) -> Settings:
    """Settings of a file, each field on its own: one that cannot be used costs no other."""
    usable: dict[str, Any] = {}
    for name, value in fields.items():
        try:
            usable[name] = Settings.valid(
                name, getattr(_SETTINGS.validate_python({name: value}), name)
            )
        except (ValidationError, AttributeError):
            continue
    settings = Settings(**usable)
    comparable = all(
        ComparedSetting.valid("solver", s.solver) == s.solver for s in settings.compared
    )
    return settings if comparable else replace(settings, compared=Settings.compared)


def name_of(sensor: Sensor) -> str | None:
    """Preset's name or file of a sensor; None when it is of no file."""
    if not sensor.file:
        return None
    path = sensor.resolve(sensor.file).absolute()
    if path.parent == presets_folder("sensors").absolute():
        return path.stem
    return str(path)


def for_colleague(saved: SavedSession, file: Path) -> SavedSession:
    """Session whose paths start at its file's folder, so that all can be sent together.

    What is the user's own, keys and colours of the window for one, is left out.
    """
    folder = file.absolute().parent

    def relative(name: str) -> str:
        if not Path(name).is_absolute():
            return name
        try:
            return Path(os.path.relpath(name, folder)).as_posix()
        except ValueError:  # another drive
            return name

    theirs = _renamed(saved, relative)
    choices = {k: v for k, v in theirs.choices.items() if k not in USER_SETTINGS}
    return theirs.model_copy(update={"choices": choices, "shortcuts": {}})


def _renamed(saved: SavedSession, rename: Callable[[str], str]) -> SavedSession:
    """The same session with other names for every file."""
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


def located(saved: SavedSession, file: Path | None) -> SavedSession:
    """Session whose files are named by where they are; those that are not there keep their name.

    `file`: Where it was read from; files are looked for beside it.
    """
    return _renamed(saved, lambda name: absolute(name, file))


def absolute(name: str, file: Path | None = None) -> str:
    """Absolute path of a file of a session; what is no file, or is not there, as it is named."""
    path = found(name, file)
    return name if path is None else str(path.absolute())


def missing(saved: SavedSession) -> dict[str, str]:
    """Files a located session names that are not there, by the field they belong to."""
    named = {"recording": saved.source, "truth": saved.truth, "sensor": saved.sensor}
    if saved.source == SYNTHETIC.name:
        del named["recording"]
    if saved.sensor is not None and not saved.sensor.endswith(".toml"):
        del named["sensor"]  # a preset
    obj = saved.choices.get("pose_object")
    if isinstance(obj, str) and Path(obj).suffix.lower() in SUFFIXES:
        named["object"] = obj
    return {what: name for what, name in named.items() if name and not Path(name).exists()}


def found(name: str, file: Path | None) -> Path | None:
    """Where a file of a session is: as named, from the session's folder, or beside it."""
    places = [Path(name)]
    if file is not None:
        folder = file.absolute().parent
        places = [folder / name, folder / Path(name).name]
    return next((place for place in places if place.exists()), None)


def read_session(path: Path) -> SavedSession:
    """Session of a file.

    Raises InputError: It cannot be read or is no session.
    """
    return _read(path, SavedSession)


def read_user_file(path: Path) -> UserFile:
    """The user's file; a new one where there is none yet.

    Raises InputError: It cannot be read; it is put aside under another name.
    """
    if not path.exists():
        return UserFile()
    try:
        return _read(path, UserFile)
    except InputError as error:
        aside = path.with_suffix(".unreadable")
        path.replace(aside)
        raise InputError(
            f"{path}: the last session cannot be read and is kept as {aside.name}"
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
            f"{path}: not a bubbleviz session ({where}: {problem['msg']}); choose another file"
        ) from error


# A sensor of no file of the user's, kept beside a session file. No Qt in here.


FILE = "sensor.toml"


def kept_beside(sensor: Sensor, file: Path) -> Path:
    """Copy a sensor, with the files it names, into a folder beside a session's file.

    The folder is named after the session and what is in it: another sensor gets another folder,
    and the same one costs nothing.

    Returns Path: The sensor file in that folder.

    Raises InputError: A file the sensor names is gone, or the copy cannot be written.
    """
    content = _content(sensor)
    digest = hashlib.sha256()
    for name, data in content.items():
        digest.update(name.encode() + b"\0" + data)
    folder = file.absolute().parent / f"{file.stem}_sensor_{digest.hexdigest()[:8]}"
    if not folder.exists():
        with whole_file(folder) as temporary:
            temporary.mkdir()
            for name, data in content.items():
                (temporary / name).write_bytes(data)
    return folder / FILE


def is_beside(sensor: Sensor, file: Path) -> bool:
    """Whether a sensor is one that was kept beside this session."""
    return sensor.folder.absolute() in _folders(file)


def forget_others(file: Path, kept: Path | None) -> None:
    """Remove the sensors once kept beside a session, but for the one that still is."""
    for folder in _folders(file):
        if kept is None or folder != kept.parent:
            shutil.rmtree(folder, ignore_errors=True)


def _folders(file: Path) -> list[Path]:
    return list(file.absolute().parent.glob(f"{file.stem}_sensor_????????"))


def _content(sensor: Sensor) -> dict[str, bytes]:
    """Bytes by name: the sensor's file and those it names, all in one folder."""
    membrane, calibration, content = sensor.membrane, sensor.calibration, dict[str, bytes]()
    if membrane.mesh_file is not None:
        name = Path(membrane.mesh_file).name
        content[name] = _read_sensor(sensor.resolve(membrane.mesh_file))
        membrane = membrane.model_copy(update={"mesh_file": name})
    if calibration is not None:
        name = Path(calibration.pixels_file).name
        content[name] = _read_sensor(sensor.resolve(calibration.pixels_file))
        calibration = calibration.model_copy(update={"pixels_file": name})
    alone = sensor.model_copy(update={"membrane": membrane, "calibration": calibration})
    return {**content, FILE: sensor_to_toml(alone).encode()}


def _read_sensor(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"{path}: cannot be read ({reason}); save the sensor again") from error
