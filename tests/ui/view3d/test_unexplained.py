"""Pressure without evidence of contact is hatched and explained."""

from dataclasses import replace

import numpy as np
import pytest
from fakes import DentSource, small_sensor
from PySide6.QtCore import QPoint
from window_driver import hover, screen_point, view_texts

from bubbleviz.pipeline import Pipeline
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.colours import rgb

PRESSED = 6
ASIDE_M, WITHIN_M = np.array([-0.03, -0.03]), 0.012
"""Centre in B, and radius, of the pressure without evidence of contact."""
PRESSURE_PA = 1730.0
TOLD = "pressure without evidence of contact, not in the force"


@pytest.fixture
def driver(drive, monkeypatch):
    """A window on a dent, with pressure without evidence added on the other side."""
    process = Pipeline.process

    def leaving_pressure(pipeline, *frame, **options):
        result = process(pipeline, *frame, **options)
        estimate = result.estimate
        if estimate is None or estimate.status != "ok":
            return result
        away = np.linalg.norm(pipeline.mesh.nodes[:, :2] - ASIDE_M, axis=1)
        left = np.where(away < WITHIN_M, PRESSURE_PA, 0.0)
        return replace(result, estimate=replace(estimate, unexplained_pressure_pa=left))

    monkeypatch.setattr(Pipeline, "process", leaving_pressure)
    made = drive(DentSource, sensor=small_sensor(prestretch=1.3), frame=PRESSED)
    made.choose(layers=made.state.settings.layers - {"cloud"})
    yield made
    made.release()


def strokes(driver):
    """Column and row of the pixels of the hatching, (k, 2)."""
    return np.argwhere(np.all(driver.pixels() == rgb(theme.UNTRUSTED), axis=2))[:, ::-1]


def middle(driver):
    """Position of its centre in the view."""
    nodes = driver.nodes()
    return screen_point(driver, nodes[np.argmin(np.linalg.norm(nodes[:, :2] - ASIDE_M, axis=1))])


def test_unexplained_pressure_is_hatched_and_explained(driver):
    drawn, place = strokes(driver), middle(driver).toTuple()
    low, high = drawn.min(axis=0), drawn.max(axis=0)
    assert (low < place).all() and (place < high).all()
    assert len(drawn) > 300 and (high - low < 180).all()
    # diagonal hatching: many strokes along each pixel row
    rows = [np.sort(drawn[drawn[:, 1] == row, 0]) for row in range(low[1] + 8, high[1] - 8)]
    assert np.median([np.count_nonzero(np.diff(row) > 1) for row in rows]) >= 3
    contact = driver.pressure_pixels()[:, ::-1]
    assert len(contact) > 100
    assert not ((contact >= low) & (contact <= high)).all(axis=1).any()
    # clipped and hidden with the membrane
    driver.choose(section_axis="y", section_at_m=float(ASIDE_M[1]))
    assert 0 < len(strokes(driver)) < len(drawn)
    driver.choose(section_at_m=0.0)
    assert len(strokes(driver)) in (0, pytest.approx(len(drawn), rel=0.05))
    layers = driver.state.settings.layers - {"membrane"}
    driver.choose(section_axis=None, layers=layers)
    assert not len(strokes(driver))
    # the readout explains it, the probe shows its value
    driver.choose(layers=layers | {"membrane"})
    says = lambda words: any(words in text for text in view_texts(driver))  # noqa: E731
    assert says(f"hatched: {TOLD}")
    assert TOLD in driver.window.layers.boxes["membrane"].toolTip()
    driver.show("images")
    driver.wait_until_shown()
    hover(driver.window.view, middle(driver))
    driver.wait(lambda: says("node"))
    there = driver.window.hover.place.unexplained_pa  # the middle's, but for rounding to a pixel
    assert there == pytest.approx(PRESSURE_PA, rel=0.1)
    said = f"{1e-3 * there:.2f} kPa without evidence of contact"
    assert says(said) and said in driver.window.images.lines[2].text()
    hover(driver.window.view, QPoint(5, 5))
    driver.window.hover.at_point(driver.result.patch.center_of_pressure_m)
    assert not says(said) and "p_c" in driver.window.images.lines[2].text()
    driver.seek(0)
    assert not says("hatched") and not len(strokes(driver))
