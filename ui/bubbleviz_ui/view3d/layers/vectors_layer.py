"""Contact pressure as lines that end on the membrane, as long as the pressure is high."""

from __future__ import annotations

import numpy as np
import pyvista as pv

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.sensor import Sensor
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.layers.drawn_surface import pairs
from bubbleviz_ui.view3d.layers.layer import Canvas, Layer, Picture

LONGEST = 0.5
"""Line at the end of the pressure scale, in heights of the dome."""


class VectorsLayer(Layer):
    """One line a node, along its normal; of no length where there is no pressure."""

    name, cut = "vectors", True

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._longest_m = 0.02
        self._poly = pv.PolyData(np.zeros((2, 3)), lines=[2, 0, 1])
        lines = self.add(self._poly, color=theme.ORANGE, line_width=2, lighting=False)
        lines.SetPickable(False)

    def set_sensor(self, sensor: Sensor, mesh: MembraneMesh) -> None:
        """Take the number of nodes and the size of another sensor."""
        self._longest_m = LONGEST * float(np.ptp(mesh.nodes[:, 2]))
        self._poly.points = np.repeat(mesh.nodes, 2, axis=0)
        self._poly.lines = pairs(len(mesh.nodes))

    def draw(self, picture: Picture) -> None:
        """Place the lines; nothing without an estimate."""
        if picture.shape is None:
            return
        shape = picture.shape
        share = shape.pressure_pa / picture.ranges.pressure_pa
        ends = shape.nodes_m + (self._longest_m * share)[:, None] * shape.normals
        self._poly.points[0::2] = ends
        self._poly.points[1::2] = shape.nodes_m
        self._poly.GetPoints().Modified()
        self._poly.Modified()
