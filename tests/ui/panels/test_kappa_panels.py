"""Threshold and comparison by drags, keys and numbers; against the backend and the truth."""

import math

import numpy as np
import pytest
from PySide6.QtCore import QPointF
from PySide6.QtWidgets import QApplication
from window_driver import CONTACT, LEFT, graphics_view, hover, view_texts

from bubbleviz.inverse import EstimatorOptions, components
from bubbleviz.pipeline import Pipeline
from bubbleviz.simulation import iou, truth_of
from bubbleviz.wording import plus_minus


def threshold(driver):
    alone(driver, "threshold")
    driver.wait(lambda: driver.inspection.kappa_curve is not None)
    QApplication.processEvents()
    driver.wait_until_shown()
    return driver.window.threshold


def compare(driver):
    alone(driver, "compare")
    driver.wait(lambda: driver.window.compare.a.values["status"].text() == "ok")
    return driver.window.compare


def alone(driver, name):
    driver.window.resize(1280, 800)
    driver.window.panels["layers"].hide()
    driver.show(name)
    driver.window.panels[name].raise_()


def column(panel, number):
    return [panel.table.item(row, number).text() for row in range(panel.table.rowCount())]


def test_threshold_line_is_dragged_and_a_hidden_comparison_is_not_computed(drive):
    driver = drive(frame=CONTACT)
    panel, counts = threshold(driver), driver.pipeline.counts
    line, box = panel.histogram.line, panel.histogram.box
    bars = driver.inspection.kappa_curve.histogram_m2
    np.testing.assert_allclose(panel.histogram.bars.opts["height"], 1e6 * bars)
    driver.window.panels["kappa"].raise_()
    driver.click(driver.window.kappa.automatic)
    driver.wait(driver.shows_chosen_kappa)
    driver.window.panels["threshold"].raise_()
    driver.wait_until_shown()
    assert line.isVisible() and line.value() == pytest.approx(math.log10(3.0))
    solved, area = counts["estimate"], driver.result.patch.area_m2

    def place(log_kappa):
        middle = sum(box.viewRange()[1]) / 2
        return graphics_view(panel).mapFromScene(box.mapViewToScene(QPointF(log_kappa, middle)))

    def dragged(to):
        hover(viewport, place(to), LEFT)
        return abs(line.value() - to) < 0.02

    viewport = graphics_view(panel).viewport()
    driver.bot.mousePress(viewport, LEFT, pos=place(line.value()))
    for log_kappa in (0.8, 0.5, 0.3):
        driver.wait(lambda to=log_kappa: dragged(to))
    driver.bot.mouseRelease(viewport, LEFT, pos=place(0.3))
    driver.wait(lambda: driver.state.settings.kappa is not None)
    assert driver.state.settings.kappa == pytest.approx(2.0, rel=0.15)
    driver.wait(lambda: driver.result.patch.area_m2 != area)
    assert counts["estimate"] == solved
    assert panel.curve.line.value() == pytest.approx(math.log10(driver.state.settings.kappa))
    # the comparison follows the frame and costs nothing hidden
    driver.wait_until_shown()
    bench, dock = driver.solver.current.side_by_side, driver.window.panels["compare"]
    driver.seek(CONTACT + 1)
    assert not bench.pipelines
    panel = compare(driver)
    status = panel.a.values["status"]
    panel.b.controls["pressure_scale"].setValue(0.5)
    panel.b.controls["block"].setValue(3)
    options = EstimatorOptions("linear", pressure_scale=0.5, block=3)
    assert panel.b.setting.options == options
    driver.wait(lambda: options in bench.pipelines)
    assert bench.pipelines[options].estimator.observer.block == 3
    driver.wait_until_solved_ahead()  # nothing of the frame before is left to solve
    own = driver.pipeline.counts["estimate"]
    driver.state.seek(2)
    driver.wait(lambda: status.text() == "no contact")
    # the window's own cold solve, which a busy machine may have begun: asking would add another
    driver.wait(lambda: driver.shows_cursor_frame() and driver.window.controller.cold_solved)
    assert driver.pipeline.counts["estimate"] == own + 2  # at once, and from rest
    driver.window.panels["kappa"].raise_()  # behind a tab is hidden, too
    driver.wait(lambda: status.text() == "–" and not bench.pipelines)
    dock.raise_()
    driver.wait(lambda: status.text() == "no contact")
    dock.hide()
    assert status.text() == "–"
    driver.wait(lambda: not bench.pipelines)  # nor does it hold memory
    driver.seek(CONTACT)
    assert not bench.pipelines


def test_controls_of_the_active_threshold_and_errors_against_ground_truth(drive, press, sensor):
    """The automatic threshold has no κ, and the curve says what κ would make of the frame."""
    driver = drive(frame=CONTACT)
    panel, kappa = threshold(driver), driver.window.kappa
    titles = [kappa.solver.itemText(k) for k in range(kappa.solver.count())]
    assert "rubber, sensor's mesh alone" in titles and "-" not in "".join(titles)
    inspection, patch = lambda: driver.inspection, driver.result.patch
    assert driver.state.settings.kappa is None
    assert not kappa.by_kappa.isVisibleTo(kappa) and kappa.threshold.text() == "automatic"
    assert not panel.curve.line.isVisible() and not panel.histogram.line.isVisible()
    assert panel.curve.text.startswith(f"auto {1e6 * patch.area_m2:.0f} mm²")
    low, high = (1e6 * area for area in patch.area_interval_m2)
    shown = f"{1e6 * patch.area_m2:.0f} ({low:.0f}…{high:.0f}) mm²"
    assert kappa.area.text() == shown and any(text.endswith(shown) for text in view_texts(driver))

    driver.state.change(kappa=15.0)
    parts = lambda: inspection().components  # noqa: E731
    driver.wait(lambda: driver.shows_chosen_kappa() and len(parts()) > 1)
    driver.wait(lambda: panel.table.rowCount() == len(parts()))
    whole, areas = inspection().kappa_curve.area_at(15.0), [part.area_m2 for part in parts()]
    driver.wait(lambda: panel.curve.text.startswith(f"{1e6 * whole:.0f} mm² at κ"))
    assert sum(areas) == pytest.approx(driver.result.patch.area_m2)
    forces_n = np.array([part.force_n for part in parts()])
    assert column(panel, 1) == [f"{size:.2f} N" for size in np.linalg.norm(forces_n, axis=1)]
    headline = np.linalg.norm(forces_n.sum(axis=0))
    shown = plus_minus(headline, driver.result.estimate.force_half_width_n, 2)
    driver.wait(lambda: kappa.force.text().startswith(shown))
    assert areas == sorted(areas)[::-1] and set(column(panel, 3)) == {"contact"}
    assert column(panel, 0)[0] == f"{1e6 * areas[0]:.0f} mm²"

    solved, force = driver.pipeline.counts["estimate"], driver.result.patch.force_n
    driver.type(panel.least, f"{1e6 * areas[1] + 1:.0f}")
    driver.wait(lambda: driver.result.patch.area_m2 == pytest.approx(areas[0]))
    assert column(panel, 3) == ["contact"] + ["removed"] * (len(areas) - 1)
    assert driver.pipeline.counts["estimate"] == solved
    np.testing.assert_array_equal(driver.result.patch.force_n, force)
    assert kappa.by_kappa.isVisibleTo(kappa) and kappa.threshold.text().endswith("kPa")
    assert kappa.area.text() == f"{1e6 * areas[0]:.0f} mm²"  # the paper's rule knows of no band
    shown = f"{1e6 * areas[0]:.0f} of {1e6 * whole:.0f} mm²"
    driver.wait(lambda: panel.curve.text.startswith(shown))
    driver.seek(CONTACT + 1)  # it stays left out
    left = components(driver.pipeline.mesh, driver.result.estimate, driver.result.patch)
    assert left and min(part.area_m2 for part in left) >= driver.state.settings.least_area_m2
    # in a simulation the curve has the IoU
    driver.choose(kappa=None, least_area_m2=0.0)
    driver.seek(CONTACT)
    threshold(driver)
    curve = driver.inspection.kappa_curve
    driver.state.change(kappa=float(curve.kappa[30]), images=frozenset({"patch"}))
    driver.show("images")
    patch = lambda: driver.result.patch  # noqa: E731
    driver.wait(lambda: patch().pixel_mask is not None and driver.shows_chosen_kappa())
    driver.wait_until_shown()
    truth, curve = truth_of(press, CONTACT), driver.inspection.kappa_curve
    assert curve.iou[30] == pytest.approx(iou(patch().pixel_mask, truth.patch_mask), abs=0.02)
    assert "best IoU" in driver.window.threshold.curve.text
    # two settings are measured against it
    driver.choose(kappa=None)
    panel = compare(driver)
    panel.b.controls["nodes"].setValue(100)
    driver.wait(lambda: panel.b.values["nodes"].text() not in ("–", panel.a.values["nodes"].text()))
    truth = truth_of(press, CONTACT)
    for side in (panel.a, panel.b):
        pipeline = Pipeline.of(sensor, options=side.setting.options)
        needed = frozenset({"estimate", "patch", "pixel_mask"})
        for _ in range(5):
            result = pipeline.process(press[CONTACT], needed)
        error = np.linalg.norm(result.patch.force_n - truth.force_n)
        relative = error / np.linalg.norm(truth.force_n)
        shown = float(side.values["force_error"].text().removesuffix(" %"))
        assert shown == pytest.approx(100 * relative, abs=1.0)
        agreed = iou(result.patch.pixel_mask, truth.patch_mask)
        assert float(side.values["iou"].text()) == pytest.approx(agreed, abs=0.05)
        assert side.values["total"].text().endswith(" ms")
        assert side.values["nodes"].text() == str(len(pipeline.mesh.nodes))
