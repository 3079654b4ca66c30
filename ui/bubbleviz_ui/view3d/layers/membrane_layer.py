"""The membrane, coloured by contact pressure; neutral where nothing touches it."""

from __future__ import annotations

import pyvista as pv

from bubbleviz_ui.model.choices import COLOUR_MAPS
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.colour_bar import ColourBar
from bubbleviz_ui.view3d.colour_maps import lookup_table, pressure_colours
from bubbleviz_ui.view3d.layers.layer import (
    Canvas,
    Layer,
    Picture,
    hatch,
    in_front,
    light_plainly,
)


class MembraneLayer(Layer):
    """The deformed surface with a colour bar in the operator's pressure unit.

    One colour of its own, at rest, while the estimate is not to be trusted; hatched where pressure
    is no evidence of contact.
    """

    name, cut = "membrane", True

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._map = COLOUR_MAPS[0]
        self._table = lookup_table(pressure_colours(self._map))
        actor = self.add(
            canvas.surface.poly,
            scalars=canvas.surface.PRESSURE,
            cmap=self._table,
            show_scalar_bar=False,
            smooth_shading=False,
            ambient=0.25,
            diffuse=0.75,
            specular=0.0,  # a highlight would look like pressure
        )
        light_plainly(actor)
        actor.prop.interpolation = "Phong"  # by the normals of the mesh, not by VTK's facets
        actor.prop.color = theme.UNTRUSTED  # seen while the pressure is not to be trusted
        self._unexplained = pv.Triangle()  # an empty mesh cannot be added
        self._hatching = self.add(self._unexplained, color=theme.UNTRUSTED, lighting=False)
        self._hatching.SetPickable(False)
        in_front(self._hatching, -90.0)
        hatch(self._hatching)
        self._bar = ColourBar(canvas.view, self._table, "contact pressure", upper=True)

    def draw(self, picture: Picture) -> None:
        """Take the colour range and the opacity; the surface itself is shared."""
        unit = self.canvas.units.pressure
        high = unit.of(picture.ranges.pressure_pa)
        self._bar.set_range(0.0, high, unit)
        self.actor.mapper.scalar_range = (0.0, high)
        self.actor.prop.opacity = picture.choices.membrane_opacity
        estimate = picture.result.estimate
        self.actor.mapper.scalar_visibility = estimate is None or estimate.trusted
        if picture.choices.colour_map != self._map:
            self._map = picture.choices.colour_map
            self._table.values = pressure_colours(self._map)
        unexplained = None if estimate is None else estimate.unexplained_pressure_pa
        there = unexplained is not None and bool(unexplained.any())
        self._hatching.SetVisibility(there)
        if unexplained is not None and there:
            self._unexplained.copy_from(self.canvas.surface.around(unexplained > 0.0))

    def set_visible(self, visible: bool) -> None:
        """Show or hide the surface and its bar."""
        super().set_visible(visible)
        self._bar.set_visible(visible)


class WireframeLayer(Layer):
    """The edges of the mesh."""

    name, cut = "wireframe", True

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        edges = self.add(
            canvas.surface.poly,
            style="wireframe",
            color=theme.WIREFRAME,
            line_width=1,
            lighting=False,
        )
        in_front(edges, -60.0)
