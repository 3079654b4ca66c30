"""Plots of height and contact pressure along a line across the membrane."""

from __future__ import annotations

from typing import Any

import numpy as np

from bubbleviz.diagnostics import profile
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.panels.plot_host import Part, Plot, PlotHost
from bubbleviz_ui.shell.theme import BLUE, ORANGE

HEIGHT = 230
"""Of both plots, screen pixels."""
DOT = 2
"""Size of a measured point, px."""


class ProfilePlot(PlotHost):
    """Profile of the frame shown between two points; hidden without them."""

    def __init__(self, state: SessionState, controller: Controller) -> None:
        super().__init__(self._make)
        self._state, self._controller = state, controller
        self._ends_m: np.ndarray | None = None
        self.setFixedHeight(HEIGHT)
        self.setToolTip(
            "Section through both points, parallel to z of the bubble frame: estimated membrane, "
            "membrane at rest, measured points, and contact pressure, over the distance in xy from "
            "the first point"
        )
        self.hide()
        self.seen.connect(self._draw)
        controller.shown.connect(self._draw)

    def show_line(self, ends_m: np.ndarray | None) -> None:
        """Show the profile between two points (2, 3) in B; None: hide it."""
        self._ends_m = ends_m
        self.setVisible(ends_m is not None)
        self._draw()

    def _make(self) -> list[Part]:
        self.above, self.below = Plot("number", mouse="xy"), Plot("number", mouse="xy")
        self.rest = self.above.add_curve()
        self.measured = self.above.add_dots(DOT, ORANGE)
        self.membrane, self.contact = self.above.add_curve(BLUE), self.below.add_curve(BLUE)
        self.below.box.setXLink(self.above.box)
        self.arrange([self.above.item, self.below.item])
        return [self.above, self.below]

    def _draw(self, _: Any = None) -> None:
        opened, result = self._controller.client.opened, self._controller.result
        if not self.ready or self._ends_m is None or opened is None:
            return
        found = profile(opened.camera, opened.mesh, result, self._ends_m)
        if found is None:
            return
        length, pressure = self._state.units.length, self._state.units.pressure
        for item, along_m, height_m in (
            (self.rest, found.rest_along_m, found.rest_height_m),
            (self.membrane, found.along_m, found.height_m),
            (self.measured, found.measured_along_m, found.measured_height_m),
        ):
            item.setData(length.per_si * along_m, length.per_si * height_m)
        self.contact.setData(length.per_si * found.along_m, pressure.per_si * found.pressure_pa)
        self.above.write(
            f'z ({length.symbol}): <span style="color:{BLUE}">membrane</span>, '
            f'<span style="color:{ORANGE}">measured</span>, at rest'
        )
        self.below.write(f"p_c ({pressure.symbol}) over distance in xy ({length.symbol})")
