"""Layers of the contact: membrane, outlines, force, readout, traction, texture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyvista as pv

from bubbleviz.membrane import MembraneMesh
from bubbleviz.output import ComparedResult
from bubbleviz.result import Result
from bubbleviz.sensor import Sensor
from bubbleviz_ui.model.settings import ColourMap, Settings
from bubbleviz_ui.model.source_facts import UNTRUSTED_STATUS, force_text, friction_text
from bubbleviz_ui.model.units import DASH, Units
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.colours import lookup_table, pressure_colours
from bubbleviz_ui.view3d.layer import (
    Canvas,
    Layer,
    LinesLayer,
    Picture,
    Surface,
    across,
    draw_in_front,
    light_without_highlights,
)
from bubbleviz_ui.view3d.render_view import View
from bubbleviz_ui.view3d.sensor_layers import CORNER
from bubbleviz_ui.view3d.text import ColourBar, left_of_bars, set_colour, text_at, text_size, wrap


class MembraneLayer(Layer):
    """The deformed membrane, coloured by contact pressure, with a colour bar.

    In one colour while the estimate is untrusted.
    """

    name, clipped = "membrane", True

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._map: ColourMap = Settings.colour_map
        self._table = lookup_table(pressure_colours(self._map))
        actor = self.add(
            canvas.surface.poly,
            scalars=canvas.surface.PRESSURE,
            table=self._table,
            interpolation="Phong",  # by the normals of the mesh
            color=theme.UNTRUSTED,  # visible while the estimate is untrusted
            ambient=0.25,
            diffuse=0.75,
            specular=0.0,  # a highlight would look like pressure
        )
        actor.mapper.InterpolateScalarsBeforeMappingOn()
        light_without_highlights(actor)
        self.bar = self._bar = ColourBar(
            canvas.view, self._table, "contact pressure", "pressure_max_pa", upper=True
        )

    def draw(self, picture: Picture) -> None:
        """Update colours and opacity; the surface itself is shared."""
        end_pa, unit = picture.ranges.pressure_pa, self.canvas.units.pressure
        high = self._bar.set_range(end_pa, unit, picture.settings)
        self.actor.mapper.scalar_range = (0.0, high)
        self.actor.prop.opacity = picture.settings.membrane_opacity
        estimate = picture.result.estimate
        self.actor.mapper.scalar_visibility = estimate is None or estimate.trusted
        if picture.settings.colour_map != self._map:
            self._map = picture.settings.colour_map
            self._table.values = pressure_colours(self._map)


class WireframeLayer(Layer):
    """Edges of the mesh."""

    name, clipped = "wireframe", True

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        edges = self.add(
            canvas.surface.poly,
            style="wireframe",
            color=theme.WIREFRAME,
            line_width=1,
            lighting=False,
        )
        draw_in_front(edges, -60.0)


# Outlines of contact patches.

IN_FRONT = -200.0
"""Draws the outlines in front of the membrane, on which they lie."""


class ContourLayer(LinesLayer):
    """Outline of the patch: thick its edge, thin the bounds of the edge's uncertainty."""

    name, looks = "contour", ((theme.LINE, IN_FRONT, 3), (theme.FAINT_LINE, IN_FRONT, 1))

    def lines(self, picture: Picture) -> Sequence[np.ndarray]:
        """The edge and its band; nothing without contact."""
        patch, estimate = picture.result.trusted_patch, picture.result.estimate
        if patch is None or patch.area_m2 <= 0:
            return ()
        surface, band = self.canvas.surface, patch.edge_half_width_m
        levels = () if math.isnan(band) else (band, -band)
        return surface.edge(estimate, patch), surface.edge(estimate, patch, levels)


class ObjectPatchLayer(LinesLayer):
    """Outline of the patch by the object; nothing while its pose is lost."""

    name, looks = "object_patch", ((theme.OBJECT_PATCH, -250.0, 3),)

    def lines(self, picture: Picture) -> Sequence[np.ndarray]:
        patch = picture.result.object_patch
        return () if patch is None else [self.canvas.surface.line(patch.level)]


class ComparedLayer(LinesLayer):
    """Outlines of compared settings, while the frame they were measured on is shown."""

    name, looks = "compared", tuple((colour, -300.0, 2) for colour in theme.COMPARED)

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        # of A and B; anything but a `ComparedResult` means none
        self.measured: tuple[ComparedResult | str | None, ...] = (None, None)
        self._surfaces = [Surface(canvas.units) for _ in self.looks]
        self._meshes: list[MembraneMesh | None] = [None, None]

    def lines(self, picture: Picture) -> Sequence[np.ndarray]:
        return [self._outline(k, measured, picture) for k, measured in enumerate(self.measured)]

    def _outline(
        self, k: int, measured: ComparedResult | str | None, picture: Picture
    ) -> np.ndarray:
        """Edge of a patch on the shape estimated with the same setting, unless of another frame."""
        shown, none = picture.result.frame.index, np.empty((0, 2, 3))
        if not isinstance(measured, ComparedResult) or measured.result.frame.index != shown:
            return none
        estimate, patch, surface = (
            measured.result.estimate,
            measured.result.trusted_patch,
            self._surfaces[k],
        )
        if estimate is None or patch is None or patch.area_m2 == 0.0:
            return none
        if measured.mesh is not self._meshes[k]:
            self._meshes[k] = measured.mesh
            surface.set_mesh(measured.mesh)
        surface.draw(estimate, picture.settings.exaggeration)
        return surface.edge(estimate, patch)


# Contact pressure as lines along the normals, with lengths proportional to the pressure.

LONGEST = 0.5
"""Line length at the end of the pressure scale, in heights of the dome; of traction, too."""


class VectorsLayer(LinesLayer):
    """One line per node along its normal."""

    name, looks = "vectors", ((theme.ORANGE, 0.0, 2),)

    def lines(self, picture: Picture) -> Sequence[np.ndarray]:
        """The lines; nothing without an estimate."""
        estimate, surface = picture.result.estimate, self.canvas.surface
        if estimate is None:
            return ()
        scale = LONGEST * surface.height_m / picture.ranges.pressure_pa
        ways = scale * estimate.contact_pressure_pa[:, None] * surface.normals
        return [np.stack([surface.nodes_m + ways, surface.nodes_m], axis=1)]


# The contact force: an arrow that ends at the centre of pressure.

DEPTH_OFFSET = -4000.0
"""Draws the arrow in front of the membrane, as its tip may lie behind a dent."""


class ForceLayer(Layer):
    """Arrow along the resultant, with its tip at the centre of pressure."""

    name = "force"

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        arrow = pv.Arrow(
            start=(-1, 0, 0), direction=(1, 0, 0), tip_length=0.3, tip_radius=0.07,
            shaft_radius=0.025,
        )  # fmt: skip
        draw_in_front(self.add(arrow, color=theme.FORCE, ambient=0.4), DEPTH_OFFSET)
        self._set_drawn(False)

    def draw(self, picture: Picture) -> None:
        """Place the arrow, as long as the dome is high at the end of the scale, if any."""
        patch = picture.result.trusted_patch
        force = float(np.linalg.norm(patch.force_n)) if patch is not None else 0.0
        touched = patch is not None and patch.area_m2 > 0 and force > 0
        if patch is not None and touched:
            length = self.canvas.surface.height_m * force / picture.ranges.force_n
            self.actor.user_matrix = _place(
                patch.force_n / force, patch.center_of_pressure_m, length
            )
        self._set_drawn(touched)


def _place(direction: np.ndarray, tip: np.ndarray, length: float) -> np.ndarray:
    """Matrix that places the unit arrow, whose origin is its tip, at a point along a direction."""
    second, T = across(direction), np.eye(4)
    T[:3, :3] = length * np.column_stack([direction, second, np.cross(direction, second)])
    T[:3, 3] = tip
    return T


# Readout: large text in the view with force and patch area.

LEFT = 0.02
"""Left margin of the text, as a share of the view's width."""
HEAD, REST = 26, 15  # px, fonts of headline and details
TOP, BELOW = 14, 36  # px, top margin, and distance of the details from it
SMALLEST, TALL = 0.75, 400
"""Smallest scale of these sizes in a low view, and view height of full size, px."""
MOST = 0.4
"""Share of the view's height above which the details are left out: the panels have them, too."""
SEPARATOR = "   "
"""Between details, which are wrapped there."""


OUTDATED_OPACITY = 0.4


class ReadoutLayer(Layer):
    """Headline and details in the upper left corner."""

    name = "readout"

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._head, self._rest = _text_actor(canvas.view), _text_actor(canvas.view)
        self.actors += [self._head, self._rest]
        self._details, self._doubtful = "", False
        self.sensor = ""  # Name of the sensor if there are two
        canvas.view.rendering.connect(self._fit)

    def draw(self, picture: Picture) -> None:
        result, view = picture.result, self.canvas.view
        head, self._details = readout(result, self.canvas.units, final=picture.final)
        self._doubtful = result.estimate is not None and not result.estimate.trusted
        self._head.SetInput(f"{self.sensor}: {head}" if self.sensor and head else head)
        set_colour(self._head, theme.UNTRUSTED if self._doubtful else theme.of(view).text)

    def set_outdated(self, outdated: bool) -> None:
        """Dim the text while the live source sends no new frames."""
        for actor in (self._head, self._rest):
            actor.GetTextProperty().SetOpacity(OUTDATED_OPACITY if outdated else 1.0)

    def _fit(self) -> None:
        """Fit the text left of the colour bars: smaller headline, wrapped details or none."""
        height = self.canvas.view.size_px[1]
        share = min(1.0, max(SMALLEST, height / TALL))
        head, rest, top = share * HEAD, share * REST, 1.0 - share * TOP / height
        _put(self._head, head, top)
        head *= min(1.0, self._width_ratio(self._head))
        _put(self._head, head, top)
        _put(self._rest, min(rest, head), 1.0 - share * (TOP + BELOW) / height)
        self._rest.SetInput(self._details)
        if self._width_ratio(self._rest) < 1.0:
            lines = self._details.replace("\n", SEPARATOR).split(SEPARATOR)
            view, width = self.canvas.view, self._width
            wrapped = [wrap(view, self._rest, line, width) for line in lines]
            self._rest.SetInput("\n".join(wrapped))
        tall = share * (TOP + BELOW) + text_size(self.canvas.view, self._rest)[1]
        if tall > MOST * height and not self._doubtful:  # else they are the reason
            self._rest.SetInput("")

    @property
    def _width(self) -> float:
        """Width left of the colour bars."""
        width = self.canvas.view.size_px[0]
        return width * (left_of_bars(width) - LEFT)

    def _width_ratio(self, text: Any) -> float:
        """The available width over that of a text."""
        return self._width / max(text_size(self.canvas.view, text)[0], 1.0)


def readout(result: Result, units: Units, *, final: bool) -> tuple[str, str]:
    """Headline and details of a result; `final`: whether its numbers are final."""
    estimate, patch = result.estimate, result.patch
    if estimate is None or patch is None:
        return "", ""
    if not estimate.trusted:
        return UNTRUSTED_STATUS[estimate.status], estimate.reason
    if estimate.status == "no_contact" or patch.area_m2 <= 0:
        return "no contact", ""
    peak = units.pressure.rough(float(estimate.contact_pressure_pa.max()))
    area = units.area.with_range(patch.area_m2, *patch.area_interval_m2)
    patches = f"patch {area}"
    if result.object_patch is not None:
        by_object = units.area.text(result.object_patch.area_m2)
        patches = f"patch (white) {area}{SEPARATOR}by object (green) {by_object}"
    friction = friction_text(result, units)
    parts = [f"peak {peak}", f"friction {friction}", patches]
    if friction == DASH:
        del parts[1]
    if estimate.flow is not None:
        parts.append("by depth and colour")
    return f"contact  {force_text(result, units, final=final)}", SEPARATOR.join(parts)


def _put(text: Any, size: float, top: float) -> None:
    text.GetTextProperty().SetFontSize(math.floor(size))
    text.GetPositionCoordinate().SetValue(LEFT, top)


def _text_actor(view: View) -> Any:
    actor = text_at(view, REST, (LEFT, 1.0))
    actor.GetTextProperty().SetVerticalJustificationToTop()
    view.renderer.AddViewProp(actor)
    return actor


# Contact traction as arrows: normal and tangential part, in two colours on one scale.

BARB = (-0.25, 0.12)
"""End of a barb relative to the tip, along and across the arrow, in arrow lengths."""


class TractionLayer(LinesLayer):
    """Arrows at the nodes in contact.

    Normal arrows end on the membrane, tangential ones begin there.
    """

    name, looks = "traction", ((theme.ORANGE, -120.0, 3), (theme.BLUE, -120.0, 3))

    def lines(self, picture: Picture) -> Sequence[np.ndarray]:
        """The traction, if it was estimated."""
        traction, surface = picture.result.traction, self.canvas.surface
        if traction is None or traction.status not in ("ok", "depth_alone"):
            return ()
        touched = np.flatnonzero(traction.normal_pa.any(axis=1))
        scale = LONGEST * surface.height_m / picture.ranges.pressure_pa
        parts = traction.normal_pa, traction.tangential_pa
        normal, along = (scale * part[touched] for part in parts)
        nodes, normals = surface.nodes_m[touched], surface.normals[touched]
        return (
            _arrows(nodes - normal, normal, np.roll(normals, 1, axis=1)),
            _arrows(nodes, along, normals),
        )


def _arrows(starts: np.ndarray, ways: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Segments (3 k, 2, 3) of arrows along `ways`, with barbs normal to `across`; all (k, 3)."""
    tips, back, aside = starts + ways, BARB[0] * ways, BARB[1] * np.cross(across, ways)
    ends = np.stack([starts, tips + back + aside, tips + back - aside], axis=1)
    return np.stack([ends, np.repeat(tips[:, None], 3, axis=1)], axis=2).reshape(-1, 2, 3)


# Colour image as a texture on the deformed membrane.

TEXTURE_FADE = 0.1
"""Share of the pressure scale above which the pressure colours hide the texture."""
NOTE, NOTE_BOTTOM = 15, CORNER + 10  # px, font and place, above axes and scale bar
NOTE_WIDTH = 0.9
"""Of the view's width."""


class TextureLayer(Layer):
    """Colour image on the surface; pressure colours cover it if the membrane layer is visible.

    A note gives the reason if there is no image.
    """

    name, clipped = "texture", True
    SHADE = "texture shade"

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._image = pv.ImageData(dimensions=(1, 1, 1))
        self._take_image(np.zeros((1, 1, 3), np.uint8))
        actor = self.add(
            canvas.surface.poly, scalars=self.SHADE, ambient=0.55, diffuse=0.45, specular=0.0
        )
        self._texture = pv.Texture(self._image)
        self._texture.SetInterpolate(True)
        self._texture.SetRepeat(False)
        actor.SetTexture(self._texture)
        draw_in_front(actor, -30.0)
        self._note = text_at(canvas.view, NOTE, (0.5, 0.0))
        self._note.GetTextProperty().SetJustificationToCentered()
        canvas.view.renderer.AddViewProp(self._note)
        self.actors.append(self._note)
        self._reason = ""
        canvas.view.rendering.connect(self._wrap_note)

    def set_sensor(self, sensor: Sensor, mesh: MembraneMesh) -> None:
        """Create the arrays for its nodes on the surface."""
        poly, count = self.canvas.surface.poly, len(mesh.nodes)
        poly.point_data[self.SHADE] = np.zeros((count, 4), np.uint8)
        poly.active_texture_coordinates = np.zeros((count, 2), np.float32)

    def draw(self, picture: Picture) -> None:
        """Draw the image; nothing while the estimate is untrusted."""
        texture, estimate = picture.result.texture, picture.result.estimate
        self._reason = ""
        self._set_drawn(texture is not None)
        if texture is None or estimate is None:
            return
        if texture.colour.rgb is None or texture.reason:
            self._reason = texture.reason
            self.actor.SetVisibility(False)
            return
        self._take_image(texture.colour.rgb)
        poly, settings = self.canvas.surface.poly, picture.settings
        poly.active_texture_coordinates[:] = texture.place
        cover = texture.seen.astype(float)
        if "membrane" in settings.layers:
            end_pa = TEXTURE_FADE * picture.ranges.pressure_pa
            cover *= 1.0 - np.minimum(estimate.contact_pressure_pa / end_pa, 1.0)
        poly.point_data[self.SHADE][:, :3] = 255
        poly.point_data[self.SHADE][:, 3] = 255.0 * cover
        poly.Modified()
        self.actor.prop.opacity = settings.membrane_opacity

    def _wrap_note(self) -> None:
        view = self.canvas.view
        self._note.SetInput(self._reason)
        self._note.GetPositionCoordinate().SetValue(0.5, NOTE_BOTTOM / view.size_px[1])
        if self._reason:
            wrap(view, self._note, self._reason, NOTE_WIDTH * view.size_px[0])

    def _take_image(self, rgb: np.ndarray) -> None:
        """Copy the pixels, rows from the top, into the texture."""
        height, width = rgb.shape[:2]
        if self._image.n_points != height * width or "rgb" not in self._image.point_data:
            self._image.dimensions = (width, height, 1)
            self._image.point_data["rgb"] = np.zeros((height * width, 3), np.uint8)
        self._image.point_data["rgb"][:] = rgb.reshape(-1, 3)
        self._image.Modified()
