"""The rim: where the membrane is clamped."""

from __future__ import annotations

import pyvista as pv

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.sensor import Sensor
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.layers.layer import Canvas, Layer


class RimLayer(Layer):
    """Open boundary of the displayed surface."""

    name = "rim"

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self.add(pv.PolyData([[0.0, 0.0, 0.0]]), line_width=3, lighting=False)
        self._own: str | None = None
        canvas.view.follow_theme(self._take_colours)

    def set_sensor(self, sensor: Sensor, mesh: MembraneMesh) -> None:
        """Find the boundary of the new mesh; it is clamped, so once is enough."""
        rim = self.canvas.surface.poly.extract_feature_edges(
            boundary_edges=True,
            non_manifold_edges=False,
            feature_edges=False,
            manifold_edges=False,
            clear_data=True,
        )
        self.actor.mapper.SetInputData(rim)

    def paint(self, colour: str | None) -> None:
        """Take a sensor's own colour; None: the theme's."""
        self._own = colour
        self.actor.prop.color = colour or self._themes

    def _take_colours(self, colours: theme.Colours) -> None:
        self._themes = colours.rim
        self.paint(self._own)
