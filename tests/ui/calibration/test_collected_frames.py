"""Collection of live frames for the calibration."""

import re
from dataclasses import replace

import pytest
from calibration_bench import Bench, answered
from PySide6.QtCore import Qt
from resting import FRAMES, REST, TENSION, RestingSource
from window_driver import CTRL

from bubbleviz.recordings import Frame
from tests.small_press import changed

PERIOD_S = 1.0 / 60.0
"""Frame period of the camera; faster frames would take CPU time from the calibration."""


class Camera(RestingSource):
    """New noise in each frame; `stuck` repeats the image of one frame."""

    def __init__(self, sensor):
        super().__init__(sensor, fresh=True, slow_s=PERIOD_S)
        self.stuck: Frame | None = None

    def __getitem__(self, index):
        frame = super().__getitem__(index)
        if self.stuck is None:
            return frame
        return replace(self.stuck, index=index, time_s=frame.time_s)


@pytest.fixture
def camera(sensor):
    return Camera(sensor)


def test_live_frames_without_contact_are_collected_for_gamma0(drive, camera):
    """From a deep press on, which is implausible and nothing yet shows that the sensor fits."""
    bench = Bench(drive(lambda _: camera, playing=True, live=True))
    panel, box = bench.panel, bench.panel.frames.collect
    camera.stuck = pressed = camera[FRAMES - 1]
    bench.wait(lambda: bench.result.estimate.status == "implausible")
    assert not panel.next.isEnabled() and box.isVisible()
    box.count.setValue(30)
    bench.click(box.button)
    bench.wait(lambda: len(box.frames) == 1)
    camera.stuck = None
    bench.wait(lambda: not box.active)
    bench.done()
    assert len(bench.found.samples.frames) == 30
    tension = bench.found.tension_by_shape
    assert tension.value == pytest.approx(TENSION, rel=0.02)
    collected = panel.calibration.work.collected
    taken = [collected[k] for k in range(len(collected))]
    assert all(frame.depth_m is not pressed.depth_m for frame in taken)
    assert max(frame.index for frame in taken) < REST + 2  # no contact
    bench.undo()
    assert panel.calibration.work.collected is None


def test_collecting_is_cancelled_and_repeated_frames_are_skipped(drive, resting):
    frames, read = list(resting), list[int]()

    class Loop(RestingSource):
        def __getitem__(self, index):
            read.append(index)
            return frames[index]

    bench = Bench(drive(Loop, playing=True, live=True))
    box = bench.panel.frames.collect
    bench.click(box.button)
    bench.wait(lambda: len(box.frames) >= 10)
    before = len(read)
    bench.wait(lambda: len(read) > before + len(frames) + 5)  # more than one loop
    assert len(box.frames) <= REST + 2
    bench.click(box.cancel)
    assert not box.active and bench.panel.calibration.work.collected is None


def refusals(bench):
    """How often too few frames were refused."""
    return sum("at least 5" in message.text for message in bench.window.messages.all)


def test_collecting_again_replaces_the_frames(drive, camera):
    bench = Bench(drive(lambda _: camera, playing=True, live=True))
    panel, box = bench.panel, bench.panel.frames.collect
    box.count.setValue(8)
    assert box.button.text() == "Collect 8 frames"
    bench.collect(8)
    bench.step(1)
    panel.pixels.deviations.box.setValue(4.0)
    bench.done()
    old, work = bench.answer, panel.calibration.work
    bench.step(0)
    assert box.button.text() == "Collect again: 8 frames"
    assert box.message.text() == "8 frames collected."
    box.count.setValue(2000)
    bench.click(box.button)
    bench.wait(lambda: len(box.frames) >= 3)
    assert "until then the 8 frames collected before are in use" in box.message.text()
    bench.click(box.cancel)
    assert panel.calibration.work == work and bench.answer is old
    camera.stuck = panel.calibration.work.collected[0]
    bench.click(box.button)
    bench.wait(lambda: len(box.frames) > 0)
    bench.click(box.stop)  # too few frames: refused, and the old results are not shown for them
    assert "at least 5" in bench.message_text
    assert panel.verdict.text().startswith("Outdated")
    assert panel.steps.button(0).toolTip().endswith("needs attention")
    refused = refusals(bench)
    bench.wait(lambda: panel.next.text() == "Try again")
    bench.click(panel.next)
    bench.wait(lambda: refusals(bench) == refused + 1 and panel.next.text() == "Try again")
    camera.stuck = None
    bench.collect(9)
    bench.wait(lambda: len(bench.answer.found.samples.frames) == 9)
    new = bench.answer
    assert new.work.settings.deviations == 4.0
    assert new.found.tension.value != old.found.tension.value
    shown = float(re.search(r"γ0 = (\S+) N/m", panel.verdict.text())[1])
    assert shown == pytest.approx(new.found.tension.value, rel=0.01)
    assert "Outdated" not in panel.verdict.text()


def test_collected_frames_survive_close_and_reconnecting(drive):
    bench = Bench(drive(Camera, playing=True, live=True))
    panel, box = bench.panel, bench.panel.frames.collect
    sensor = bench.window.controller.sensor

    def connect(sensor):
        bench.open("resting", lambda sensor: Camera(sensor), sensor, live=True)

    def kept():
        return panel.calibration.work is work and bench.answer is answer

    bench.collect(8)
    answer, work = bench.answer, panel.calibration.work
    box.count.setValue(2000)
    bench.click(box.button)
    bench.wait(lambda: len(box.frames) >= 3)
    bench.key(Qt.Key.Key_W, CTRL)
    bench.wait(lambda: bench.state.facts.is_empty)
    bench.wait_until_shown()
    begun = len(box.frames)
    assert kept() and "Nothing is open" in box.message.text() and not box.button.isEnabled()
    connect(sensor)
    bench.wait(lambda: len(box.frames) > begun)
    assert kept()
    bench.click(box.cancel)
    assert box.message.text() == "8 frames collected." and panel.verdict.isVisible()
    other = changed(sensor, camera={"width": 64, "height": 48})
    assert "resting is not saved" in answered(bench, lambda: connect(other), "Discard")
    bench.wait(lambda: panel.calibration.work.collected is None)
