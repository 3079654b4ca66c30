"""Axes, scale bar and colour bars: correct values, no overlaps."""

import re

import numpy as np
import pytest
from PySide6.QtWidgets import QApplication
from vtkmodules.vtkRenderingAnnotation import vtkScalarBarActor
from window_driver import axes_corner, screen_point, view_texts, vtk_props

from bubbleviz_ui.view3d.text import MIN_HEIGHT, TEXT, WIDTH


def seen_of_axes(driver):
    """Pixels (height, width) that the layer changes."""
    pictures = []
    for layers in ({"rim"}, {"rim", "axes"}):
        driver.choose(layers=frozenset(layers))
        pictures.append(driver.pixels().astype(int))
    return np.abs(pictures[1] - pictures[0]).max(axis=2) > 40


def said_m(driver):
    """Length shown by the scale bar."""
    (said,) = (text for text in view_texts(driver) if re.fullmatch(r"[\d.]+ mm", text))
    return 1e-3 * float(said.split()[0])


def test_membrane_left_of_colour_bars_and_scale_bar_of_correct_length(drive):
    """Also after resizing the window."""
    driver = drive()
    window = driver.window
    mesh = driver.pipeline.mesh
    for size in ((1280, 800), (1024, 700), (1000, 900)):
        window.resize(*size)
        QApplication.processEvents()
        driver.wait_until_shown()
        places = [screen_point(driver, node) for node in mesh.nodes[mesh.rim]]
        across = [place.x() for place in places]
        assert min(across) >= -1 and max(across) <= 0.98 * window.view.width() - WIDTH + 1, size
    # the scale bar in a large and a small view, from far and near
    window, lengths = driver.window, set[float]()
    view = window.view
    for size, nearer in (((1280, 800), 1.0), ((1280, 800), 8.0), ((800, 500), 30.0)):
        window.resize(*size)
        window.scene.look_from("top")
        view.camera.Dolly(nearer)
        seen = seen_of_axes(driver)
        corner = axes_corner(seen)
        assert (seen & corner).any()  # the axes themselves
        seen &= ~corner
        assert not (seen[0] | seen[-1]).any() and not (seen[:, 0] | seen[:, -1]).any()
        ends = np.flatnonzero(seen[-12:].any(axis=0))  # below the number
        middle, half = np.array(view.camera.focal_point), np.array([said_m(driver) / 2.0, 0.0, 0.0])
        left, right = (screen_point(driver, middle + side * half).x() for side in (-1.0, 1.0))
        assert np.ptp(ends) == pytest.approx(right - left, abs=3) and right - left > 25
        assert f"{said_m(driver):.0e}"[0] in "125"
        lengths.add(said_m(driver))
    assert len(lengths) == 3
    # colour bars adapt their number of labels: no overlap
    driver.state.change(layers=frozenset({"membrane", "cloud"}))
    window.scene.reset_view()
    driver.wait(lambda: driver.result.cloud_residual_m is not None)  # before, no second bar
    counts = []
    for height in (700, 340, 100):
        window.resize(1024, height)
        window.view.camera.Azimuth(180.0)  # nothing behind the bars
        window.view.camera.Dolly(0.1)
        driver.wait_until_shown()
        ink = driver.pixels()[:, -WIDTH + 20 :].min(axis=2) > 120  # right of the colours
        rows = np.flatnonzero(np.diff(np.r_[0, ink.any(axis=1), 0])).reshape(-1, 2)
        assert (rows[1:, 0] - rows[:-1, 1]).min() >= 2
        assert rows[0, 0] > 0 and rows[-1, 1] < window.view.height()
        counts.append(int(np.count_nonzero(np.diff(rows, axis=1) <= TEXT)))
    of_a_title = 2  # the other one's rows touch
    assert counts == [10 + of_a_title, 6 + of_a_title, 4 + of_a_title]
    assert window.view.height() == MIN_HEIGHT
    # scales end at round numbers in every unit
    driver.seek(11)
    bars = [prop for prop in vtk_props(driver) if isinstance(prop, vtkScalarBarActor)]
    driver.state.change(layers=frozenset({"membrane", "cloud"}))
    for units in ({"pressure_unit": "kPa"}, {"pressure_unit": "psi"}, {"length_unit": "m"}):
        driver.choose(**units)
        ends = [bar.GetLookupTable().GetRange()[1] for bar in bars if bar.GetVisibility()]
        assert len(ends) == 2
        assert all(float(f"{end:.2g}") == pytest.approx(end, rel=1e-9) for end in ends), ends
    driver.state.change(pressure_max_pa=2.2 * 6894.757293168)  # typed: not rounded
    driver.wait_until_shown()
    assert any(bar.GetLookupTable().GetRange()[1] == pytest.approx(2.2) for bar in bars)
