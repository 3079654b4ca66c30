"""A frame one stays at has one answer, however one came to it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from PySide6.QtCore import Qt
from window_driver import Driver

from bubbleviz.frames.frame_source import FrameSource
from bubbleviz.pipeline import Pipeline
from bubbleviz.sensor import Sensor

Drive = Callable[..., Driver]
FRAME = 75


def shown(driver: Driver) -> tuple[float, float]:
    """Force, N, and area, m², of the patch that is shown, once nothing changes any more."""
    driver.settle()
    patch = driver.window.controller.result.patch
    return float(np.linalg.norm(patch.force_n)), patch.area_m2


def test_opened_sought_and_stepped_to_a_frame_has_the_same_area(drive: Drive) -> None:
    alone = shown(drive(frame=FRAME))
    driver = drive(frame=110)
    driver.seek(FRAME)
    sought = shown(driver)
    driver.seek(FRAME - 6)
    driver.window.playback.forward.setFocus()
    for _ in range(6):
        driver.bot.mouseClick(driver.window.playback.forward, Qt.MouseButton.LeftButton)
    assert driver.state.frame == FRAME
    stepped = shown(driver)
    assert sought == pytest.approx(alone, rel=0.01)
    assert stepped == pytest.approx(alone, rel=0.01)
    label = driver.window.status.labels["area"].text()
    assert label == f"patch {1e6 * stepped[1]:.0f} mm²"


def test_playback_that_pauses_settles_its_frame(drive: Drive) -> None:
    driver = drive(frame=FRAME - 10)
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
