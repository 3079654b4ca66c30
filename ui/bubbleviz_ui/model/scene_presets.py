"""Scene presets: which layers and panels are visible, in which colours, seen from where. No Qt."""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, field_validator

from bubbleviz.errors import InputError
from bubbleviz.files import checked, preset_names, presets_folder, read_toml
from bubbleviz_ui.model.choices import CloudColour
from bubbleviz_ui.model.registry import LAYERS, PANELS

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
    """How measured points look; `points` 0 draws all of them."""

    colour: CloudColour = "residual"
    points: int = Field(default=10_000, ge=0)


class MembraneStyle(_Strict):
    """How the membrane looks."""

    opacity: float = Field(default=1.0, ge=0.1, le=1.0)


class ViewPoint(_Strict):
    """Where one looks from: a direction in B from the middle of the membrane, and how near."""

    direction: tuple[Finite, Finite, Finite] = Field(default=(-0.6, -1.0, 1.1), alias="from")
    zoom: float = Field(default=1.32, gt=0.05, lt=20.0)

    @field_validator("direction")
    @classmethod
    def _not_along_up(cls, direction: tuple[float, float, float]) -> tuple[float, float, float]:
        if abs(direction[0]) + abs(direction[1]) == 0.0:
            raise ValueError("along z, which is up in the view; lean it a little, [0.01, 0, 1]")
        return direction


class ScenePreset(_Strict):
    """A scene file; what it hides is not computed."""

    schema_version: Literal[1] = 1
    title: str = Field(min_length=1)  # In the menu
    # layers, panels: What is visible
    layers: tuple[Annotated[str, AfterValidator(_one_of(LAYERS))], ...]
    panels: tuple[Annotated[str, AfterValidator(_one_of(PANELS))], ...] = tuple(
        name for name, panel in PANELS.items() if panel.at_first
    )
    cloud: CloudStyle = CloudStyle()  # cloud, membrane, view: Looks
    membrane: MembraneStyle = MembraneStyle()
    view: ViewPoint = ViewPoint()

    def choices(self) -> dict[str, Any]:
        """Fields of `Choices` that the scene decides; κ, speed and scales stay the user's."""
        return {
            "layers": frozenset(self.layers),
            "panels": frozenset(PANELS[name].choice for name in self.panels) - {""},
            "cloud_colour": self.cloud.colour,
            "cloud_points": self.cloud.points or None,
            "membrane_opacity": self.membrane.opacity,
            "view_from": self.view.direction,
            "zoom": self.view.zoom,
        }


def load_scene(name: str) -> ScenePreset:
    """Scene preset of a name.

    Raises InputError: There is none of that name, or its file breaks the schema.
    """
    names = preset_names("scenes")
    if name not in names:
        raise InputError(
            f'--scene "{name}": no such scene preset; choose one of {", ".join(names)}'
        )
    return read_scene(presets_folder("scenes") / f"{name}.toml")


def read_scene(path: Path) -> ScenePreset:
    """Scene of a file.

    Raises InputError: It is not TOML or breaks the schema; names the key.
    """
    return checked(ScenePreset, read_toml(path), path, "scene")
