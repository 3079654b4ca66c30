"""Scene presets: visible layers and panels, colours, viewpoint. No Qt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from bubbleviz.errors import InputError
from bubbleviz.files import preset_names, presets_folder, read_toml
from bubbleviz_ui.model.settings import SETTINGS, Settings


@dataclass(frozen=True)
class ScenePreset:
    """A scene; results of hidden layers and panels are not computed."""

    title: str  # In the menu
    settings: dict[str, Any]  # The fields of `Settings` in the group "scene"


def load_scene(name: str) -> ScenePreset:
    """Load a scene preset by name; what its file leaves out has the defaults of `Settings`.

    Raises InputError: There is none of that name.
    """
    names = preset_names("scenes")
    if name not in names:
        raise InputError(
            f'--scene "{name}": no such scene preset; choose one of {", ".join(names)}'
        )
    read = read_toml(presets_folder("scenes") / f"{name}.toml")
    title, chosen = read.pop("title"), SETTINGS.validate_python(read)
    return ScenePreset(title, {name: getattr(chosen, name) for name in Settings.group("scene")})
