"""Pressure without evidence of contact is hatched and named, wherever one looks at it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fakes import DentSource, small_sensor
from PySide6.QtCore import QPoint
from window_driver import Driver, hover, in_view, texts, warm

from bubbleviz.pipeline import Pipeline
from bubbleviz.result import Result
from bubbleviz.sensor import Sensor
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.colour_maps import rgb

Drive = Callable[..., Driver]
PRESSED = 6
ASIDE_M, WITHIN_M = np.array([-0.03, -0.03]), 0.012
"""Middle in B of pressure that is no evidence, and how far from there nodes have it."""
PRESSURE_PA = 1730.0
TOLD = "pressure without evidence of contact, not in the force"


@pytest.fixture
def opened(drive: Drive, monkeypatch: pytest.MonkeyPatch) -> Callable[[], Driver]:
    """Open a window on a dent, where every estimate of contact has pressure on the other side."""
    process = Pipeline.process

    def leaving_pressure(pipeline: Pipeline, *frame: Any, **options: Any) -> Result:
        result = process(pipeline, *frame, **options)
        estimate = result.estimate
        if estimate is None or estimate.status != "ok":
            return result
        away = np.linalg.norm(pipeline.mesh.nodes[:, :2] - ASIDE_M, axis=1)
        left = np.where(away < WITHIN_M, PRESSURE_PA, 0.0)
        return replace(result, estimate=replace(estimate, unexplained_pressure_pa=left))

    monkeypatch.setattr(Pipeline, "process", leaving_pressure)

    def open_window() -> Driver:
        driver = drive(DentSource, sensor=rubber(), frame=PRESSED)
        driver.state.choose(layers=driver.state.choices.layers - {"cloud"})
        driver.settle()
        return driver

    return open_window


def rubber() -> Sensor:
    sensor = small_sensor()
    known = sensor.membrane.model_copy(update={"prestretch": 1.3})
    return sensor.model_copy(update={"membrane": known})


def strokes(driver: Driver) -> np.ndarray:
    """Column and row of the pixels of the hatching, (k, 2)."""
    pixels = driver.window.view.pixels()
    return np.argwhere(np.all(pixels == rgb(theme.UNTRUSTED), axis=2))[:, ::-1]


def middle(driver: Driver) -> np.ndarray:
    """Where the middle of that pressure is drawn, (3,) in B."""
    nodes = driver.pipeline.mesh.deformed(driver.window.controller.result.estimate.motion_m)
    return nodes[np.argmin(np.linalg.norm(nodes[:, :2] - ASIDE_M, axis=1))]


def test_it_is_hatched_where_it_is_and_not_in_the_colours_of_contact(
    opened: Callable[[], Driver],
) -> None:
    driver = opened()
    drawn, place = strokes(driver), in_view(driver, middle(driver))
    low, high = drawn.min(axis=0), drawn.max(axis=0)
    assert (low < place.toTuple()).all() and (place.toTuple() < high).all()
    assert len(drawn) > 300 and (high - low < 180).all()
    # the strokes of a diagonal hatching: along each row of pixels many begin and end
    rows = [np.sort(drawn[drawn[:, 1] == row, 0]) for row in range(low[1] + 8, high[1] - 8)]
    assert np.median([np.count_nonzero(np.diff(row) > 1) for row in rows]) >= 3
    contact = warm(driver.window.view.pixels())[:, ::-1]
    assert len(contact) > 100
    assert not ((contact >= low) & (contact <= high)).all(axis=1).any()
    driver.state.choose(layers=driver.state.choices.layers - {"membrane"})
    driver.settle()
    assert not len(strokes(driver))


def test_it_is_cut_with_the_membrane(opened: Callable[[], Driver]) -> None:
    driver = opened()
    driver.state.choose(section_axis="y", section_at_m=float(ASIDE_M[1]))
    driver.settle()
    cut = len(strokes(driver))
    driver.state.choose(section_at_m=0.0)
    driver.settle()
    whole_or_none = len(strokes(driver))
    driver.state.choose(section_axis=None)
    driver.settle()
    assert 0 < cut < len(strokes(driver))
    assert whole_or_none in (0, pytest.approx(len(strokes(driver)), rel=0.05))


def test_the_readout_says_what_the_hatching_means(opened: Callable[[], Driver]) -> None:
    driver = opened()
    legend = f"hatched: {TOLD}"
    assert any(legend in text for text in texts(driver))
    assert TOLD in driver.window.layers.boxes["membrane"].toolTip()
    driver.seek(0)
    assert not any("hatched" in text for text in texts(driver)) and not len(strokes(driver))


def test_who_points_there_reads_how_much_it_is(opened: Callable[[], Driver]) -> None:
    driver = opened()
    driver.window.panels["images"].show()
    driver.settle()
    place = in_view(driver, middle(driver))
    hover(driver.window.view, place)
    driver.wait(lambda: any("node" in text for text in texts(driver)))
    said = "1.73 kPa without evidence of contact"
    assert any(said in text for text in texts(driver))
    assert said in driver.window.images.lines[2].text()
    hover(driver.window.view, QPoint(5, 5))
    driver.window.hover.at_point(driver.window.controller.result.patch.center_of_pressure_m)
    assert not any(said in text for text in texts(driver))
    assert "p_c" in driver.window.images.lines[2].text()
