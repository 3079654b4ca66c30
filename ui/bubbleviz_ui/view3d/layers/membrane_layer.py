"""The membrane, coloured by contact pressure; neutral where nothing touches it."""

from __future__ import annotations

from typing import Any

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.sensor import Sensor
from bubbleviz_ui.model.choices import COLOUR_MAPS
from bubbleviz_ui.model.units import Units
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.colour_bar import ColourBar
from bubbleviz_ui.view3d.colour_maps import pressure_colours, pressure_map
from bubbleviz_ui.view3d.layers.drawn_surface import Surface
from bubbleviz_ui.view3d.layers.layer import Picture
from bubbleviz_ui.view3d.render_view import View


class MembraneLayer:
    """The deformed surface with a colour bar in the operator's pressure unit."""

    def __init__(self, view: View, surface: Surface, units: Units) -> None:
        self._surface = surface
        self._units = units
        self._table, self._map = pressure_map(), COLOUR_MAPS[0]
        self.actor = view.add_mesh(
            surface.poly,
            scalars=surface.PRESSURE,
            cmap=self._table,
            show_scalar_bar=False,
            smooth_shading=False,
            ambient=0.25,
            diffuse=0.75,
            specular=0.15,
            specular_power=25,
            reset_camera=False,
            render=False,
        )
        surface.shade(self.actor)
        self._bar = ColourBar(view, self._table, "contact pressure", bottom=0.53)

    def set_sensor(self, sensor: Sensor, mesh: MembraneMesh) -> None:
        """Nothing: the surface is shared."""

    def draw(self, picture: Picture) -> None:
        """Take the colour range and the opacity; the surface itself is shared."""
        high = self._units.pressure.of(picture.ranges.pressure_pa)
        self._bar.set_range(0.0, high, self._units.pressure)
        self.actor.mapper.scalar_range = (0.0, high)
        self.actor.prop.opacity = picture.choices.membrane_opacity
        if picture.choices.colour_map != self._map:
            self._map = picture.choices.colour_map
            self._table.values = pressure_colours(self._map)

    def set_visible(self, visible: bool) -> None:
        """Show or hide the surface and its bar."""
        self.actor.visibility = visible
        self._bar.set_visible(visible)


class WireframeLayer:
    """The edges of the mesh."""

    def __init__(self, view: View, surface: Surface) -> None:
        self.actor: Any = view.add_mesh(
            surface.poly,
            style="wireframe",
            color=theme.WIREFRAME,
            line_width=1,
            lighting=False,
            reset_camera=False,
            render=False,
        )
        lift(self.actor)

    def set_sensor(self, sensor: Sensor, mesh: MembraneMesh) -> None:
        """Nothing: the surface is shared."""

    def draw(self, picture: Picture) -> None:
        """Nothing: the surface is shared."""

    def set_visible(self, visible: bool) -> None:
        """Show or hide."""
        self.actor.visibility = visible


def lift(actor: Any, units: float = -60.0) -> None:
    """Draw lines that lie on the membrane in front of it."""
    mapper = actor.mapper
    mapper.SetResolveCoincidentTopologyToPolygonOffset()
    mapper.SetRelativeCoincidentTopologyLineOffsetParameters(0.0, units)
