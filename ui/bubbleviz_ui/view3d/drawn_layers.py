"""The layers of one sensor, drawn together."""

from __future__ import annotations

from typing import TypeVar

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.result import Result
from bubbleviz.sensor import Sensor
from bubbleviz_ui.model.choices import Choices
from bubbleviz_ui.model.registry import LAYERS
from bubbleviz_ui.model.units import Units
from bubbleviz_ui.shear.texture_layer import TextureLayer
from bubbleviz_ui.shear.traction_layer import TractionLayer
from bubbleviz_ui.view3d.layers.axes_layer import AxesLayer
from bubbleviz_ui.view3d.layers.cloud_layer import CloudLayer
from bubbleviz_ui.view3d.layers.contour_layer import (
    ComparedLayer,
    ContourLayer,
    ObjectPatchLayer,
)
from bubbleviz_ui.view3d.layers.drawn_surface import Surface
from bubbleviz_ui.view3d.layers.fit_layer import FitLayer
from bubbleviz_ui.view3d.layers.force_layer import ForceLayer
from bubbleviz_ui.view3d.layers.frustum_layer import FrustumLayer
from bubbleviz_ui.view3d.layers.layer import Canvas, Layer, Picture
from bubbleviz_ui.view3d.layers.membrane_layer import MembraneLayer, WireframeLayer
from bubbleviz_ui.view3d.layers.object_layer import ObjectLayer
from bubbleviz_ui.view3d.layers.readout_layer import ReadoutLayer
from bubbleviz_ui.view3d.layers.rim_layer import RimLayer
from bubbleviz_ui.view3d.layers.vectors_layer import VectorsLayer
from bubbleviz_ui.view3d.render_view import View
from bubbleviz_ui.view3d.scale_ranges import HeldRanges

CLASSES: tuple[type[Layer], ...] = (
    MembraneLayer,
    TextureLayer,
    WireframeLayer,
    ContourLayer,
    ObjectPatchLayer,
    ComparedLayer,
    CloudLayer,
    ForceLayer,
    ReadoutLayer,
    FrustumLayer,
    RimLayer,
    VectorsLayer,
    TractionLayer,
    ObjectLayer,
    FitLayer,
    AxesLayer,
)
"""What draws the layers of the registry."""


L = TypeVar("L", bound=Layer)


class DrawnLayers:
    """Actors are made once; a result changes arrays in place.

    Parameters
    ----------
    view : View
    units : Units
    ranges : HeldRanges
        Scales to draw with.
    names : collection of str
        Layers to make, of the registry.

    Attributes
    ----------
    by_name : dict of Layer
    surface : Surface
        The membrane as it is drawn.
    """

    def __init__(
        self,
        view: View,
        units: Units,
        ranges: HeldRanges,
        names: frozenset[str] = frozenset(LAYERS),
    ) -> None:
        self.surface, self._ranges = Surface(units), ranges
        canvas = Canvas(view, self.surface, units)
        self.by_name = {made.name: made(canvas) for made in CLASSES if made.name in names}
        for layer in self.by_name.values():
            layer.set_visible(False)  # until there is a result
        self._picture: Picture | None = None
        view.rendering.connect(self._keep_scale)

    def set_sensor(self, sensor: Sensor, mesh: MembraneMesh) -> None:
        """Take the geometry of another sensor."""
        self.hide()
        self.surface.set_mesh(mesh)
        for layer in self.by_name.values():
            layer.set_sensor(sensor, mesh)

    def draw(self, result: Result, choices: Choices) -> None:
        """Draw a result with what the user chose to see."""
        self._ranges.take(self, result)
        self._draw(result, choices)

    def hide(self) -> None:
        """Show nothing, and have no say in the scales."""
        self._picture = None
        self._ranges.leave(self)

    def _keep_scale(self) -> None:
        """Draw once more where another sensor has changed the scales since."""
        drawn = self._picture
        if drawn is not None and drawn.ranges != self._ranges.of(drawn.choices):
            self._draw(drawn.result, drawn.choices)

    def _draw(self, result: Result, choices: Choices) -> None:
        shape = None
        if any(layer.cut for name, layer in self.by_name.items() if name in choices.layers):
            shape = self.surface.shape_of(result.estimate, choices.exaggeration)
        if shape is not None:
            self.surface.draw(shape)
        self._picture = picture = Picture(result, shape, self._ranges.of(choices), choices)
        for name, layer in self.by_name.items():
            layer.set_visible(name in choices.layers)
            if name in choices.layers:
                layer.draw(picture)

    def of(self, kind: type[L]) -> L:
        """The layer of a class."""
        layer = self.by_name[kind.name]
        assert isinstance(layer, kind)
        return layer
