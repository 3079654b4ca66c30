"""Layers of the sensor: axes and scale bar, camera frustum, rim, measured points."""

from __future__ import annotations

import math

import numpy as np
import pyvista as pv
from vtkmodules.vtkRenderingCore import vtkActor2D, vtkPolyDataMapper2D, vtkTextActor

from bubbleviz.camera import DepthCamera
from bubbleviz.membrane import MembraneMesh
from bubbleviz.result import Result
from bubbleviz.sensor import Camera, Sensor
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.colours import lookup_table, residual_colours, rgb
from bubbleviz_ui.view3d.layer import Canvas, Layer, Picture
from bubbleviz_ui.view3d.text import ColourBar, set_text_style

CORNER = 80
"""Side of the corner with the axes, px."""
SHARE = 0.16
"""Longest scale bar over the view's width; a video caption fits next to it."""
TICK, BOTTOM, TEXT = 5.0, 10.0, 13  # px


class AxesLayer(Layer):
    """Axes of B in a corner, and next to them a scale bar of a round length (1, 2, 5 · 10ᵏ).

    The bar is valid at the depth of the centre of rotation.
    """

    name = "axes"

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        view = canvas.view
        axes = view.add_axes(interactive=False, xlabel="x", ylabel="y", zlabel="z")
        for caption in (
            axes.GetXAxisCaptionActor2D(),
            axes.GetYAxisCaptionActor2D(),
            axes.GetZAxisCaptionActor2D(),
        ):
            set_text_style(view, caption.GetCaptionTextProperty(), TEXT)
            caption.GetTextActor().SetTextScaleModeToNone()
        self._bar = pv.PolyData(np.zeros((4, 3)), lines=[4, 0, 1, 2, 3])
        mapper = vtkPolyDataMapper2D()
        mapper.SetInputData(self._bar)
        self._line, self._label = vtkActor2D(), vtkTextActor()
        self._line.SetMapper(mapper)
        set_text_style(view, self._label.GetTextProperty(), TEXT)
        for actor in (self._line, self._label):
            view.renderer.AddViewProp(actor)
        self.actors += [axes, self._line, self._label]
        view.follow_theme(self._paint)
        view.rendering.connect(self._fit)

    def _fit(self) -> None:
        """Keep the size of the axes in pixels; choose and draw the length of the scale bar."""
        view, (width, height) = self.canvas.view, self.canvas.view.size_px
        corner = min(CORNER / width, 1.0), min(CORNER / height, 1.0)
        view.renderer.axes_widget.SetViewport(0.0, 0.0, *corner)
        half_angle = math.radians(view.camera.view_angle) / 2.0
        pixel_m = 2.0 * view.camera.distance * math.tan(half_angle) / height
        length_m = _round_length(SHARE * width * pixel_m)
        left, right, top = CORNER, CORNER + length_m / pixel_m, BOTTOM + TICK
        ends = np.array([[left, top], [left, BOTTOM], [right, BOTTOM], [right, top]])
        self._bar.points[:, :2] = np.round(view.pixel_ratio * ends)
        self._bar.Modified()
        self._line.GetProperty().SetLineWidth(2.0 * view.pixel_ratio)
        unit = self.canvas.units.length
        self._label.SetInput(f"{unit.from_si(length_m):.4g} {unit.symbol}")
        self._label.SetPosition(view.pixel_ratio * left, view.pixel_ratio * (top + 2.0))

    def _paint(self, colours: theme.Colours) -> None:
        self._line.GetProperty().SetColor(*(c / 255 for c in rgb(colours.text)))


def _round_length(most_m: float) -> float:
    """Largest of 1, 2, 5 · 10ᵏ not above a length."""
    decade = 10.0 ** math.floor(math.log10(most_m))
    return max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= most_m)


# The depth camera's field of view.

LINES = np.array([[2, 0, 1], [2, 0, 2], [2, 0, 3], [2, 0, 4], [2, 1, 2], [2, 2, 3], [2, 3, 4],
                  [2, 4, 1]])  # fmt: skip


class FrustumLayer(Layer):
    """Lines from the camera through the corners of the image, up to the membrane."""

    name = "frustum"

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._poly = pv.PolyData(np.zeros((5, 3)), lines=LINES.ravel())
        self._camera: Camera | None = None
        self._far_m = 0.1
        self._drawn_for: object = None
        lines = self.add(self._poly, line_width=1, lighting=False)
        canvas.view.follow_theme(lambda colours: setattr(lines.prop, "color", colours.frustum))

    def set_sensor(self, sensor: Sensor, mesh: MembraneMesh) -> None:
        """Set the camera and its distance to the membrane."""
        self._camera = sensor.camera
        self._far_m = float(np.linalg.norm(mesh.nodes.mean(axis=0) - sensor.camera.position_m))
        self._drawn_for = None

    def draw(self, picture: Picture) -> None:
        """Use the recording's intrinsics, if any, else the sensor's."""
        intrinsics = picture.result.frame.intrinsics
        if self._camera is None or self._drawn_for == (intrinsics or "sensor"):
            return
        self._drawn_for = intrinsics or "sensor"
        self._poly.points[:] = _corners(DepthCamera.of(self._camera, intrinsics), self._far_m)
        self._poly.Modified()


def _corners(camera: DepthCamera, far_m: float) -> np.ndarray:
    """Camera centre and image corners at a depth, (5, 3) in B."""
    slopes = camera.intrinsics.slopes()[[0, 0, -1, -1], [0, -1, -1, 0]]
    corners = np.column_stack([slopes, np.ones(4)]) * far_m
    return np.vstack([camera.center, corners @ camera.T_B_C[:3, :3].T + camera.center])


class RimLayer(Layer):
    """Rim: the clamped boundary of the membrane."""

    name = "rim"

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self.add(pv.PolyData([[0.0, 0.0, 0.0]]), line_width=3, lighting=False)
        self._own: str | None = None
        canvas.view.follow_theme(self._take_colours)

    def set_sensor(self, sensor: Sensor, mesh: MembraneMesh) -> None:
        """Extract the boundary of the new mesh, which does not move."""
        rim = self.canvas.surface.poly.extract_feature_edges(
            boundary_edges=True,
            non_manifold_edges=False,
            feature_edges=False,
            manifold_edges=False,
            clear_data=True,
        )
        self.actor.mapper.SetInputData(rim)

    def paint(self, colour: str | None) -> None:
        """Set the colour; None: the theme's."""
        self._own = colour
        self.actor.prop.color = colour or self._themes

    def _take_colours(self, colours: theme.Colours) -> None:
        self._themes = colours.rim
        self.paint(self._own)


# The measured points, coloured by residual, by patch, or uniformly.

CHUNK = 1024
"""Buffers grow in this step, so that a few points more do not reallocate them."""

DOT, BALL = 2, 3
"""Size of flat and of shaded points, px."""
SPARSE = 0.5
"""Below this share of the most points, flat ones are drawn a pixel larger."""


class CloudLayer(Layer):
    """Point cloud in buffers whose unused points repeat the last one."""

    name, clipped = "cloud", True
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
            table=self._table,
            point_size=BALL if view.quality.round_points else DOT,
            **view.quality.points,
        )
        actor.ForceOpaqueOn()  # avoids VTK's slow translucent pass
        self.bar = self._bar = ColourBar(
            view, self._table, "residual", "residual_max_m", upper=False
        )
        view.follow_theme(self._take_colours)

    def set_sensor(self, sensor: Sensor, mesh: MembraneMesh) -> None:
        """Clear the points of the previous sensor."""
        self._poly.points[:] = 0.0

    def draw(self, picture: Picture) -> None:
        """Copy points and colours into the buffers."""
        result = picture.result
        if result.cloud_m is None or len(result.cloud_m) == 0:
            self._set_drawn(False)
            return
        self._reserve(len(result.cloud_m))
        _fill(self._poly.points, result.cloud_m)
        if not self.canvas.view.quality.round_points:
            sparse = len(result.cloud_m) < SPARSE * (picture.settings.cloud_points or 0)
            self.actor.prop.point_size = DOT + 1 if sparse else DOT
        by_residual = picture.settings.cloud_colour == "residual"
        if by_residual and result.cloud_residual_m is not None:
            self._colour_by_residual(result.cloud_residual_m, picture)
        else:
            self._colour(result if picture.settings.cloud_colour == "patch" else None)
        self._poly.Modified()
        self._set_drawn(True)
        self._bar.set_visible(self._visible and by_residual)

    def _take_colours(self, colours: theme.Colours) -> None:
        self._plain = colours.cloud
        self._table.values = residual_colours(colours.cloud)

    def _colour_by_residual(self, residual_m: np.ndarray, picture: Picture) -> None:
        end_m, unit = picture.ranges.residual_m, self.canvas.units.length
        high = self._bar.set_range(end_m, unit, picture.settings, signed=True)
        _fill(self._poly.point_data[self.RESIDUAL], unit.from_si(1.0) * residual_m)
        self.actor.mapper.scalar_range = (-high, high)
        self._use(self.RESIDUAL, direct=False)

    def _colour(self, patch_of: Result | None) -> None:
        """Colour all points uniformly, except those of a result's patch."""
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
    """Copy values to the start of a buffer and fill the rest with the last one."""
    buffer[: len(values)] = values
    buffer[len(values) :] = values[-1]
