"""Drawing of what is open together but not shown by the panels: other sensors, another run."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from PySide6.QtCore import QObject

from bubbleviz.membrane import MembraneMesh
from bubbleviz.result import Result
from bubbleviz.sensor import Sensor
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.model.frame_history import FrameHistory
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.render_view import View
from bubbleviz_ui.view3d.scene import OtherSensor, Scene

if TYPE_CHECKING:
    from bubbleviz_ui.panels.other_recording import AlignedRun

TIMEOUT_S = 0.15
"""After this time without a picture of the chosen sensor, the others are drawn alone."""
APART = 1.3
"""Distance of membranes without poses, in widths of a membrane; chosen."""


class _Other(NamedTuple):
    """Another membrane: place, colour, and what is shown of it."""

    sensor: Sensor
    mesh: MembraneMesh
    T_W_B: np.ndarray
    colour: str
    result: Result
    history: FrameHistory


class SensorGroup(QObject):
    """Places the sensors of a group in the scene, and draws those that the panels do not show.

    Of recordings, and of a session that is frozen or paused, they show the frame of the same time;
    so does the run of another recording that is compared with the open one.
    """

    def __init__(self, controller: Controller, scene: Scene, view: View) -> None:
        super().__init__()
        self._controller, self._scene, self._view = controller, scene, view
        self.drawings: list[OtherSensor] = []  # More may be left from before
        self._aligned: AlignedRun | None = None
        self._shown_s = 0.0
        controller.group_changed.connect(self._place)
        controller.shown.connect(self._on_shown)
        controller.other_opened.connect(self._on_other_opened)
        controller.other_solved.connect(self._show)
        controller.state.settings_changed.connect(self._show)

    @property
    def chosen_name(self) -> str:
        """Name of the sensor shown by the panels if there are several, else empty."""
        return self._controller.client.name

    def choose(self, number: int) -> None:
        """Show a sensor in the panels; the camera does not move in the world."""
        controller, scene = self._controller, self._scene
        before, moved = self._T_W_B(controller.chosen), scene.moved_by_user
        controller.choose(number)
        self._show()
        if moved and number == controller.chosen:
            scene.move_camera(np.linalg.inv(self._T_W_B(number)) @ before)

    def choose_next(self) -> None:
        """Show the next open sensor in the panels."""
        clients, chosen = self._controller.clients, self._controller.chosen
        later = ((chosen + step) % len(clients) for step in range(1, len(clients)))
        others = self._controller.others
        self.choose(next((number for number in later if clients[number] in others), chosen))

    def compare(self, aligned: AlignedRun | None) -> None:
        """Draw another run beside the open recording, or none."""
        if aligned is not None or self._aligned is not None:
            self._aligned = aligned
            self._place()
            self._scene.reset_view()
            self._show()

    def follow_if_alone(self) -> None:
        """Request frames of the others while the chosen sensor sends nothing."""
        if self._controller.state.advancing and self._chosen_silent:
            self._controller.request_others()

    @property
    def _chosen_silent(self) -> bool:
        """Whether no picture of the chosen sensor is expected soon."""
        advancing = self._controller.state.advancing
        return not advancing or time.perf_counter() - self._shown_s > TIMEOUT_S

    def _on_shown(self) -> None:
        self._shown_s = time.perf_counter()
        drawn = zip(self.drawings, self._others(), strict=False)
        if self._aligned is not None or not all(drawing.visible for drawing, _ in drawn):
            self._show()

    def _others(self) -> list[_Other]:
        """The other sensors that are open, and the run that is compared."""
        controller, found = self._controller, list[_Other]()
        for number, client in enumerate(controller.clients):
            if client in controller.others and (opened := client.opened) is not None:
                place = self._T_W_B(number), controller.group[number].colour
                shown = client.result, client.history
                found.append(_Other(opened.sensor, opened.mesh, *place, *shown))
        if (run := self._aligned) is not None:
            model, T = run.run.model, np.eye(4)
            T[0, 3] = APART * np.ptp(model.mesh.nodes[:, 0])
            k = int(np.abs(run.times_s - controller.result.frame.time_s).argmin())
            shown = run.run[k].result, run.history
            found.append(_Other(model.sensor, model.mesh, T, theme.COMPARED[1], *shown))
        return found

    def _T_W_B(self, number: int) -> np.ndarray:
        group, opened = self._controller.group, self._controller.clients[number].opened
        if not group:
            return np.eye(4)
        T = group[number].T_W_B
        if number and opened is not None and np.array_equal(T, group[0].T_W_B):
            T = T.copy()
            T[:3, 3] += T[:3, 0] * number * APART * np.ptp(opened.mesh.nodes[:, 0])
        return T

    def _place(self) -> None:
        """Place all sensors in the scene."""
        others, group, chosen = self._others(), self._controller.group, self._controller.chosen
        while len(self.drawings) < len(others):
            self.drawings.append(self._scene.add_sensor())
        for drawing in self.drawings[len(others) :]:
            drawing.remove()
        for drawing, other in zip(self.drawings, others, strict=False):
            drawing.put(other.sensor, other.mesh, other.T_W_B, other.colour)
        colour = theme.COMPARED[0] if others else None
        colour = group[chosen].colour if group else colour
        self._scene.place(self._T_W_B(chosen), colour, self.chosen_name)

    def _on_other_opened(self) -> None:
        moved = self._scene.moved_by_user
        self._place()
        if not moved:
            self._scene.reset_view()
        self._show()

    def _show(self, _: object = None) -> None:
        """Draw the others with the next picture of the chosen sensor, in a single render.

        Not before that is open, as the colour bars are of the previous source.
        """
        state = self._controller.state
        others = [] if state.facts.is_empty else self._others()
        for drawing, other in zip(self.drawings, others, strict=False):
            drawing.show(other.result, state.settings, other.history)
        if others and self._chosen_silent:
            self._view.refresh()
