"""Contact traction as arrows: its normal and its tangential part, in two colours on one scale."""

from __future__ import annotations

import numpy as np
import pyvista as pv

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.sensor import Sensor
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.layers.layer import Canvas, Layer, Picture, in_front

LONGEST = 0.5
"""Arrow at the end of the pressure scale, in heights of the dome."""
HEAD = (-0.25, 0.12)
"""Where a barb of an arrow ends, from its point: back along it and aside, in its lengths."""


class TractionLayer(Layer):
    """Arrows at the nodes that are touched; nothing where no traction is known.

    The normal part ends on the membrane, as it presses; the tangential one begins there.
    """

    name, cut = "traction", True

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._longest_m = 0.02
        self._arrows = tuple(_empty() for _ in range(2))
        for poly, colour in zip(self._arrows, (theme.ORANGE, theme.BLUE), strict=True):
            lines = self.add(poly, color=colour, line_width=3, lighting=False)
            lines.SetPickable(False)
            in_front(lines, -120.0)

    def set_sensor(self, sensor: Sensor, mesh: MembraneMesh) -> None:
        """Take the size of another sensor."""
        self._longest_m = LONGEST * float(np.ptp(mesh.nodes[:, 2]))

    def draw(self, picture: Picture) -> None:
        """Draw the traction of a result."""
        traction, shape = picture.result.traction, picture.shape
        known = traction is not None and traction.status in ("ok", "depth_alone")
        self._has(known)
        if traction is None or shape is None or not known:
            return
        touched = np.flatnonzero(traction.nodal_force_n.any(axis=1))
        scale = self._longest_m / picture.ranges.pressure_pa
        normal, along = (scale * part[touched] for part in traction.parts_pa)
        nodes, normals = shape.nodes_m[touched], shape.normals[touched]
        if traction.status == "depth_alone":
            along = along[:0]
        _put(self._arrows[0], nodes - normal, normal, np.roll(normals, 1, axis=1))
        _put(self._arrows[1], nodes[: len(along)], along, normals[: len(along)])


def _empty() -> pv.PolyData:
    return pv.PolyData(np.zeros((2, 3)), lines=[2, 0, 1])


def _put(poly: pv.PolyData, starts: np.ndarray, ways: np.ndarray, across: np.ndarray) -> None:
    """Make arrows (k, 3), their barbs in the plane across a direction (k, 3)."""
    if not len(starts):
        poly.copy_from(_empty())
        return
    ends, aside = starts + ways, np.cross(across, ways)
    back = ends + HEAD[0] * ways
    points = np.stack([starts, ends, back + HEAD[1] * aside, ends, back - HEAD[1] * aside], axis=1)
    count = len(starts)
    pairs = 5 * np.arange(count)[:, None, None] + np.array([[0, 1], [1, 2], [3, 4]])
    lines = np.concatenate([np.full((count, 3, 1), 2), pairs], axis=2)
    new = pv.PolyData(points.reshape(-1, 3), lines=lines.ravel())
    poly.copy_from(new)
