"""Session presets: which sensors are shown at once, and where they are in the world."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator
from scipy.spatial.transform import Rotation

from bubbleviz.files.defaults import MOST_COLOUR_DELAY_S
from bubbleviz.files.preset_files import presets_folder
from bubbleviz.files.toml_files import checked, named_file, read_toml

Finite = Annotated[float, Field(allow_inf_nan=False)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class SensorPlace(_Strict):
    """One sensor of a session.

    Attributes
    ----------
    name : str
        Also what its topics begin with.
    sensor : str
        Sensor file or preset.
    source : str
        As `--source`.
    position_m, quaternion_xyzw
        T_W_B.
    colour : str
        Of what is drawn of it, as #rrggbb.
    colour_delay_s : float or None
        In place of the sensor file's `camera.colour_delay_s`.
    """

    name: str = Field(min_length=1)
    sensor: str
    source: str
    position_m: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    quaternion_xyzw: tuple[Finite, Finite, Finite, Finite] = (0.0, 0.0, 0.0, 1.0)
    colour: str = Field(default="#4f8fd0", pattern="^#[0-9a-fA-F]{6}$")
    colour_delay_s: float | None = Field(
        default=None, ge=-MOST_COLOUR_DELAY_S, le=MOST_COLOUR_DELAY_S
    )

    @model_validator(mode="after")
    def _unit(self) -> SensorPlace:
        if abs(np.linalg.norm(self.quaternion_xyzw) - 1.0) > 1e-3:
            raise ValueError("quaternion_xyzw: not of length 1; normalise it")
        return self

    @property
    def T_W_B(self) -> np.ndarray:
        """Pose of the bubble in the world, (4, 4)."""
        T = np.eye(4)
        T[:3, :3] = Rotation.from_quat(self.quaternion_xyzw).as_matrix()
        T[:3, 3] = self.position_m
        return T


class SessionPreset(_Strict):
    """A session file: one or two sensors."""

    schema_version: Literal[1] = 1
    title: str = Field(min_length=1)
    sensors: tuple[SensorPlace, ...] = Field(min_length=1, max_length=2)


def load_session(name: str | Path) -> SessionPreset:
    """Session of a TOML file or, where there is no such file, the preset of that name.

    Raises
    ------
    InputError
        There is none, it is not TOML, or breaks the schema; names the key.
    """
    path = named_file(name, presets_folder("sessions"), "session")
    return checked(SessionPreset, read_toml(path), path, "session")
