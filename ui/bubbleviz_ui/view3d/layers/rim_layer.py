"""The rim: where the membrane is clamped."""

from __future__ import annotations

import pyvista as pv
from vtkmodules.vtkFiltersCore import vtkFeatureEdges

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.sensor import Sensor
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.layers.drawn_surface import Surface
from bubbleviz_ui.view3d.layers.layer import Picture
from bubbleviz_ui.view3d.render_view import View


class RimLayer:
    """Open boundary of the displayed surface."""

    def __init__(self, view: View, surface: Surface) -> None:
        edges = vtkFeatureEdges()
        edges.SetInputData(surface.poly)
        edges.BoundaryEdgesOn()
        edges.FeatureEdgesOff()
        edges.NonManifoldEdgesOff()
        edges.ManifoldEdgesOff()
        edges.ColoringOff()
        self._edges = edges
        self._surface = surface
        self._line = pv.PolyData()
        self._actor = view.add_mesh(
            pv.PolyData([[0.0, 0.0, 0.0]]),
            color=theme.of(view).rim,
            line_width=3,
            lighting=False,
            reset_camera=False,
            render=False,
        )
        self._own: str | None = None
        self._themes = theme.of(view).rim
        view.follow_theme(self._take_colours)

    def set_sensor(self, sensor: Sensor, mesh: MembraneMesh) -> None:
        """Find the boundary of the new mesh; it is clamped, so once is enough."""
        self._edges.Update()
        self._line = pv.wrap(self._edges.GetOutput()).copy()
        self._line.clear_data()
        self._actor.mapper.SetInputData(self._line)

    def paint(self, colour: str | None) -> None:
        """Take a sensor's own colour; None: the theme's."""
        self._own = colour
        self._actor.prop.color = colour or self._themes

    def _take_colours(self, colours: theme.Colours) -> None:
        self._themes = colours.rim
        self.paint(self._own)

    def draw(self, picture: Picture) -> None:
        """Nothing: the rim does not move."""

    def set_visible(self, visible: bool) -> None:
        """Show or hide."""
        self._actor.visibility = visible
