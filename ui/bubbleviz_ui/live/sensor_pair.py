"""Two sensors in one view: selection for the panels, and drawing of the other one."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from PySide6.QtCore import QObject, Signal

from bubbleviz.pipeline import Product
from bubbleviz.recordings import Frame
from bubbleviz.result import Result
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.engine.sensor_client import SensorClient
from bubbleviz_ui.engine.solver import Opened, OpenRequest
from bubbleviz_ui.engine.source import PlacedSensor
from bubbleviz_ui.engine.worker import Failed
from bubbleviz_ui.model.demand import Demand
from bubbleviz_ui.model.settings import PATCH_SETTINGS
from bubbleviz_ui.model.source_facts import NO_RESULT
from bubbleviz_ui.view3d.render_view import View
from bubbleviz_ui.view3d.scene import OtherSensor, Scene

TIMEOUT_S = 0.15
"""After this time without a picture of the selected sensor, the other one is drawn alone."""
APART = 1.3
"""Distance of two membranes without poses, in widths of the second one; chosen."""


class SensorPair(QObject):
    """The second sensor, if any; computes what is visible in the view.

    Of a recording, and of a session that is frozen or paused, it shows the frame of the same time.
    """

    selection_changed = Signal()

    def __init__(self, controller: Controller, scene: Scene, view: View) -> None:
        super().__init__()
        self._controller, self._scene, self._view = controller, scene, view
        self._state = state = controller.state
        self.second: SensorClient | None = None  # Not shown by the panels
        self.drawing: OtherSensor | None = None
        self.sensors: tuple[PlacedSensor, ...] = ()  # Both, or none
        self._ending: list[SensorClient] = []
        self.selected = 0  # Index of the sensor shown by the panels
        self._shown_s = 0.0
        controller.opened.connect(self._on_opened)
        controller.shown.connect(self._on_shown)
        state.frame_changed.connect(self._on_frame)
        state.playing_changed.connect(self._request_frame)
        state.frozen_changed.connect(self._request_frame)
        state.settings_changed.connect(self._on_settings)

    def _on_opened(self, opened: Opened) -> None:
        """Open the second sensor after the first, or remove it if something else was opened."""
        group = opened.request.group
        if group != self.sensors:
            self.end()
            self.sensors, self.selected = group, 0
            self._controller.opening.group = group
            if group:
                self._controller.client.name = group[0].name
                self._place()
        if group:
            self._begin()

    def _begin(self) -> None:
        state, other = self._state, self.sensors[1 - self.selected]
        if self.second is not None:
            return
        if self.drawing is None:
            self.drawing = self._scene.add_sensor()
        self.second = second = SensorClient(state)
        second.name = other.name
        second.extra_products = self._controller.client.extra_products
        self._listen(second)
        second.open(
            OpenRequest(
                source=other.source,
                open_sensor=other.open_sensor,
                frame=0,
                demand=self._demand,
                options=state.settings.options,
                playing=True,
                group=self.sensors,
            )
        )

    def result_of(self, number: int) -> Result:
        """Result shown of a sensor."""
        client = self._controller.client if number == self.selected else self.second
        return NO_RESULT if client is None else client.result

    @property
    def selected_name(self) -> str:
        """Name of the sensor shown by the panels if there are two, else empty."""
        return self.sensors[self.selected].name if self.sensors else ""

    def select(self, number: int) -> None:
        """Show a sensor in the panels."""
        other = self.second
        if other is None or other.opened is None or number == self.selected:
            self.selection_changed.emit()  # a click has changed the button
            return
        before, moved = self._T_W_B(self.selected), self._scene.moved_by_user
        self._listen(other, on=False)
        self.selected, self.second = number, self._controller.client
        self._place()
        self._controller.switch_to(other)
        self._listen(self.second)
        self._show()
        self._request_frame()
        if moved:
            self._scene.move_camera(np.linalg.inv(self._T_W_B(number)) @ before)
        self.selection_changed.emit()

    def switch(self) -> None:
        """Show the other sensor in the panels."""
        self.select(1 - self.selected)

    def set_extra_products(self, products: frozenset[Product]) -> None:
        """Set products that both sensors compute for publishing."""
        self._controller.client.extra_products = products
        if self.second is not None:
            self.second.extra_products = products

    def end(self) -> None:
        """Remove the second sensor; its solver thread ends by itself."""
        second, self.second, self.sensors = self.second, None, ()
        self._controller.client.name, self._controller.opening.group = "", ()
        if second is not None:
            self._ending = [each for each in [*self._ending, second] if not each.close(0.0)]
        if self.drawing is not None:
            self.drawing.remove()
        self._scene.place()

    def close(self) -> None:
        """Remove the second sensor, and wait for solver threads."""
        self.end()
        for client in self._ending:
            client.close()

    # -- requests of the second sensor --------------------------------------------------------

    @property
    def _demand(self) -> Demand:
        """Demand of the layers in the view."""
        return Demand.of(replace(self._state.settings, panels=frozenset()))

    @property
    def _follows(self) -> bool:
        """Whether the second sensor is live and shows its newest frame."""
        return self.second is not None and self.second.facts.grows and self._state.advancing

    def _request_frame(self) -> None:
        """Request the newest frame, or of a recording and while paused the one of the same time."""
        second = self.second
        if second is None or second.opened is None:
            return
        if self._follows:
            second.request_newest(self._demand, at_once=True)
        else:
            time_s = float(self._state.facts.times_s[self._state.frame])
            second.request_frame(self._frame_at(time_s, second), self._demand)

    def _frame_at(self, time_s: float, second: SensorClient) -> int:
        """Frame of the second sensor at a time of the first.

        Recordings made at the same time are aligned by their stamps, others by their first frames.
        """
        opened, shown = second.opened, self._controller.result
        if opened is None:
            return 0
        if opened.request.source.stream is not None:
            return opened.request.source.stream.at(time_s)
        times_s = opened.facts.times_s
        later_s = _start_s(shown.frame) - _start_s(opened.result.frame)
        if -self._state.facts.times_s[-1] < later_s < times_s[-1]:
            time_s += later_s
        return int(np.abs(times_s - time_s).argmin())

    def _listen(self, client: SensorClient, *, on: bool = True) -> None:
        for signal, slot in (
            (client.opened_source, self._on_second_open),
            (client.solved, self._on_second_solved),
            (client.paused, self._on_second_paused),
            (client.failed, self._on_second_failed),
        ):
            signal.connect(slot) if on else signal.disconnect(slot)

    def _on_second_failed(self, failed: Failed) -> None:
        self._state.messages.add("error", failed.message, failed.details)

    def _on_second_paused(self) -> None:
        if self._follows:
            self._request_frame()

    def _on_second_solved(self, _: object, newest: bool) -> None:
        """Request the next frame at once: neither sensor waits for the other.

        A frame requested during playback may arrive after a pause, and has another time then.
        """
        if self._follows or newest:
            self._request_frame()
        self._show()

    @property
    def _selected_silent(self) -> bool:
        """Whether no picture of the selected sensor is expected soon."""
        return not self._state.advancing or time.perf_counter() - self._shown_s > TIMEOUT_S

    def follow_if_alone(self) -> None:
        """Request frames of the second sensor while the selected one sends nothing."""
        if self._follows and self._selected_silent:
            self._request_frame()

    def _on_shown(self) -> None:
        self._shown_s = time.perf_counter()
        if self.drawing is not None and not self.drawing.visible:
            self._show()
        if self._follows:
            self._request_frame()

    def _on_frame(self, _: int, by_playback: bool) -> None:
        if not (by_playback and self._follows):
            self._request_frame()

    def _on_settings(self, names: frozenset[str]) -> None:
        if self.second is not None:
            if names & PATCH_SETTINGS:
                self.second.history.forget_patches()
            self._show()
            self._request_frame()

    # -- placement ----------------------------------------------------------------------------

    def _T_W_B(self, number: int) -> np.ndarray:
        T, other = self.sensors[number].T_W_B, self.second
        if number and other is not None and np.array_equal(T, self.sensors[0].T_W_B):
            clients = (self._controller.client, other)
            opened = clients[number != self.selected].opened
            T = T.copy()
            T[:3, 3] += T[:3, 0] * (
                0.0 if opened is None else APART * np.ptp(opened.mesh.nodes[:, 0])
            )
        return T

    def _place(self) -> None:
        """Place both sensors in the scene."""
        other, opened = 1 - self.selected, None if self.second is None else self.second.opened
        if opened is not None and self.drawing is not None:
            colour = self.sensors[other].colour
            self.drawing.put(opened.sensor, opened.mesh, self._T_W_B(other), colour)
        colour = self.sensors[self.selected].colour
        self._scene.place(self._T_W_B(self.selected), colour, self.selected_name)

    def _on_second_open(self, _: object) -> None:
        moved = self._scene.moved_by_user
        self._place()
        if not moved:
            self._scene.reset_view()
        self._show()
        self._request_frame()

    def _show(self) -> None:
        """Draw the second sensor with the next picture of the selected one, in a single render.

        Not before the selected one is open, as the colour bars are of the previous source.
        """
        second, drawing = self.second, self.drawing
        if second is None or drawing is None:
            return
        if second.opened is None or self._state.facts.is_empty:
            return
        drawing.show(second.result, self._state.settings, second.history)
        if self._selected_silent:
            self._view.refresh()


def _start_s(frame: Frame) -> float:
    """Stamp of a source's first frame, s."""
    return 1e-9 * frame.stamp_ns - frame.time_s
