"""Pressure without evidence of contact is hatched and named, wherever one looks at it."""

from dataclasses import replace

import numpy as np
import pytest
from fakes import DentSource, small_sensor
from PySide6.QtCore import QPoint
from window_driver import hover, in_view, texts

from bubbleviz.pipeline import Pipeline
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.colours import rgb

PRESSED = 6
ASIDE_M, WITHIN_M = np.array([-0.03, -0.03]), 0.012
"""Middle in B of pressure that is no evidence, and how far from there nodes have it."""
PRESSURE_PA = 1730.0
TOLD = "pressure without evidence of contact, not in the force"


@pytest.fixture
def driver(drive, monkeypatch):
    """A window on a dent, where every estimate of contact has pressure on the other side."""
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
    made.let_go()


def strokes(driver):
    """Column and row of the pixels of the hatching, (k, 2)."""
    return np.argwhere(np.all(driver.pixels() == rgb(theme.UNTRUSTED), axis=2))[:, ::-1]


def middle(driver):
    """Where the middle of that pressure is drawn."""
    nodes = driver.nodes()
    return in_view(driver, nodes[np.argmin(np.linalg.norm(nodes[:, :2] - ASIDE_M, axis=1))])


def test_it_is_hatched_where_it_is_and_named(driver):
    drawn, place = strokes(driver), middle(driver).toTuple()
    low, high = drawn.min(axis=0), drawn.max(axis=0)
    assert (low < place).all() and (place < high).all()
    assert len(drawn) > 300 and (high - low < 180).all()
    # the strokes of a diagonal hatching: along each row of pixels many begin and end
    rows = [np.sort(drawn[drawn[:, 1] == row, 0]) for row in range(low[1] + 8, high[1] - 8)]
    assert np.median([np.count_nonzero(np.diff(row) > 1) for row in rows]) >= 3
    contact = driver.warm_pixels()[:, ::-1]
    assert len(contact) > 100
    assert not ((contact >= low) & (contact <= high)).all(axis=1).any()
    # it is cut with the membrane, and hidden with it
    driver.choose(section_axis="y", section_at_m=float(ASIDE_M[1]))
    assert 0 < len(strokes(driver)) < len(drawn)
    driver.choose(section_at_m=0.0)
    assert len(strokes(driver)) in (0, pytest.approx(len(drawn), rel=0.05))
    layers = driver.state.settings.layers - {"membrane"}
    driver.choose(section_axis=None, layers=layers)
    assert not len(strokes(driver))
    # the readout says what it means, and who points there reads how much it is
    driver.choose(layers=layers | {"membrane"})
    says = lambda words: any(words in text for text in texts(driver))  # noqa: E731
    assert says(f"hatched: {TOLD}")
    assert TOLD in driver.window.layers.boxes["membrane"].toolTip()
    driver.show("images")
    driver.settle()
    hover(driver.window.view, middle(driver))
    driver.wait(lambda: says("node"))
    said = "1.73 kPa without evidence of contact"
    assert says(said) and said in driver.window.images.lines[2].text()
    hover(driver.window.view, QPoint(5, 5))
    driver.window.hover.at_point(driver.result.patch.center_of_pressure_m)
    assert not says(said) and "p_c" in driver.window.images.lines[2].text()
    driver.seek(0)
    assert not says("hatched") and not len(strokes(driver))
