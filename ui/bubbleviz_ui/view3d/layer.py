"""Base class of the 3-D layers, and the displayed surface they share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pyvista as pv
from vtkmodules.vtkCommonExecutionModel import vtkAlgorithm
from vtkmodules.vtkRenderingCore import vtkPolyDataMapper

from bubbleviz.membrane import MembraneMesh, level_line, midway
from bubbleviz.result import Estimate, Patch, Result
from bubbleviz.sensor import Sensor
from bubbleviz_ui.model.settings import Settings
from bubbleviz_ui.model.units import Units
from bubbleviz_ui.view3d.colours import Ranges
from bubbleviz_ui.view3d.render_view import LIGHTS, View
from bubbleviz_ui.view3d.text import ColourBar

# The displayed surface: one VTK mesh shared by membrane, wireframe, contour and rim.


class Surface:
    """The membrane as a VTK mesh, whose arrays are changed in place."""

    PRESSURE = "contact pressure"

    def __init__(self, units: Units) -> None:
        self._units = units
        self.height_m = 0.0  # Of the dome at rest
        self._mesh: MembraneMesh | None = None
        # Nodes in B, m; point data `PRESSURE` in displayed units
        self.poly = pv.PolyData(np.eye(3), np.array([3, 0, 1, 2]))
        self._make_arrays(np.eye(3), np.eye(3))

    def set_mesh(self, mesh: MembraneMesh) -> None:
        """Set the reference mesh of another sensor."""
        self._mesh, self._true_m = mesh, mesh.nodes
        self.height_m = float(np.ptp(mesh.nodes[:, 2]))
        self.poly.point_data.clear()
        self.poly.points = mesh.nodes
        self.poly.faces = cells(mesh.triangles)
        self._make_arrays(mesh.nodes, mesh.normals)

    def _make_arrays(self, nodes: np.ndarray, normals: np.ndarray) -> None:
        """Create the arrays that are changed in place."""
        self.poly.points = nodes.astype(float)
        self.poly.point_data["Normals"] = normals.astype(float)
        self.poly.point_data[self.PRESSURE] = np.zeros(len(nodes))
        self.poly.GetPointData().SetActiveNormals("Normals")
        self.poly.GetPointData().SetActiveScalars(self.PRESSURE)
        self._points, self._normals = self.poly.points, self.poly.point_data["Normals"]
        self._pressure = self.poly.point_data[self.PRESSURE]

    @property
    def nodes_m(self) -> np.ndarray:
        """Drawn nodes (n, 3) in B."""
        return np.asarray(self._points)

    @property
    def normals(self) -> np.ndarray:
        """Drawn normals (n, 3) in B."""
        return np.asarray(self._normals)

    def true_point(self, triangle: int, barycentric: np.ndarray) -> np.ndarray:
        """Position (3,) in B, without exaggeration, of a place of the drawn surface."""
        assert self._mesh is not None
        point: np.ndarray = barycentric @ self._true_m[self._mesh.triangles[triangle]]
        return point

    def draw(self, estimate: Estimate, exaggeration: float) -> None:
        """Draw an estimate with exaggerated displacement: update the arrays in place."""
        assert self._mesh is not None
        self._true_m = self._mesh.deformed(estimate.motion_m)
        nodes = self._mesh.deformed(exaggeration * estimate.motion_m)
        self._points[:] = nodes
        self._normals[:] = replace(self._mesh, nodes=nodes).normals
        self._pressure[:] = self._units.pressure.from_si(1.0) * estimate.contact_pressure_pa
        self.poly.Modified()

    def edge(
        self, estimate: Estimate | None, patch: Patch, levels: tuple[float, ...] = (0.0,)
    ) -> np.ndarray:
        """Segments (k, 2, 3) of the drawn level lines of a patch."""
        fine = None if estimate is None or patch.fine_level is None else estimate.fine
        if fine is None or patch.fine_level is None:
            return self.line(patch.level, levels)
        nodes = midway(self.nodes_m, fine.ends)
        return self._lines(nodes, fine.mesh.corners, patch.fine_level, levels)

    def line(self, field: np.ndarray, levels: tuple[float, ...] = (0.0,)) -> np.ndarray:
        """Segments (k, 2, 3) of the drawn level lines of a field (n,)."""
        if self._mesh is None:
            return np.empty((0, 2, 3))
        return self._lines(self.nodes_m, self._mesh.corners, field, levels)

    @staticmethod
    def _lines(
        nodes: np.ndarray, corners: np.ndarray, field: np.ndarray, levels: tuple[float, ...]
    ) -> np.ndarray:
        lines = [level_line(nodes, corners, field, level) for level in levels]
        return np.concatenate([np.empty((0, 2, 3)), *lines])


def cells(points: np.ndarray) -> np.ndarray:
    """VTK cell array of k cells with m points each (k, m): triangles, lines or vertices."""
    return np.insert(points, 0, points.shape[1], axis=1).ravel()


@dataclass(frozen=True)
class Canvas:
    """View, surface and units shared by the layers of a sensor."""

    view: View
    surface: Surface
    units: Units


@dataclass(frozen=True)
class Picture:
    """A result with everything needed to draw it."""

    result: Result
    ranges: Ranges
    settings: Settings
    final: bool  # Its numbers are final


class Layer:
    """A layer of the 3-D view. Its actors are created once and live as long as the view."""

    kinds: ClassVar[dict[str, type[Layer]]] = {}  # All classes by name
    name = ""  # Of `registry.LAYERS`
    clipped = False  # Clipped by the section plane

    def __init_subclass__(cls) -> None:
        """Make the class that of its name."""
        if cls.name:
            Layer.kinds[cls.name] = cls

    def __init__(self, canvas: Canvas) -> None:
        self.canvas = canvas
        self.actors: list[Any] = []  # Main one first
        self.bar: ColourBar | None = None
        self._visible, self._drawn = True, True

    @property
    def actor(self) -> Any:
        return self.actors[0]

    def add(self, data: Any, **look: Any) -> Any:
        """Add an actor that is visible with the layer; arguments as of `new_actor`."""
        actor = new_actor(self.canvas.view, data, **look)
        self.actors.append(actor)
        return actor

    def set_sensor(self, sensor: Sensor, mesh: MembraneMesh) -> None:
        """Set the geometry of another sensor."""

    def draw(self, picture: Picture) -> None:
        """Draw a result in place; called only while the layer is visible."""

    def set_visible(self, visible: bool) -> None:
        """Show or hide, with the colour bar."""
        self._visible = visible
        if self.bar is not None:
            self.bar.set_visible(visible)
        self._update()

    def _set_drawn(self, something: bool) -> None:
        """Hide the actors if there is nothing to draw."""
        self._drawn = something
        self._update()

    def _update(self) -> None:
        for actor in self.actors:
            actor.SetVisibility(self._visible and self._drawn)


class LinesLayer(Layer):
    """A layer of lines on the membrane."""

    clipped = True
    looks: tuple[tuple[str, float, int], ...]  # Colour, see `draw_in_front`, and width of each kind

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._lines = [Segments(self, c, front, line_width=width) for c, front, width in self.looks]
        self._set_drawn(False)

    def draw(self, picture: Picture) -> None:
        lines = self.lines(picture)
        if lines:
            for segments, ends in zip(self._lines, lines, strict=True):
                segments.draw(ends)
        self._set_drawn(bool(lines))

    def lines(self, picture: Picture) -> Sequence[np.ndarray]:
        """Ends (k, 2, 3) in B of the lines of each kind; empty if there are none."""
        raise NotImplementedError


CHUNK = 256
"""Line buffers grow in this step, as VTK is slower when the number of lines changes."""


class Segments:
    """Line segments of a layer, in a buffer whose unused segments have zero length."""

    def __init__(self, layer: Layer, colour: str, in_front: float = 0.0, **look: float) -> None:
        self._poly = pv.PolyData()
        self._reserve(1)
        self.actor = layer.add(self._poly, color=colour, lighting=False, **look)
        if in_front:
            draw_in_front(self.actor, in_front)

    def draw(self, pieces: np.ndarray) -> None:
        """Replace the segments by (k, 2, 3) in B."""
        self._reserve(len(pieces))
        ends = pieces.reshape(-1, 3)
        self._ends[: len(ends)] = ends
        self._ends[len(ends) :] = ends[-1] if len(ends) else self._ends[0]
        self._poly.Modified()

    def _reserve(self, count: int) -> None:
        room = -(-max(count, 1) // CHUNK) * CHUNK
        if 2 * room > self._poly.n_points:
            self._poly.points = np.zeros((2 * room, 3))
            self._poly.lines = cells(np.arange(2 * room).reshape(room, 2))
            self._ends = self._poly.points


def new_actor(
    view: View,
    data: Any,  # Polygonal data, or a VTK algorithm that makes it
    *,
    scalars: str = "",  # Point array that colours it: RGB bytes, or values of a table
    table: Any = None,  # VTK lookup table
    **look: Any,  # Arguments of `pyvista.Property`
) -> Any:
    """Add an actor to the view.

    `pyvista.Plotter.add_mesh` takes a hundred times as long, and inserts a Python algorithm that
    runs with every render.
    """
    mapper = vtkPolyDataMapper()
    if isinstance(data, vtkAlgorithm):
        mapper.SetInputConnection(data.GetOutputPort())
    else:
        mapper.SetInputDataObject(data)
    mapper.SetScalarVisibility(bool(scalars))
    mapper.SetScalarModeToUsePointFieldData()
    mapper.SelectColorArray(scalars)
    mapper.SetLookupTable(table)
    actor = pv.Actor(mapper=mapper, prop=pv.Property(**look))
    view.renderer.AddActor(actor)
    return actor


def across(axis: np.ndarray) -> np.ndarray:
    """A unit vector (3,) across another one."""
    side = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    unit: np.ndarray = side / np.linalg.norm(side)
    return unit


def add_mark(view: View, data: Any, units: float = -6000.0, **look: Any) -> Any:
    """Add an actor that is drawn in front of others."""
    actor = new_actor(view, data, **look)
    draw_in_front(actor, units)
    return actor


def draw_in_front(actor: Any, units: float) -> None:
    """Shift the depth of an actor towards the camera, in units of VTK's coincident topology."""
    mapper = actor.mapper
    mapper.SetResolveCoincidentTopologyToPolygonOffset()
    mapper.SetRelativeCoincidentTopologyPolygonOffsetParameters(0.0, units)
    mapper.SetRelativeCoincidentTopologyLineOffsetParameters(0.0, units)
    mapper.SetRelativeCoincidentTopologyPointOffsetParameter(units)


def light_without_highlights(actor: Any) -> None:
    """Replace the lighting shader of an actor without specular reflection.

    The picture is the same; VTK's own shader computes a highlight of each light at every pixel
    anyway, which doubles the render time of the membrane on a CPU.
    """
    shares = []
    for position, intensity in LIGHTS:
        towards = ", ".join(f"{x:.9g}" for x in np.array(position) / np.linalg.norm(position))
        shares.append(f"{intensity:.9g} * max(0.0, dot(normalVCVSOutput, vec3({towards})))")
    code = f"fragOutput0 = vec4(ambientColor + ({' + '.join(shares)}) * diffuseColor, opacity);"
    actor.GetShaderProperty().AddFragmentShaderReplacement("//VTK::Light::Impl", True, code, False)
