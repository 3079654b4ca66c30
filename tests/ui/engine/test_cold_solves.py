"""The result of a paused frame does not depend on the frames shown before."""

from collections import Counter

import numpy as np
import pytest
from fakes import DentSource
from window_driver import CONTACT, view_texts

from bubbleviz_ui.engine.sensor_client import SensorClient
from bubbleviz_ui.engine.solver import OpenRequest
from bubbleviz_ui.engine.source import Source
from bubbleviz_ui.model.demand import Demand
from bubbleviz_ui.model.session_state import SessionState


def solved_from_rest(driver):
    """Wait for the cold solve of the frame at the cursor."""
    driver.wait(lambda: driver.shows_cursor_frame() and driver.window.controller.cold_solved)


def shown(driver):
    """Force, N, and area, m², of the patch shown, after its cold solve."""
    solved_from_rest(driver)
    patch = driver.result.patch
    return float(np.linalg.norm(patch.force_n)), patch.area_m2


def play_past(driver, frame):
    driver.click(driver.window.playback.buttons["Play / pause"])
    driver.wait(lambda: driver.state.frame >= frame)
    driver.click(driver.window.playback.buttons["Play / pause"])


def opened(driver, press, frame):
    """Open the press again, which forgets the frames solved before."""
    driver.show_source(lambda _: press, frame=frame)
    return shown(driver)


def test_result_is_the_same_however_a_frame_is_reached_and_of_the_present_settings(drive, press):
    driver = drive(frame=CONTACT)
    alone = shown(driver)
    opened(driver, press, 110)
    driver.state.seek(CONTACT)
    assert shown(driver) == pytest.approx(alone, rel=0.01)
    driver.seek(CONTACT - 3)
    for _ in range(3):
        driver.click(driver.window.playback.buttons["Next frame"])
    assert driver.state.frame == CONTACT
    stepped = shown(driver)
    assert stepped == pytest.approx(alone, rel=0.01)
    label = driver.window.status.labels["area"].text()
    assert label == f"patch {1e6 * stepped[1]:.0f} mm²"
    driver.seek(CONTACT - 3)
    driver.state.change(every_frame=True)
    play_past(driver, CONTACT)
    paused = shown(driver)
    again = opened(driver, press, driver.state.frame)
    assert paused == pytest.approx(again, rel=0.01)
    # a cold solve uses settings changed meanwhile
    driver.seek(CONTACT)
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
    # a panel opened during the cold solve gets its diagnostics
    for frame in (CONTACT - 9, CONTACT - 6):
        driver.state.seek(frame)
        controller.cold_solve()
        driver.show("threshold")
        driver.wait(lambda: controller.inspection.kappa_curve is not None)
        solved_from_rest(driver)
        assert controller.inspection.kappa_curve is not None
        driver.window.panels["threshold"].hide()


def test_a_force_that_the_next_pause_may_change_is_marked_and_its_pose_registered_once(drive):
    driver, marked = drive(frame=CONTACT - 3), []
    controller, label = driver.window.controller, driver.window.status.labels["force"]

    def texts():
        (head,) = (text for text in view_texts(driver) if text.startswith("contact  "))
        return head, label.text(), driver.window.kappa.force.text()

    def note(_):
        marked.append({"≈" in text for text in texts()} == {not controller.client.cold_solved})

    assert not any("≈" in text for text in texts())
    controller.shown.connect(note)
    driver.state.change(every_frame=True)
    play_past(driver, CONTACT)
    solved_from_rest(driver)
    controller.shown.disconnect(note)
    assert len(marked) > 3 and all(marked) and not any("≈" in text for text in texts())
    # its pose is registered once, also if images, which are skipped during playback, are due
    driver.seek(CONTACT + 20)
    driver.show("pose", "images")
    driver.choose(every_frame=True, pose_object="sphere", pose_track=True)
    client, found = driver.window.controller.client, Counter[int]()

    def note(answer, newest):
        if "pose" in answer.result.times_ms:
            found[answer.result.frame.index] += 1

    client.solved.connect(note)
    play_past(driver, CONTACT + 23)
    solved_from_rest(driver)
    assert client.demand.images and not client.images_outdated
    assert driver.result.pose is not None
    assert found[driver.state.frame] == 1
    client.solved.disconnect(note)


class Waiting:
    """A worker that runs submitted functions in a given order."""

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
WITH_IMAGE = Demand(PLAIN.products | {"depth_image"})


@pytest.fixture
def state():
    return SessionState()


@pytest.fixture
def client(qtbot, sensor, state):
    """Client of a source opened at frame 3."""
    made = SensorClient(state)
    made.worker.close()
    made.worker = Waiting()
    made.open(OpenRequest(Source("dent", DentSource), lambda: sensor, 3, PLAIN))
    made.worker.run(-1)
    yield made
    made.solver.close()


def test_requests_during_a_cold_solve_are_not_lost(client):
    client.request_cold_solve()
    client.request_frame(3, WITH_IMAGE)
    client.worker.run(-1)
    client.worker.run(-2)
    assert "depth" in client.inspection.images and not client.cold_solved
    client.request_cold_solve()
    client.worker.run(-1)
    assert "depth" in client.inspection.images and client.cold_solved


def test_an_image_that_did_not_arrive_is_requested_again(client, state):
    """During playback most frames have no images, but a missing frame must not delay them."""
    state.open(client.facts, 3, playing=True, history=client.history)
    client.request_newest(WITH_IMAGE)
    client.worker.run(-1)  # no frame: the source does not grow
    client.request_frame(3, WITH_IMAGE)
    client.worker.run(-1)
    assert "depth" in client.inspection.images


def test_a_frame_shown_again_is_final_at_once(client):
    client.request_cold_solve()
    client.worker.run(-1)
    cold = client.result.estimate
    for frame in (0, 3):
        client.request_frame(frame, WITH_IMAGE)
        client.worker.run(-1)
    assert client.result.estimate is cold and client.cold_solved
    assert client.result.patch is not None and "depth" in client.inspection.images
    client.request_frame(2, PLAIN)
    client.worker.run(-1)
    assert not client.cold_solved
