"""The measured points, coloured by residual, by patch membership, or plain."""

from __future__ import annotations

import numpy as np
import pyvista as pv

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.result import Result
from bubbleviz.sensor import Sensor
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.colour_bar import ColourBar
from bubbleviz_ui.view3d.colour_maps import lookup_table, residual_colours, rgb
from bubbleviz_ui.view3d.layers.layer import Canvas, Layer, Picture

CHUNK = 1024
"""The buffers change in steps, so a few points more or less change no array's size."""

DOT, BALL = 2, 3
"""Size of a point that is flat, and of one that is shaded, px."""
SPARSE = 0.5
"""With fewer than this share of the points that may be drawn, flat ones are a pixel larger."""


class CloudLayer(Layer):
    """Point cloud in buffers with some room; spare points repeat the last one."""

    name, cut = "cloud", True
    RESIDUAL = "residual"
    COLOUR = "colour"

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        view = canvas.view
        self._poly = pv.PolyData(np.zeros((1, 3)))
        self._table = lookup_table(residual_colours(theme.of(view).cloud))
        self._reserve(CHUNK)
        actor = self.add(
            self._poly,
            scalars=self.RESIDUAL,
            cmap=self._table,
            point_size=BALL if view.quality.round_points else DOT,
            show_scalar_bar=False,
            interpolate_before_map=False,
            **view.quality.points,
        )
        actor.ForceOpaqueOn()  # else VTK draws the points in its costly translucent pass
        self._bar = ColourBar(view, self._table, "residual", upper=False)
        view.follow_theme(self._take_colours)

    def set_sensor(self, sensor: Sensor, mesh: MembraneMesh) -> None:
        """Put the points of the old sensor away."""
        self._poly.points[:] = 0.0

    def draw(self, picture: Picture) -> None:
        """Write the points and their colours into the buffers."""
        result = picture.result
        if result.cloud_m is None or len(result.cloud_m) == 0:
            self._has(False)
            return
        self._reserve(len(result.cloud_m))
        _fill(self._poly.points, result.cloud_m)
        if not self.canvas.view.quality.round_points:
            sparse = len(result.cloud_m) < SPARSE * (picture.choices.cloud_points or 0)
            self.actor.prop.point_size = DOT + 1 if sparse else DOT
        by_residual = picture.choices.cloud_colour == "residual"
        if by_residual and result.cloud_residual_m is not None:
            self._colour_by_residual(result.cloud_residual_m, picture.ranges.residual_m)
        else:
            self._colour(result if picture.choices.cloud_colour == "patch" else None)
        self._poly.Modified()
        self._has(True)
        self._bar.set_visible(self._visible and by_residual)

    def set_visible(self, visible: bool) -> None:
        """Show or hide the points and their bar."""
        super().set_visible(visible)
        self._bar.set_visible(visible)

    def _take_colours(self, colours: theme.Colours) -> None:
        self._plain = colours.cloud
        self._table.values = residual_colours(colours.cloud)

    def _colour_by_residual(self, residual_m: np.ndarray, high_m: float) -> None:
        unit = self.canvas.units.length
        high = unit.of(high_m)
        _fill(self._poly.point_data[self.RESIDUAL], unit.of(1.0) * residual_m)
        self._bar.set_range(-high, high, unit)
        self.actor.mapper.scalar_range = (-high, high)
        self._use(self.RESIDUAL, direct=False)

    def _colour(self, patch_of: Result | None) -> None:
        """Colour all points alike but those of a result's patch."""
        colours = self._poly.point_data[self.COLOUR]
        colours[:] = rgb(self._plain)
        patch = patch_of.patch if patch_of is not None else None
        pixels = patch_of.cloud_pixels if patch_of is not None else None
        if patch is not None and patch.pixel_mask is not None and pixels is not None:
            inside = patch.pixel_mask.ravel()[pixels]
            colours[: len(inside)][inside] = rgb(theme.PATCH_POINT)
        self._use(self.COLOUR, direct=True)

    def _use(self, array: str, *, direct: bool) -> None:
        mapper = self.actor.mapper
        mapper.SelectColorArray(array)
        mapper.SetColorModeToDirectScalars() if direct else mapper.SetColorModeToMapScalars()

    def _reserve(self, count: int) -> None:
        size = -(-count // CHUNK) * CHUNK
        if size <= self._poly.n_points <= size + 2 * CHUNK:
            return
        self._poly.point_data.clear()
        self._poly.points = np.zeros((size, 3), np.float32)
        self._poly.verts = np.insert(np.arange(size), 0, size)
        self._poly.point_data[self.RESIDUAL] = np.zeros(size, np.float32)
        self._poly.point_data[self.COLOUR] = np.zeros((size, 3), np.uint8)


def _fill(buffer: np.ndarray, values: np.ndarray) -> None:
    """Write values into the head of a buffer and repeat the last in the rest."""
    buffer[: len(values)] = values
    buffer[len(values) :] = values[-1]
