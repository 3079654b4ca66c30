"""A frame one stays at has one answer, however one came to it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest
from fakes import DentSource
from PySide6.QtCore import QObject, Qt, Signal
from pytestqt.qtbot import QtBot
from window_driver import Driver

from bubbleviz.frames.frame_source import FrameSource
from bubbleviz.pipeline import Pipeline
from bubbleviz.sensor import Sensor
from bubbleviz_ui.engine.requests import Answer, OpenRequest, Request, Solved
from bubbleviz_ui.engine.sensor_client import SensorClient
from bubbleviz_ui.engine.solver_server import Server
from bubbleviz_ui.model.demand import Demand
from bubbleviz_ui.model.session_state import SessionState

Drive = Callable[..., Driver]
FRAME = 75


def settled_by_itself(driver: Driver) -> None:
    """Wait until the window has settled the frame at the cursor."""
    driver.wait(lambda: driver.at_the_cursor() and driver.window.controller.settled)


def shown(driver: Driver) -> tuple[float, float]:
    """Force, N, and area, m², of the patch that is shown, once nothing changes any more."""
    settled_by_itself(driver)
    patch = driver.window.controller.result.patch
    return float(np.linalg.norm(patch.force_n)), patch.area_m2


def test_opened_sought_and_stepped_to_a_frame_has_the_same_area(drive: Drive) -> None:
    alone = shown(drive(frame=FRAME))
    driver = drive(frame=110)
    driver.state.seek(FRAME)
    sought = shown(driver)
    driver.seek(FRAME - 3)
    driver.window.playback.forward.setFocus()
    for _ in range(3):
        driver.bot.mouseClick(driver.window.playback.forward, Qt.MouseButton.LeftButton)
    assert driver.state.frame == FRAME
    stepped = shown(driver)
    assert sought == pytest.approx(alone, rel=0.01)
    assert stepped == pytest.approx(alone, rel=0.01)
    label = driver.window.status.labels["area"].text()
    assert label == f"patch {1e6 * stepped[1]:.0f} mm²"


def test_a_paused_frame_has_its_pose_found_once(drive: Drive) -> None:
    """Also where closer looks, which are left out while playing, are due with it."""
    driver = drive(frame=FRAME - 3)
    driver.window.panels["pose"].show()
    driver.window.panels["images"].show()
    driver.state.choose(every_frame=True, pose_object="sphere", pose_track=True)
    driver.settle()
    found = Counter[int]()

    def note(answer: Answer) -> None:
        if isinstance(answer, Solved) and "pose" in answer.result.times_ms:
            found[answer.result.frame.index] += 1

    driver.window.controller.client.answered.connect(note)
    driver.bot.mouseClick(driver.window.playback.play, Qt.MouseButton.LeftButton)
    driver.wait(lambda: driver.state.frame >= FRAME)
    driver.bot.mouseClick(driver.window.playback.play, Qt.MouseButton.LeftButton)
    settled_by_itself(driver)
    assert driver.window.controller.client.demand.looks
    assert not driver.window.controller.client.look_is_old
    assert driver.window.controller.result.pose is not None
    assert found[driver.state.frame] == 1


def test_a_frame_is_settled_with_the_patch_that_was_chosen_since(drive: Drive) -> None:
    driver = drive(frame=FRAME)
    controller, areas = driver.window.controller, list[float]()
    driver.settle()
    driver.state.choose(least_area_m2=0.01)
    driver.wait(lambda: controller.result.patch.area_m2 == 0.0)

    def note(answer: Answer) -> None:
        if isinstance(answer, Solved):
            areas.append(answer.result.patch.area_m2)

    controller.client.answered.connect(note)
    controller.settle()
    driver.wait(lambda: bool(areas))
    assert areas == [0.0]


def test_playback_that_pauses_settles_its_frame(drive: Drive) -> None:
    driver = drive(frame=FRAME - 3)
    driver.state.choose(every_frame=True)
    driver.bot.mouseClick(driver.window.playback.play, Qt.MouseButton.LeftButton)
    driver.wait(lambda: driver.state.frame >= FRAME)
    driver.bot.mouseClick(driver.window.playback.play, Qt.MouseButton.LeftButton)
    paused = shown(driver)
    frame = driver.state.frame
    assert paused == pytest.approx(shown(drive(frame=frame)), rel=0.01)


def test_a_pipeline_settles_whatever_it_did_before(sensor: Sensor, press: FrameSource) -> None:
    areas = []
    for before in ((), (110,), range(FRAME - 5, FRAME)):
        pipeline = Pipeline.of(sensor)
        for k in before:
            pipeline.process(press[k], frozenset({"patch"}))
        pipeline.settle(press[FRAME])
        areas.append(pipeline.process(press[FRAME], frozenset({"patch"})).patch.area_m2)
    assert areas[0] == areas[1] == areas[2]


class Waiting(QObject):
    """A solver that answers in the order it is told to."""

    answered = Signal(object)

    def __init__(self) -> None:
        super().__init__()
        self.server, self.requests = Server(), list[Request]()

    def ask(self, request: Request) -> None:
        self.requests.append(request)

    def answer(self, request: Request) -> None:
        self.answered.emit(self.server.serve(request))

    def close(self) -> None:
        self.server.close()


def test_what_is_asked_for_meanwhile_is_not_lost(qtbot: QtBot, sensor: Sensor) -> None:
    """A panel that opens while the frame is being settled keeps its look at it."""
    solver, plain = Waiting(), Demand(frozenset({"estimate", "patch"}))
    client = SensorClient(SessionState(), solver)
    solver.answer(OpenRequest(1, "dent", DentSource, lambda: sensor, 3, plain))
    client.ask_settled()
    client.ask_frame(3, plain.looking(frozenset({"kappa_curve"})))
    settling, frame = solver.requests
    solver.answer(frame)
    solver.answer(settling)
    assert client.inspection.kappa_curve is not None
    assert not client.settled
    client.ask_settled()
    solver.answer(solver.requests[-1])
    assert client.inspection.kappa_curve is not None
    assert client.settled
    client.close()


def test_a_look_at_a_frame_that_did_not_come_is_asked_for_again(
    qtbot: QtBot, sensor: Sensor
) -> None:
    """Looks are left out of most frames while playing, but not because of one that never came."""
    solver, state = Waiting(), SessionState()
    demand = Demand(frozenset({"estimate", "patch", "kappa_curve"}))
    client = SensorClient(state, solver)
    solver.answer(OpenRequest(1, "dent", DentSource, lambda: sensor, 3, demand.looking()))
    state.open(client.facts, 3, playing=True, history=client.history)
    client.ask_newest(demand)
    client.ask_frame(3, demand)
    newest, frame = solver.requests
    assert newest.demand.looks and not frame.demand.looks
    solver.answer(newest)  # there is none: the source does not grow
    client.ask_frame(3, demand)
    solver.answer(solver.requests[-1])
    assert client.inspection.kappa_curve is not None
    client.close()
