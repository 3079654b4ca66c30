"""The outline of the contact patch."""

from __future__ import annotations

from vtkmodules.vtkFiltersCore import vtkContourFilter

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.sensor import Sensor
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.layers.drawn_surface import Surface
from bubbleviz_ui.view3d.layers.layer import Picture
from bubbleviz_ui.view3d.layers.membrane_layer import lift
from bubbleviz_ui.view3d.render_view import View


class ContourLayer:
    """Contour line on the displayed surface; VTK traces it along the triangles."""

    def __init__(self, view: View, surface: Surface) -> None:
        self._surface = surface
        self._filter = vtkContourFilter()
        self._filter.SetInputData(surface.poly)
        self._filter.ComputeScalarsOff()
        self._filter.ComputeNormalsOff()
        self._filter.SetInputArrayToProcess(0, 0, 0, 0, surface.LEVEL)
        self._filter.SetValue(0, 0.0)
        self.actor = view.add_mesh(
            self._filter,
            color=theme.LINE,
            line_width=3,
            lighting=False,
            reset_camera=False,
            render=False,
        )
        # Straight from the filter: pyvista puts an algorithm in Python between, run every frame.
        self.actor.mapper.SetInputConnection(self._filter.GetOutputPort())
        lift(self.actor, -200.0)
        self._visible = True
        self._any = False

    def set_sensor(self, sensor: Sensor, mesh: MembraneMesh) -> None:
        """Nothing: the surface is shared."""

    def draw(self, picture: Picture) -> None:
        """Trace the edge of the patch; nothing without contact."""
        patch = picture.result.patch
        self._any = patch is not None and patch.area_m2 > 0
        if patch is not None and self._any:
            self._surface.mark(patch.level)
        self.actor.visibility = self._visible and self._any

    def set_visible(self, visible: bool) -> None:
        """Show or hide."""
        self._visible = visible
        self.actor.visibility = visible and self._any
