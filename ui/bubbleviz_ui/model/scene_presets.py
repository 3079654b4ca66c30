"""Scene presets: visible layers and panels, colours, viewpoint. No Qt."""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, field_validator

from bubbleviz.errors import InputError
from bubbleviz.files import checked, preset_names, presets_folder, read_toml
from bubbleviz_ui.model.registry import LAYERS, PANELS
from bubbleviz_ui.model.settings import CloudColour

Finite = Annotated[float, Field(allow_inf_nan=False)]


def _one_of(names: Collection[str]) -> Callable[[str], str]:
    def checked_name(name: str) -> str:
        if name not in names:
            raise ValueError(f'"{name}" is unknown; choose from {", ".join(names)}')
        return name

    return checked_name


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)


class CloudStyle(_Strict):
    """Style of the measured points; `points` 0 draws all of them."""

    colour: CloudColour = "residual"
    points: int = Field(default=10_000, ge=0)


class MembraneStyle(_Strict):
    """Style of the membrane."""

    opacity: float = Field(default=1.0, ge=0.1, le=1.0)


class Viewpoint(_Strict):
    """Viewpoint: direction in B from the middle of the membrane, and zoom."""

    direction: tuple[Finite, Finite, Finite] = Field(default=(-0.6, -1.0, 1.1), alias="from")
    zoom: float = Field(default=1.32, gt=0.05, lt=20.0)

    @field_validator("direction")
    @classmethod
    def _not_along_up(cls, direction: tuple[float, float, float]) -> tuple[float, float, float]:
        if abs(direction[0]) + abs(direction[1]) == 0.0:
            raise ValueError(
                "x and y are both 0, but z is up in the view; tilt it slightly, [0.01, 0, 1]"
            )
        return direction


class ScenePreset(_Strict):
    """A scene file; results of hidden layers and panels are not computed."""

    schema_version: Literal[1] = 1
    title: str = Field(min_length=1)  # In the menu
    # layers, panels: Names of the visible ones
    layers: tuple[Annotated[str, AfterValidator(_one_of(LAYERS))], ...]
    panels: tuple[Annotated[str, AfterValidator(_one_of(PANELS))], ...] = tuple(
        name for name, panel in PANELS.items() if panel.by_default
    )
    cloud: CloudStyle = CloudStyle()
    membrane: MembraneStyle = MembraneStyle()
    view: Viewpoint = Viewpoint()

    def settings(self) -> dict[str, Any]:
        """Fields of `Settings` set by the scene; κ, speed and scales are kept."""
        return {
            "layers": frozenset(self.layers),
            "panels": frozenset(PANELS[name].settings_name for name in self.panels) - {""},
            "cloud_colour": self.cloud.colour,
            "cloud_points": self.cloud.points or None,
            "membrane_opacity": self.membrane.opacity,
            "view_from": self.view.direction,
            "zoom": self.view.zoom,
        }


def load_scene(name: str) -> ScenePreset:
    """Load a scene preset by name.

    Raises InputError: There is none of that name, or its file breaks the schema.
    """
    names = preset_names("scenes")
    if name not in names:
        raise InputError(
            f'--scene "{name}": no such scene preset; choose one of {", ".join(names)}'
        )
    return read_scene(presets_folder("scenes") / f"{name}.toml")


def read_scene(path: Path) -> ScenePreset:
    """Read a scene file.

    Raises InputError: It is not TOML or breaks the schema; names the key.
    """
    return checked(ScenePreset, read_toml(path), path, "scene")
