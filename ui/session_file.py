"""A session as a file: what was open, where in it, and everything the user chose. No Qt in here."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from bubbleviz.errors import InputError
from bubbleviz.inverse.solver import SOLVER_NAMES
from bubbleviz.sensor import Sensor, presets_folder
from ui.needs import CONSUMERS, PLOTS
from ui.state import LAYERS, SPEEDS, Choices

SUFFIX = ".bubbleviz"
SYNTHETIC = "synthetic:"
MOST_RECENT = 10
Finite = Annotated[float, Field(allow_inf_nan=False)]
Point = tuple[Finite, Finite, Finite]
_CHOICES = TypeAdapter(Choices)


class SavedCamera(BaseModel):
    """Point of view in B: m, and the angle of view in degrees."""

    model_config = ConfigDict(frozen=True)

    position: Point
    focal_point: Point
    up: Point
    view_angle: float = Field(gt=0.0, lt=180.0)


class SavedSession(BaseModel):
    """What a session file holds; keys of later versions are passed over.

    Attributes
    ----------
    source : str or None
        A recording's path or `synthetic:`; None when a source cannot be opened by name.
    sensor : str or None
        Sensor file or preset.
    frame : int
    play_range : (int, int) or None
    markers : tuple of int
    choices : dict
        Fields of `Choices`.
    camera : SavedCamera or None
        Where the user has moved the view.
    geometry, layout : str
        The window's place and its docks, Base64 of what Qt makes of them.
    shortcuts : dict
        Keys by action, where the user has changed them.
    """

    model_config = ConfigDict(frozen=True)

    schema_version: Literal[1] = 1
    source: str | None = None
    sensor: str | None = None
    frame: int = Field(default=0, ge=0)
    play_range: tuple[int, int] | None = None
    markers: tuple[int, ...] = ()
    choices: dict[str, Any] = {}
    camera: SavedCamera | None = None
    geometry: str = ""
    layout: str = ""
    shortcuts: dict[str, str] = {}

    @property
    def chosen(self) -> Choices:
        """The choices; what this version does not know is left at its default."""
        return usable_choices(self.choices)


class UserFile(BaseModel):
    """The user's own file: the last session, and what belongs to no session.

    Attributes
    ----------
    session : SavedSession
    recent : tuple of str
        Files opened, the newest first.
    hinted : bool
        The first-run hint was read.
    """

    session: SavedSession = SavedSession()
    recent: tuple[str, ...] = ()
    hinted: bool = False


def plain_choices(choices: Choices) -> dict[str, Any]:
    """Choices as JSON has them."""
    fields: dict[str, Any] = _CHOICES.dump_python(choices, mode="json")
    return {k: sorted(v) if isinstance(getattr(choices, k), frozenset) else v
            for k, v in fields.items()}  # fmt: skip


def usable_choices(fields: dict[str, Any]) -> Choices:
    """Choices of a file, each field on its own: one that cannot be used costs no other."""
    usable: dict[str, Any] = {}
    for name, value in fields.items():
        try:
            usable[name] = getattr(_CHOICES.validate_python({name: value}), name)
        except (ValidationError, AttributeError):
            continue
    choices = Choices(**usable)
    known = choices.solver in (None, *SOLVER_NAMES)
    return replace(
        choices,
        layers=choices.layers & frozenset(LAYERS),
        panels=choices.panels & frozenset(CONSUMERS),
        plots=choices.plots & frozenset(PLOTS),
        speed=choices.speed if choices.speed in SPEEDS else 1.0,
        solver=choices.solver if known else None,
    )


def name_of(sensor: Sensor) -> str | None:
    """Preset's name or file of a sensor; None when it is of no file."""
    if not sensor.file:
        return None
    path = sensor.resolve(sensor.file).absolute()
    if path.parent == presets_folder("sensors").absolute():
        return path.stem
    return str(path)


def for_colleague(saved: SavedSession, file: Path) -> SavedSession:
    """Session whose paths start at its file's folder, so that both can be sent together."""
    folder = file.absolute().parent

    def relative(name: str | None) -> str | None:
        if name is None or not Path(name).is_absolute():
            return name
        try:
            return Path(os.path.relpath(name, folder)).as_posix()
        except ValueError:  # another drive
            return name

    return saved.model_copy(
        update={"source": relative(saved.source), "sensor": relative(saved.sensor)}
    )


def found(name: str, file: Path | None) -> Path | None:
    """Where a file of a session is: as named, from the session's folder, or beside it."""
    places = [Path(name)]
    if file is not None:
        folder = file.absolute().parent
        places = [folder / name, folder / Path(name).name]
    return next((place for place in places if place.exists()), None)


def read_session(path: Path) -> SavedSession:
    """Session of a file.

    Raises
    ------
    InputError
        It cannot be read or is no session.
    """
    return _read(path, SavedSession)


def read_user_file(path: Path) -> UserFile:
    """The user's file; a new one where there is none yet.

    Raises
    ------
    InputError
        It cannot be read; it is put aside under another name.
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
            f"{path}: is no session of bubbleviz ({where}: {problem['msg']}); choose another file"
        ) from error
