"""The place under the mouse: its measured point, its node, and the camera's ray to it."""

from __future__ import annotations

import numpy as np
import pyvista as pv

from bubbleviz.diagnostics.probe import Probed
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.colour_maps import rgb
from bubbleviz_ui.view3d.layers.layer import add_mark
from bubbleviz_ui.view3d.render_view import View


class ProbeMarks:
    """Two dots and a line, in front of everything; hidden while nothing is pointed at.

    Attributes
    ----------
    actors : list of actors
    """

    def __init__(self, view: View) -> None:
        self._view = view
        self._camera_m = np.zeros(3)
        self._dots = pv.PolyData(np.zeros((2, 3)))
        self._dots.point_data["colour"] = np.array([rgb(theme.LINE), rgb(theme.NODE)], np.uint8)
        self._ray = pv.PolyData(np.zeros((2, 3)), lines=[2, 0, 1])
        dots = {"scalars": "colour", "rgb": True, "point_size": 11, **view.quality.points}
        self.actors = [
            add_mark(view, self._ray, color=theme.LINE, line_width=1, opacity=0.6, lighting=False),
            add_mark(view, self._dots, **dots),
        ]
        view.follow_theme(self._paint)
        self.show(None)

    def _paint(self, colours: theme.Colours) -> None:
        """Take the colour of text for what was measured: it lies off the membrane, too."""
        self._dots.point_data["colour"][0] = rgb(colours.text)
        self._dots.Modified()
        self.actors[0].prop.color = colours.text

    def set_camera(self, position_m: np.ndarray) -> None:
        """Take where the depth camera is, (3,) in B."""
        self._camera_m = np.asarray(position_m, float)

    def show(self, place: Probed | None, drawn_m: np.ndarray | None = None) -> None:
        """Light up a place, or nothing; its node at `drawn_m` (3,), where that is elsewhere."""
        measured = place is not None and bool(np.isfinite(place.point_m).all())
        if place is not None:
            node = place.node_m if drawn_m is None else drawn_m
            point = place.point_m if measured else node
            self._dots.points[:] = np.array([point, node])
            self._ray.points[:] = np.array([self._camera_m, point])
            self._dots.Modified()
            self._ray.Modified()
        for actor in self.actors:
            actor.visibility = place is not None
        self._view.refresh()
