"""What every 3-D layer offers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.result import Result
from bubbleviz.sensor import Sensor
from bubbleviz_ui.model.choices import Choices


@dataclass(frozen=True)
class Shape:
    """The displayed shape of the membrane, shared by the layers that lie on it.

    Attributes
    ----------
    nodes_m, normals : (n, 3) arrays
        Deformed nodes and their normals in B.
    pressure_pa : (n,) array
        Contact pressure.
    """

    nodes_m: np.ndarray
    normals: np.ndarray
    pressure_pa: np.ndarray


@dataclass(frozen=True)
class Ranges:
    """Upper ends of the scales in use."""

    pressure_pa: float
    residual_m: float
    force_n: float


@dataclass(frozen=True)
class Picture:
    """One result, ready to draw; `shape` is None when no estimate was asked for."""

    result: Result
    shape: Shape | None
    ranges: Ranges
    choices: Choices


class Layer(Protocol):
    """One thing in the 3-D view. Its actors are made once and live as long as the view."""

    def set_sensor(self, sensor: Sensor, mesh: MembraneMesh) -> None:
        """Take the geometry of another sensor."""

    def draw(self, picture: Picture) -> None:
        """Draw a result in place; called only while the layer is visible."""

    def set_visible(self, visible: bool) -> None:
        """Show or hide."""
