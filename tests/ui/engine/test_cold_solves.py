"""A frame one stays at has one answer, however one came to it."""

from collections import Counter

import numpy as np
import pytest
from fakes import DentSource
from window_driver import CONTACT

from bubbleviz_ui.engine.sensor_client import SensorClient
from bubbleviz_ui.engine.solver import OpenRequest
from bubbleviz_ui.engine.source import Source
from bubbleviz_ui.model.demand import Demand
from bubbleviz_ui.model.session_state import SessionState


def settled_by_itself(driver):
    """Wait until the window has settled the frame at the cursor."""
    driver.wait(lambda: driver.at_the_cursor() and driver.window.controller.cold_solved)


def shown(driver):
    """Force, N, and area, m², of the patch that is shown, once nothing changes any more."""
    settled_by_itself(driver)
    patch = driver.result.patch
    return float(np.linalg.norm(patch.force_n)), patch.area_m2


def play_past(driver, frame):
    driver.click(driver.window.playback.play)
    driver.wait(lambda: driver.state.frame >= frame)
    driver.click(driver.window.playback.play)


def test_opened_sought_stepped_and_played_to_a_frame_has_the_same_area(drive):
    opened = drive(frame=CONTACT)
    alone = shown(opened)
    driver = drive(frame=110)
    driver.state.seek(CONTACT)
    assert shown(driver) == pytest.approx(alone, rel=0.01)
    driver.seek(CONTACT - 3)
    for _ in range(3):
        driver.click(driver.window.playback.forward)
    assert driver.state.frame == CONTACT
    stepped = shown(driver)
    assert stepped == pytest.approx(alone, rel=0.01)
    label = driver.window.status.labels["area"].text()
    assert label == f"patch {1e6 * stepped[1]:.0f} mm²"
    driver.seek(CONTACT - 3)
    driver.state.change(every_frame=True)
    play_past(driver, CONTACT)
    paused = shown(driver)
    opened.state.seek(driver.state.frame)
    assert paused == pytest.approx(shown(opened), rel=0.01)


def test_a_paused_frame_has_its_pose_found_once(drive):
    """Also where closer looks, which are left out while playing, are due with it."""
    driver = drive(frame=CONTACT - 3)
    driver.show("pose", "images")
    driver.choose(every_frame=True, pose_object="sphere", pose_track=True)
    client, found = driver.window.controller.client, Counter[int]()

    def note(answer, newest):
        if "pose" in answer.result.times_ms:
            found[answer.result.frame.index] += 1

    client.solved.connect(note)
    play_past(driver, CONTACT)
    settled_by_itself(driver)
    assert client.demand.diagnostics and not client.diagnostics_outdated
    assert driver.result.pose is not None
    assert found[driver.state.frame] == 1


def test_a_frame_is_settled_with_what_was_chosen_since(drive):
    driver = drive(frame=CONTACT)
    controller, areas = driver.window.controller, list[float]()
    driver.state.change(least_area_m2=0.01)
    driver.wait(lambda: driver.result.patch.area_m2 == 0.0)

    def note(answer, newest):
        areas.append(answer.result.patch.area_m2)

    controller.client.solved.connect(note)
    controller.cold_solve()
    driver.wait(lambda: bool(areas))
    assert areas == [0.0]
    controller.client.solved.disconnect(note)
    # a panel that opens while the frame is being settled has its look at it
    for frame in (CONTACT + 1, CONTACT + 2):
        driver.state.seek(frame)
        controller.cold_solve()
        driver.show("threshold")
        driver.wait(lambda: controller.inspection.kappa_curve is not None)
        settled_by_itself(driver)
        assert controller.inspection.kappa_curve is not None
        driver.window.panels["threshold"].hide()


class Waiting:
    """A worker that runs what is submitted in the order it is told to."""

    def __init__(self):
        self.submitted = []

    def submit(self, function, then, **_):
        self.submitted.append((function, then))
        return False

    def drop(self, key):
        return False

    def has_more_urgent(self, key):
        return False

    def run(self, number):
        function, then = self.submitted[number]
        then(function())


PLAIN = Demand(frozenset({"estimate", "patch"}))
WITH_DIAGNOSTICS = PLAIN.with_diagnostics(frozenset({"kappa_curve"}))


@pytest.fixture
def state():
    return SessionState()


@pytest.fixture
def client(qtbot, sensor, state):
    """What asks for frames of a source that is open at frame 3."""
    made = SensorClient(state)
    made.worker.close()
    made.worker = Waiting()
    made.open(OpenRequest(Source("dent", DentSource), lambda: sensor, 3, PLAIN))
    made.worker.run(-1)
    yield made
    made.solver.close()


def test_what_is_asked_for_while_a_frame_is_settled_is_not_lost(client):
    client.request_cold_solve()
    client.request_frame(3, WITH_DIAGNOSTICS)
    client.worker.run(-1)
    client.worker.run(-2)
    assert client.inspection.kappa_curve is not None and not client.cold_solved
    client.request_cold_solve()
    client.worker.run(-1)
    assert client.inspection.kappa_curve is not None and client.cold_solved


def test_a_diagnostic_that_did_not_arrive_is_requested_again(client, state):
    """Looks are left out of most frames while playing, but not because of one that never came."""
    state.open(client.facts, 3, playing=True, history=client.history)
    client.request_newest(WITH_DIAGNOSTICS)
    client.worker.run(-1)  # there is none: the source does not grow
    client.request_frame(3, WITH_DIAGNOSTICS)
    client.worker.run(-1)
    assert client.inspection.kappa_curve is not None
