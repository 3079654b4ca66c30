"""What every 3-D layer has: actors, whether they are seen, and how they are drawn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from vtkmodules.vtkCommonExecutionModel import vtkAlgorithm

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.result import Result
from bubbleviz.sensor import Sensor
from bubbleviz_ui.model.choices import Choices
from bubbleviz_ui.model.units import Units
from bubbleviz_ui.view3d.layers.drawn_surface import Shape, Surface
from bubbleviz_ui.view3d.render_view import LIGHTS, View
from bubbleviz_ui.view3d.scale_ranges import Ranges

PERIOD, STROKE = 8, 3
"""Of hatching, along a row of pixels of the picture."""


@dataclass(frozen=True)
class Canvas:
    """What the layers of a sensor are drawn on: a view, one surface, the operator's units."""

    view: View
    surface: Surface
    units: Units


@dataclass(frozen=True)
class Picture:
    """One result, ready to draw; `shape` is None when no estimate was asked for."""

    result: Result
    shape: Shape | None
    ranges: Ranges
    choices: Choices


class Layer:
    """One thing in the 3-D view. Its actors are made once and live as long as the view.

    Parameters
    ----------
    canvas : Canvas

    Attributes
    ----------
    name : str
        Of `registry.LAYERS`.
    cut : bool
        The section plane cuts it open.
    actors : list
        What VTK draws of it, the main one first.
    """

    name = ""
    cut = False

    def __init__(self, canvas: Canvas) -> None:
        self.canvas = canvas
        self.actors: list[Any] = []
        self._visible, self._any = True, True

    @property
    def actor(self) -> Any:
        """The first actor, which is the layer's main one."""
        return self.actors[0]

    def add(self, data: Any, **look: Any) -> Any:
        """Add an actor, seen while the layer is; as `View.add_mesh`."""
        actor = self.canvas.view.add_mesh(data, reset_camera=False, render=False, **look)
        # Straight to the mapper: pyvista puts an algorithm in Python between, run every picture.
        if isinstance(data, vtkAlgorithm):
            actor.mapper.SetInputConnection(data.GetOutputPort())
        elif "scalars" in look:
            actor.mapper.SetInputDataObject(data)
            actor.mapper.SetScalarModeToUsePointFieldData()
            actor.mapper.SelectColorArray(look["scalars"])
        self.actors.append(actor)
        return actor

    def set_sensor(self, sensor: Sensor, mesh: MembraneMesh) -> None:
        """Take the geometry of another sensor."""

    def draw(self, picture: Picture) -> None:
        """Draw a result in place; called only while the layer is visible."""

    def set_visible(self, visible: bool) -> None:
        """Show or hide."""
        self._visible = visible
        self._update()

    def _has(self, something: bool) -> None:
        """Hide the actors while there is nothing to draw."""
        self._any = something
        self._update()

    def _update(self) -> None:
        for actor in self.actors:
            actor.SetVisibility(self._visible and self._any)


def add_mark(view: View, data: Any, units: float = -6000.0, **look: Any) -> Any:
    """Add an actor in front of others that no click finds; as `View.add_mesh` and `in_front`."""
    actor = view.add_mesh(data, reset_camera=False, render=False, **look)
    actor.SetPickable(False)
    in_front(actor, units)
    return actor


def in_front(actor: Any, units: float) -> None:
    """Draw an actor nearer than it is, by an offset in the units of VTK's coincident topology."""
    mapper = actor.mapper
    mapper.SetResolveCoincidentTopologyToPolygonOffset()
    mapper.SetRelativeCoincidentTopologyPolygonOffsetParameters(0.0, units)
    mapper.SetRelativeCoincidentTopologyLineOffsetParameters(0.0, units)
    mapper.SetRelativeCoincidentTopologyPointOffsetParameter(units)


def hatch(actor: Any) -> None:
    """Draw strokes of an actor alone, diagonal and equally far apart from any point of view."""
    code = f"if (mod(gl_FragCoord.x + gl_FragCoord.y, {PERIOD}.0) >= {STROKE}.0) discard;"
    light = "//VTK::Light::Impl"
    shader = actor.GetShaderProperty()
    shader.AddFragmentShaderReplacement(light, True, f"{code}\n{light}", False)


def light_plainly(actor: Any) -> None:
    """Light an actor that has no specular part by the view's lights without highlights.

    The picture is the same; VTK's own shader computes a highlight of each light at every pixel
    nevertheless, which doubles the time of the membrane with software rendering.
    """
    shares = []
    for position, intensity in LIGHTS:
        towards = ", ".join(f"{x:.9g}" for x in np.array(position) / np.linalg.norm(position))
        shares.append(f"{intensity:.9g} * max(0.0, dot(normalVCVSOutput, vec3({towards})))")
    code = f"fragOutput0 = vec4(ambientColor + ({' + '.join(shares)}) * diffuseColor, opacity);"
    actor.GetShaderProperty().AddFragmentShaderReplacement("//VTK::Light::Impl", True, code, False)
