"""What the colour camera sees, painted on the membrane as it is deformed."""

from __future__ import annotations

import numpy as np
import pyvista as pv

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.sensor import Sensor
from bubbleviz_ui.view3d.layers.layer import Canvas, Layer, Picture, in_front
from bubbleviz_ui.view3d.scene_text import text_at

FADED = 0.1
"""Share of the pressure scale from which on the membrane has the colours of pressure alone."""
NOTE = 15  # px, of the font


class TextureLayer(Layer):
    """The image on the shared surface; pressure shows through where the membrane is drawn, too.

    A note says why there is nothing to paint.
    """

    name, cut = "texture", True
    SHADE = "texture shade"

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._image = pv.ImageData(dimensions=(1, 1, 1))
        self._take_image(np.zeros((1, 1, 3), np.uint8))
        actor = self.add(
            canvas.surface.poly, color="white", ambient=0.55, diffuse=0.45, specular=0.0
        )
        self._texture = pv.Texture(self._image)
        self._texture.SetInterpolate(True)
        self._texture.SetRepeat(False)
        actor.SetTexture(self._texture)
        actor.SetPickable(False)
        mapper = actor.mapper
        mapper.SetScalarModeToUsePointFieldData()
        mapper.SelectColorArray(self.SHADE)
        mapper.SetColorModeToDirectScalars()
        in_front(actor, -30.0)
        self._note = text_at(canvas.view, NOTE, (0.5, 0.16))  # above the scale bar
        self._note.GetTextProperty().SetJustificationToCentered()
        canvas.view.renderer.AddViewProp(self._note)
        self.actors.append(self._note)

    def set_sensor(self, sensor: Sensor, mesh: MembraneMesh) -> None:
        """Make room for its nodes on the surface."""
        poly, count = self.canvas.surface.poly, len(mesh.nodes)
        poly.point_data[self.SHADE] = np.zeros((count, 4), np.uint8)
        poly.active_texture_coordinates = np.zeros((count, 2), np.float32)
        self.actor.mapper.ScalarVisibilityOn()

    def draw(self, picture: Picture) -> None:
        """Paint the image; nothing where the estimate is not to be trusted."""
        texture = picture.result.texture
        self._note.SetInput("")
        self._has(texture is not None)
        if texture is None or picture.shape is None:
            return
        if texture.colour.rgb is None or texture.reason:
            self._note.SetInput(texture.reason)
            self.actor.SetVisibility(False)
            return
        self._take_image(texture.colour.rgb)
        poly, choices = self.canvas.surface.poly, picture.choices
        poly.active_texture_coordinates[:] = texture.place
        cover = texture.seen.astype(float)
        if "membrane" in choices.layers:
            share = picture.shape.pressure_pa / (FADED * picture.ranges.pressure_pa)
            cover *= 1.0 - np.minimum(share, 1.0)
        poly.point_data[self.SHADE][:, :3] = 255
        poly.point_data[self.SHADE][:, 3] = 255.0 * cover
        poly.Modified()
        self.actor.prop.opacity = choices.membrane_opacity

    def _take_image(self, rgb: np.ndarray) -> None:
        """Write the pixels, rows from the top, into the texture."""
        height, width = rgb.shape[:2]
        if self._image.n_points != height * width or "rgb" not in self._image.point_data:
            self._image.dimensions = (width, height, 1)
            self._image.point_data["rgb"] = np.zeros((height * width, 3), np.uint8)
        self._image.point_data["rgb"][:] = rgb.reshape(-1, 3)
        self._image.Modified()
