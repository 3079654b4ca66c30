"""Drawing of the sensors that are open together but not shown by the panels."""

from __future__ import annotations

import time

import numpy as np
from PySide6.QtCore import QObject

from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.view3d.render_view import View
from bubbleviz_ui.view3d.scene import OtherSensor, Scene

TIMEOUT_S = 0.15
"""After this time without a picture of the chosen sensor, the others are drawn alone."""
APART = 1.3
"""Distance of membranes without poses, in widths of a membrane; chosen."""


class SensorGroup(QObject):
    """Places the sensors of a group in the scene, and draws those that the panels do not show.

    Of recordings, and of a session that is frozen or paused, they show the frame of the same time.
    """

    def __init__(self, controller: Controller, scene: Scene, view: View) -> None:
        super().__init__()
        self._controller, self._scene, self._view = controller, scene, view
        self.drawings: list[OtherSensor] = []  # Of the other sensors; more may be left from before
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
        if not all(drawing.visible for _, drawing in self._drawn()):
            self._show()

    def _drawn(self) -> list[tuple[int, OtherSensor]]:
        """Numbers and drawings of the other sensors that are open."""
        clients, others = self._controller.clients, self._controller.others
        while len(self.drawings) < len(others):
            self.drawings.append(self._scene.add_sensor())
        numbers = [number for number, client in enumerate(clients) if client in others]
        return list(zip(numbers, self.drawings, strict=False))

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
        controller, drawn = self._controller, self._drawn()
        group, chosen = controller.group, controller.chosen
        for drawing in self.drawings[len(drawn) :]:
            drawing.remove()
        for number, drawing in drawn:
            opened, T = controller.clients[number].opened, self._T_W_B(number)
            if opened is not None:
                drawing.put(opened.sensor, opened.mesh, T, group[number].colour)
        colour = group[chosen].colour if group else None
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
        state, clients = self._controller.state, self._controller.clients
        drawn = [] if state.facts.is_empty else self._drawn()
        for number, drawing in drawn:
            drawing.show(clients[number].result, state.settings, clients[number].history)
        if drawn and self._chosen_silent:
            self._view.refresh()
