"""The scene: all 3-D layers of one or more sensors, and the camera."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import TypeVar

import numpy as np
from vtkmodules.vtkCommonMath import vtkMatrix4x4
from vtkmodules.vtkRenderingCore import vtkAssembly, vtkProp3D

from bubbleviz.camera import DepthCamera
from bubbleviz.diagnostics import Probed
from bubbleviz.membrane import MembraneMesh, build_mesh
from bubbleviz.output import ComparedResult
from bubbleviz.result import Result
from bubbleviz.sensor import Sensor
from bubbleviz_ui.engine.source import NO_SOURCE
from bubbleviz_ui.model.frame_history import FrameHistory
from bubbleviz_ui.model.registry import LAYERS
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.settings import Settings
from bubbleviz_ui.model.units import Units
from bubbleviz_ui.view3d.colours import Scales
from bubbleviz_ui.view3d.contact_layers import ComparedLayer, ReadoutLayer
from bubbleviz_ui.view3d.layer import Canvas, Layer, Picture, Surface
from bubbleviz_ui.view3d.object_layers import FitLayer, ObjectLayer
from bubbleviz_ui.view3d.render_view import View
from bubbleviz_ui.view3d.sensor_layers import RimLayer
from bubbleviz_ui.view3d.text import MIN_HEIGHT, WIDTH, ColourBar
from bubbleviz_ui.view3d.tools import (
    DIRECTIONS,
    Callout,
    Picker,
    Section,
    Viewpoint,
    look_along,
    look_through,
)

# The layers of one sensor.


L = TypeVar("L", bound=Layer)


class DrawnLayers:
    """The layers of one sensor. Actors are created once; a result changes arrays in place."""

    def __init__(
        self,
        view: View,
        units: Units,
        scales: Scales,
        names: frozenset[str] = frozenset(LAYERS),  # Layers to create
    ) -> None:
        self.surface, self._scales = Surface(units), scales
        canvas = Canvas(view, self.surface, units)
        self.by_name = {name: Layer.kinds[name](canvas) for name in LAYERS if name in names}
        for layer in self.by_name.values():
            layer.set_visible(False)  # until there is a result
        self.picture: Picture | None = None  # Drawn last
        view.rendering.connect(self._update_scale)

    def set_sensor(self, sensor: Sensor, mesh: MembraneMesh) -> None:
        self.hide()
        self.surface.set_mesh(mesh)
        for layer in self.by_name.values():
            layer.set_sensor(sensor, mesh)

    def draw(
        self, result: Result, settings: Settings, history: FrameHistory, *, final: bool = True
    ) -> None:
        """Draw a result, with scales for all frames of its history."""
        self._scales.show(self, history, result)
        self._draw(Picture(result, self._scales.of(settings), settings, final))

    def hide(self) -> None:
        """Remove the picture, and its influence on the scales."""
        self.picture = None
        self._scales.forget(self)

    @property
    def rescaled(self) -> bool:
        """Whether another frame or sensor has changed the scales since it was drawn."""
        drawn = self.picture
        return drawn is not None and drawn.ranges != self._scales.of(drawn.settings)

    def _update_scale(self) -> None:
        drawn = self.picture
        if drawn is not None and self.rescaled:
            self._draw(replace(drawn, ranges=self._scales.of(drawn.settings)))

    def _draw(self, picture: Picture) -> None:
        settings, estimate = picture.settings, picture.result.estimate
        on_it = any(each.clipped for name, each in self.by_name.items() if name in settings.layers)
        if on_it and estimate is not None:
            self.surface.draw(estimate, settings.exaggeration)
        self.picture = picture
        for name, layer in self.by_name.items():
            layer.set_visible(name in settings.layers)
            if name in settings.layers:
                layer.draw(picture)

    def layer(self, kind: type[L]) -> L:
        layer = self.by_name[kind.name]
        assert isinstance(layer, kind)
        return layer


MARGIN = 1.0
"""Margin around the membrane for layers outside it, in diagonals of its bounding box."""
SAME_SIZE = 0.1
"""Relative difference in size up to which a view of one membrane also suits another; chosen."""


class Scene:
    """Draws the results of a sensor in the view, and moves the camera."""

    def __init__(self, view: View, state: SessionState) -> None:
        self._view, self._state = view, state
        self.scales = Scales(state.units)
        self._drawn = DrawnLayers(view, state.units, self.scales)
        self.layers = self._drawn.by_name
        self._surface = self._drawn.surface
        self.object, self.fit = self._drawn.layer(ObjectLayer), self._drawn.layer(FitLayer)
        self._T_W_B = np.eye(4)
        self._others: list[OtherSensor] = []
        self._others_m = np.empty((0, 3))
        self._placed: tuple[object, ...] | None = None
        self._mesh: MembraneMesh | None = None
        self._sensor: Sensor | None = None
        self._bounds = [-1.0, 1.0, -1.0, 1.0, -1.0, 1.0]
        self._hovered = Callout(view, state.units)
        self.callout = Callout(view, state.units)  # Of clicks
        view.pointer_props += self._hovered.actors
        cut = [actor for layer in self.layers.values() if layer.clipped for actor in layer.actors]
        self.section = Section(view, self._surface, cut)
        self._picker = Picker(view, self._surface, self.layers)
        self.depth_camera: DepthCamera | None = None
        view.resized.connect(self._fit_unless_moved)
        view.setMinimumSize(2 * WIDTH, MIN_HEIGHT)

    def set_sensor(self, sensor: Sensor, mesh: MembraneMesh) -> None:
        """Set another sensor; a camera moved by the user stays if the membrane is as large."""
        before, self._mesh, self._sensor = self._mesh, mesh, sensor
        self._bounds = _bounds(mesh, sensor, self._others_m)
        self._drawn.set_sensor(sensor, mesh)
        self.scales.set_sensor(sensor)
        alone = not len(self._others_m)  # of two sensors, both stay in view
        old_m, new_m = (np.ptp(each.nodes, axis=0) for each in (before or mesh, mesh))
        if alone and not np.allclose(old_m, new_m, rtol=SAME_SIZE):  # another inflation level
            self.reset_view()
        else:
            self._fit_unless_moved()

    @property
    def moved_by_user(self) -> bool:
        """Whether the user has moved the camera away from the scene's viewpoint."""
        return self._placed is not None and self._placed != self._camera_place()

    def reset_view(self) -> None:
        """Show the whole membrane from the scene's viewpoint."""
        if self._mesh is None:
            return
        seen, R_B_W = np.vstack([self._mesh.nodes, self._others_m]), self._T_W_B[:3, :3].T
        settings = self._state.settings
        towards, up = R_B_W @ settings.view_from, R_B_W[:, 2]
        look_along(self._view, towards, up, seen, settings.zoom)
        self._placed = self._camera_place()
        self._view.renderer.ResetCameraClippingRange(self._bounds)
        self._view.refresh()

    def add_sensor(self) -> OtherSensor:
        """Another sensor, to be put into the world."""
        other = OtherSensor(self._view, self._state.units, self.scales)
        self._others.append(other)
        return other

    def place(
        self, T_W_B: np.ndarray | None = None, colour: str | None = None, name: str = ""
    ) -> None:
        """Set the sensor's pose in the world, by default its origin, and its colour and name.

        The other sensors are placed around it. The initial view has the world's z up and contains
        them, too.
        """
        self._T_W_B = np.eye(4) if T_W_B is None else T_W_B
        placed = [other.place_in(self._T_W_B) for other in self._others]
        self._others_m = np.vstack([np.empty((0, 3)), *placed])
        self._drawn.layer(RimLayer).paint(colour)
        self._drawn.layer(ReadoutLayer).sensor = name
        if self._mesh is not None and self._sensor is not None:
            self._bounds = _bounds(self._mesh, self._sensor, self._others_m)

    def move_camera(self, T: np.ndarray) -> None:
        """Keep the view after a change of frame B; T maps old to new coordinates."""
        camera, R, t = self._view.camera, T[:3, :3], T[:3, 3]
        camera.position = tuple(R @ camera.position + t)
        camera.focal_point = tuple(R @ camera.focal_point + t)
        camera.up = tuple(R @ camera.up)
        self._view.renderer.ResetCameraClippingRange(self._bounds)
        self._view.refresh()

    def show(self, result: Result) -> None:
        state = self._state
        self.section.apply(state.settings)
        self._drawn.draw(result, state.settings, state.history, final=state.final)
        # known bounds, as VTK would compute them from every point of every layer
        self._view.renderer.ResetCameraClippingRange(self._bounds)
        self._view.refresh()

    def show_at_rest(self, sensor: Sensor) -> None:
        """Draw the membrane at rest, before a source is open."""
        self.set_sensor(sensor, build_mesh(sensor))
        self.show(Result(NO_SOURCE.open(sensor)[0]))

    def compare(self, measured: tuple[ComparedResult | str | None, ...]) -> None:
        """Draw the outlines of compared settings while their frame is shown."""
        self._drawn.layer(ComparedLayer).measured = measured
        self.redraw()

    def set_outdated(self, outdated: bool) -> None:
        """Dim the numbers while the live source sends no new frames."""
        self._drawn.layer(ReadoutLayer).set_outdated(outdated)
        self._view.refresh()

    def redraw(self) -> None:
        """Redraw the last result, with other settings."""
        self._hovered.write()
        if self._drawn.picture is not None:
            self.show(self._drawn.picture.result)

    def follow_scales(self) -> None:
        """Redraw if the scales have changed."""
        if self._drawn.rescaled:
            self._view.refresh()

    def look_from(self, name: Viewpoint) -> None:
        """Move the camera to a named viewpoint."""
        if self._mesh is None or self.depth_camera is None:
            return
        low, high = self._mesh.nodes.min(axis=0), self._mesh.nodes.max(axis=0)
        if name == "camera":
            far = float(np.linalg.norm((low + high) / 2 - self.depth_camera.center))
            look_through(self._view, self.depth_camera, far)
        else:
            corners = np.array(list(product(*zip(low, high, strict=True))))
            look_along(self._view, *DIRECTIONS[name], corners)
        self._view.renderer.ResetCameraClippingRange(self._bounds)
        self._view.refresh()

    def mark(self, place: Probed | None) -> None:
        """Show the numbers of the place under the mouse, marked if the images panel is open."""
        self._show(self._hovered, place, marked="images" in self._state.settings.panels)

    def pin(self, place: Probed | None) -> None:
        """Mark a place that was clicked, with its numbers."""
        self._show(self.callout, place, marked=True)

    def _show(self, callout: Callout, place: Probed | None, *, marked: bool) -> None:
        if place is None or self.depth_camera is None:
            callout.hide()
        else:
            drawn_m, camera_m = place.interpolated(self._surface.nodes_m), self.depth_camera.center
            callout.show_place(place, drawn_m, camera_m, marked=marked)

    def bar_at(self, x: float, y: float) -> ColourBar | None:
        """Colour bar at a position of the view, or None."""
        bars = (layer.bar for layer in self.layers.values())
        return next((bar for bar in bars if bar is not None and bar.contains(x, y)), None)

    def pick(self, x: float, y: float) -> np.ndarray | None:
        """Point (3,) in B, without exaggeration, at a position of the view, or None."""
        return self._picker.at(x, y)

    def _fit_unless_moved(self) -> None:
        """Show the whole membrane, unless the user has moved the camera."""
        if not self.moved_by_user:
            self.reset_view()

    def _camera_place(self) -> tuple[object, ...]:
        camera = self._view.camera
        return (tuple(camera.position), tuple(camera.focal_point), tuple(camera.up))


def _bounds(mesh: MembraneMesh, sensor: Sensor, others_m: np.ndarray) -> list[float]:
    """Box around everything drawn: xmin, xmax, ymin, ymax, zmin, zmax, m."""
    seen = np.vstack([mesh.nodes, others_m])
    low, high = seen.min(axis=0), seen.max(axis=0)
    margin = MARGIN * float(np.linalg.norm(high - low))
    low = np.minimum(low, sensor.camera.position_m) - margin
    high = np.maximum(high, sensor.camera.position_m) + margin
    return [float(end) for pair in zip(low, high, strict=True) for end in pair]


# Other sensors: some of the same layers, placed by one matrix each.

OTHER_LAYERS = frozenset({"membrane", "contour", "cloud", "force", "rim"})


class OtherSensor:
    """Draws the results of another sensor in the view, with the scales of the scene's.

    `scales`: Those of the scene, which has the colour bars.
    """

    def __init__(self, view: View, units: Units, scales: Scales) -> None:
        self._view = view
        before = set(view.renderer.GetViewProps())
        self._drawn = DrawnLayers(view, units, scales, OTHER_LAYERS)
        made = [prop for prop in view.renderer.GetViewProps() if prop not in before]
        self._assembly = vtkAssembly()
        for prop in made:  # without the colour bars
            view.renderer.RemoveViewProp(prop)
            if isinstance(prop, vtkProp3D):
                self._assembly.AddPart(prop)
        view.renderer.AddViewProp(self._assembly)
        self._assembly.SetVisibility(False)
        self._nodes_m, self._T_W_B = np.empty((0, 3)), np.eye(4)

    def put(self, sensor: Sensor, mesh: MembraneMesh, T_W_B: np.ndarray, colour: str) -> None:
        """Set the sensor and its pose; it is visible from its next result on."""
        self._nodes_m, self._T_W_B = mesh.nodes, T_W_B
        self._assembly.SetVisibility(False)
        self._drawn.set_sensor(sensor, mesh)
        self._drawn.layer(RimLayer).paint(colour)

    def place_in(self, T_W_B: np.ndarray) -> np.ndarray:
        """Draw it in the bubble frame of the scene's sensor; returns its nodes (n, 3) there."""
        T, matrix = np.linalg.inv(T_W_B) @ self._T_W_B, vtkMatrix4x4()
        matrix.DeepCopy(T.ravel().tolist())
        self._assembly.SetUserMatrix(matrix)
        nodes_m: np.ndarray = self._nodes_m @ T[:3, :3].T + T[:3, 3]
        return nodes_m

    @property
    def visible(self) -> bool:
        return bool(self._assembly.GetVisibility())

    def show(self, result: Result, settings: Settings, history: FrameHistory) -> None:
        """Draw a result with the next render."""
        self._drawn.draw(result, settings, history)
        self._assembly.SetVisibility(True)

    def remove(self) -> None:
        self._nodes_m = np.empty((0, 3))
        self._drawn.hide()
        self._assembly.SetVisibility(False)
        self._view.refresh()
