"""Frames for the calibration are collected from a live source."""

from __future__ import annotations

from dataclasses import replace

import pytest
from calibration_bench import CTRL, Bench, Drive, answered
from PySide6.QtCore import Qt
from resting import REST, TENSION, RestingSource

from bubbleviz.frames.frame import Frame
from bubbleviz.sensor import Sensor
from bubbleviz_ui.calibration.frame_collector import FIRST_LOOK

PERIOD_S = 1.0 / 60.0
"""Of the camera: pictures of frames that come faster would take the time of what is computed."""


def test_frames_are_collected_live_until_the_interval_is_small(drive: Drive) -> None:
    bench = Bench(
        drive(lambda s: RestingSource(s, fresh=True, slow_s=PERIOD_S), playing=True, live=True)
    )
    panel, box = bench.panel, bench.panel.frames.collect
    assert not panel.next.isEnabled() and box.isVisible()
    box.count.setValue(400)
    box.target.setValue(5.0)
    bench.click(box.button)
    bench.driver.wait(lambda: len(box.collector.frames) >= FIRST_LOOK)
    bench.driver.state.set_playing(False)  # no pictures while the estimate is computed
    bench.driver.wait(lambda: not box.collector.active)
    bench.done()
    draft = panel.calibration.answer.draft
    frames = len(draft.samples.frames)
    assert 10 <= frames < 400
    tension = draft.tension.tension
    assert tension.half_width <= 0.05 * tension.value
    assert tension.value == pytest.approx(TENSION, rel=0.02)
    collected = panel.calibration.work.collected
    assert max(collected[k].index for k in range(len(collected))) < REST + 2  # no contact
    bench.undo()
    assert panel.calibration.work.collected is None


def test_collecting_is_cancelled_and_a_repeating_source_gives_nothing_twice(
    drive: Drive, resting: RestingSource
) -> None:
    frames = [resting[k] for k in range(len(resting))]

    read = list[int]()

    class Loop(RestingSource):
        def __getitem__(self, index: int):
            read.append(index)
            return frames[index]

    bench = Bench(drive(Loop, playing=True, live=True))
    box = bench.panel.frames.collect
    bench.click(box.button)
    collector = box.collector
    bench.driver.wait(lambda: len(collector.frames) >= 10)
    before = len(read)
    bench.driver.wait(lambda: len(read) > before + len(frames) + 5)  # more than one round
    assert len(collector.frames) <= REST + 2
    bench.click(box.cancel)
    assert not collector.active and bench.panel.calibration.work.collected is None


def test_frames_are_collected_live_again_and_replace_those_before(drive: Drive) -> None:
    stuck = list[Frame]()  # the camera's, while it repeats one image

    class Camera(RestingSource):
        def __getitem__(self, index: int) -> Frame:
            frame = super().__getitem__(index)
            return replace(frame, depth_m=stuck[0].depth_m) if stuck else frame

    bench = Bench(drive(lambda s: Camera(s, fresh=True, slow_s=PERIOD_S), playing=True, live=True))
    panel, box = bench.panel, bench.panel.frames.collect
    box.count.setValue(8)
    assert box.button.text() == "Collect 8 frames"
    bench.click(box.button)
    bench.driver.wait(lambda: not box.collector.active)
    bench.done()
    bench.click(panel.steps.button(1))
    panel.pixels.deviations.box.setValue(4.0)
    bench.done()
    old, work = panel.calibration.answer, panel.calibration.work
    bench.click(panel.steps.button(0))
    assert (
        box.button.text() == "Collect again: 8 frames" and box.said.text() == "8 frames collected."
    )
    box.count.setValue(2000)
    bench.click(box.button)
    bench.driver.wait(lambda: len(box.collector.frames) >= 3)
    assert "until then the 8 frames collected before are in use" in box.said.text()
    bench.click(box.cancel)
    assert panel.calibration.work == work and panel.calibration.answer is old
    stuck.append(panel.calibration.work.collected[0])
    bench.click(box.button)
    bench.driver.wait(lambda: len(box.collector.frames) > 0)
    bench.click(box.stop)  # too few: refused, and nothing of the old frames passes for theirs
    assert "at least 5" in bench.driver.window.message.label.text()
    assert panel.verdict.text().startswith("Out of date")
    assert panel.steps.button(0).toolTip().endswith("needs attention")
    stuck.clear()
    box.count.setValue(9)
    bench.click(box.button)
    bench.driver.wait(lambda: not box.collector.active)
    bench.done()
    new = panel.calibration.answer
    assert len(new.draft.samples.frames) == 9 and new.work.settings.deviations == 4.0
    assert new.draft.tension.tension.value != old.draft.tension.tension.value
    assert f"{new.draft.tension.tension.value:.1f} N/m" in panel.verdict.text()
    assert "Out of date" not in panel.verdict.text()


def test_collected_frames_outlive_close_and_connecting_again(drive: Drive) -> None:
    bench = Bench(
        drive(lambda s: RestingSource(s, fresh=True, slow_s=PERIOD_S), playing=True, live=True)
    )
    window, panel, box = bench.driver.window, bench.panel, bench.panel.frames.collect
    sensor = window.controller.sensor

    def connect(sensor: Sensor) -> None:
        again = lambda s: RestingSource(s, fresh=True, slow_s=PERIOD_S)  # noqa: E731
        window.controller.opening.open("resting", again, lambda: sensor, live=True)

    box.count.setValue(8)
    bench.click(box.button)
    bench.driver.wait(lambda: not box.collector.active)
    bench.done()
    answer, work = panel.calibration.answer, panel.calibration.work
    box.count.setValue(2000)
    bench.click(box.button)
    bench.driver.wait(lambda: len(box.collector.frames) >= 3)
    bench.key(Qt.Key.Key_W, CTRL)
    bench.driver.wait(lambda: bench.driver.state.facts.nothing)
    bench.driver.settle()
    begun = len(box.collector.frames)
    assert panel.calibration.work is work and panel.calibration.answer is answer
    assert "Nothing is open" in box.said.text() and not box.button.isEnabled()
    connect(sensor)
    bench.driver.wait(lambda: len(box.collector.frames) > begun)
    assert panel.calibration.work is work and panel.calibration.answer is answer
    bench.click(box.cancel)
    assert box.said.text() == "8 frames collected." and panel.verdict.isVisible()
    smaller = sensor.camera.model_copy(update={"width": 64, "height": 48})
    other = sensor.model_copy(update={"camera": smaller})
    assert "resting is not saved" in answered(bench, lambda: connect(other), "Discard")
    bench.driver.wait(lambda: panel.calibration.work.collected is None)
