"""Threshold and comparison by drags, keys and numbers; against the backend and the truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import QPoint, QPointF, Qt
from PySide6.QtWidgets import QApplication, QLabel
from window_driver import Driver, canvas, hover, texts

from bubbleviz.diagnostics.overlap import iou
from bubbleviz.frames.frame_source import FrameSource
from bubbleviz.inverse.estimator import EstimatorOptions
from bubbleviz.patch.components import components, without_small
from bubbleviz.patch.patch_finder import mean_pressure
from bubbleviz.pipeline import FrameOptions, Pipeline
from bubbleviz.sensor import Sensor
from bubbleviz.simulation.truth import truth_of
from bubbleviz_ui.panels.compare_panel import ComparePanel
from bubbleviz_ui.panels.threshold_panel import ThresholdPanel

Drive = Callable[..., Driver]
LEFT = Qt.MouseButton.LeftButton
CONTACT = 75
TWO_PARTS = 66
"""A frame where noise makes a part beside the contact."""


def threshold(driver: Driver) -> ThresholdPanel:
    driver.window.resize(1280, 800)
    driver.window.panels["layers"].hide()
    driver.window.panels["threshold"].show()
    driver.window.panels["threshold"].raise_()
    driver.wait(lambda: driver.window.controller.inspection.kappa_curve is not None)
    QApplication.processEvents()
    driver.settle()
    return driver.window.threshold


def compare(driver: Driver) -> ComparePanel:
    driver.window.resize(1280, 800)
    driver.window.panels["layers"].hide()
    driver.window.panels["compare"].show()
    driver.window.panels["compare"].raise_()
    driver.wait(lambda: driver.window.compare.a.values["status"].text() == "ok")
    return driver.window.compare


def column(panel: ThresholdPanel, number: int) -> list[str]:
    return [panel.table.item(row, number).text() for row in range(panel.table.rowCount())]


def test_the_line_in_the_histogram_is_dragged(drive: Drive) -> None:
    driver = drive(frame=CONTACT)
    panel = threshold(driver)
    line, box = panel.histogram.line, panel.histogram.frame.box
    driver.window.panels["kappa"].raise_()
    driver.bot.mouseClick(driver.window.kappa.automatic, LEFT, pos=QPoint(10, 10))
    driver.wait(driver.thresholded)
    driver.window.panels["threshold"].raise_()
    driver.settle()
    result = driver.window.controller.result
    assert line.isVisible() and line.value() == pytest.approx(math.log10(3.0))
    solved, area = driver.pipeline.counts["estimate"], result.patch.area_m2

    def near(line: Any, log_kappa: float) -> bool:
        return abs(line.value() - log_kappa) < 0.02

    def place(log_kappa: float) -> QPoint:
        middle = sum(box.viewRange()[1]) / 2
        return canvas(panel).mapFromScene(box.mapViewToScene(QPointF(log_kappa, middle)))

    viewport = canvas(panel).viewport()
    driver.bot.mousePress(viewport, LEFT, pos=place(line.value()))
    for log_kappa in (0.8, 0.5, 0.3):
        driver.wait(lambda to=log_kappa: (hover(viewport, place(to), LEFT), near(line, to))[1])
    driver.bot.mouseRelease(viewport, LEFT, pos=place(0.3))
    driver.wait(lambda: driver.state.choices.kappa is not None)
    assert driver.state.choices.kappa == pytest.approx(2.0, rel=0.15)
    driver.wait(lambda: driver.window.controller.result.patch.area_m2 != area)
    assert driver.pipeline.counts["estimate"] == solved
    assert panel.curve.line.value() == pytest.approx(math.log10(driver.state.choices.kappa))


def test_one_rule_is_shown_at_a_time(drive: Drive) -> None:
    """The automatic threshold has no κ, and the curve says what κ would make of the frame."""
    driver = drive(frame=CONTACT)
    panel, kappa = threshold(driver), driver.window.kappa
    assert driver.state.choices.kappa is None
    patch = driver.window.controller.result.patch
    assert not kappa.by_kappa.isVisibleTo(kappa) and kappa.threshold.text() == "automatic"
    assert not panel.curve.line.isVisible() and not panel.histogram.line.isVisible()
    assert panel.curve.frame.text.startswith(f"auto {1e6 * patch.area_m2:.0f} mm²")
    low, high = (1e6 * area for area in patch.area_interval_m2)
    shown = f"{1e6 * patch.area_m2:.0f} ({low:.0f}…{high:.0f}) mm²"
    assert kappa.area.text() == shown and any(text.endswith(shown) for text in texts(driver))
    driver.state.choose(kappa=15.0)
    parts = lambda: driver.window.controller.inspection.components  # noqa: E731
    driver.wait(lambda: driver.thresholded() and len(parts()) > 1)
    whole = driver.window.controller.inspection.kappa_curve.area_at(15.0)
    driver.wait(lambda: panel.curve.frame.text.startswith(f"{1e6 * whole:.0f} mm² at κ"))
    driver.state.choose(least_area_m2=parts()[1].area_m2 + 1e-6)
    area = lambda: driver.window.controller.result.patch.area_m2  # noqa: E731
    driver.wait(lambda: 0.0 < area() < 0.98 * whole)
    assert kappa.by_kappa.isVisibleTo(kappa) and kappa.threshold.text().endswith("kPa")
    assert kappa.area.text() == f"{1e6 * area():.0f} mm²"  # the paper's rule knows of no band
    shown = f"{1e6 * area():.0f} of {1e6 * whole:.0f} mm²"
    driver.wait(lambda: panel.curve.frame.text.startswith(shown))


def test_the_histogram_is_the_area_by_pressure(drive: Drive) -> None:
    driver = drive(frame=CONTACT)
    panel = threshold(driver)
    curve = driver.window.controller.inspection.kappa_curve
    mesh = driver.pipeline.mesh
    pressure = driver.window.controller.result.estimate.contact_pressure_pa
    mean = mean_pressure(mesh, pressure)
    inside = (pressure > curve.kappa[0] * mean) & (pressure < curve.kappa[-1] * mean)
    assert curve.histogram_m2.sum() == pytest.approx(mesh.areas[inside].sum())
    np.testing.assert_allclose(panel.histogram.bars.opts["height"], 1e6 * curve.histogram_m2)


def test_in_a_simulation_the_curve_has_the_iou(drive: Drive, press: FrameSource) -> None:
    driver = drive(frame=CONTACT)
    threshold(driver)
    curve = driver.window.controller.inspection.kappa_curve
    driver.state.choose(kappa=float(curve.kappa[30]), images=frozenset({"patch"}))
    driver.window.panels["images"].show()
    patch = lambda: driver.window.controller.result.patch  # noqa: E731
    driver.wait(lambda: patch().pixel_mask is not None and patch().threshold_pa > 0)
    driver.wait(driver.thresholded)
    driver.settle()
    truth, curve = truth_of(press, CONTACT), driver.window.controller.inspection.kappa_curve
    assert curve.iou[30] == pytest.approx(iou(patch().pixel_mask, truth.patch_mask), abs=0.02)
    assert "IoU ≤" in driver.window.threshold.curve.frame.text


def test_small_parts_are_listed_and_left_out(drive: Drive) -> None:
    driver = drive(frame=CONTACT)
    panel = threshold(driver)
    driver.state.choose(kappa=15.0)
    parts = lambda: driver.window.controller.inspection.components  # noqa: E731
    driver.wait(lambda: len(parts()) > 1 and panel.table.rowCount() == len(parts()))
    result = lambda: driver.window.controller.result  # noqa: E731
    estimate = result().estimate
    level = 15.0 * mean_pressure(driver.pipeline.mesh, estimate.contact_pressure_pa)
    driver.wait(lambda: result().patch.threshold_pa == pytest.approx(level))
    areas = [part.area_m2 for part in parts()]
    assert sum(areas) == pytest.approx(result().patch.area_m2) and areas == sorted(areas)[::-1]
    assert column(panel, 0)[0] == f"{1e6 * areas[0]:.0f} mm²" and set(column(panel, 3)) == {
        "contact"
    }
    solved, force = driver.pipeline.counts["estimate"], result().patch.force_n
    panel.least.setFocus()
    panel.least.selectAll()
    driver.bot.keyClicks(panel.least, f"{1e6 * areas[1] + 1:.0f}")
    driver.bot.keyClick(panel.least, Qt.Key.Key_Return)
    driver.wait(lambda: result().patch.area_m2 == pytest.approx(areas[0]))
    assert column(panel, 3) == ["contact"] + ["removed"] * (len(areas) - 1)
    assert driver.pipeline.counts["estimate"] == solved
    np.testing.assert_array_equal(result().patch.force_n, force)
    driver.seek(CONTACT + 1)  # it stays left out
    left = components(driver.pipeline.mesh, result().estimate, result().patch)
    assert left and min(part.area_m2 for part in left) >= driver.state.choices.least_area_m2


def test_without_small_parts_alone(sensor: Sensor, press: FrameSource) -> None:
    pipeline = Pipeline.of(sensor)
    wanted = frozenset({"estimate", "patch"})
    result = pipeline.process(press[TWO_PARTS], wanted, FrameOptions(kappa=0.2))
    whole = components(pipeline.mesh, result.estimate, result.patch)
    assert len(whole) > 1
    kept = without_small(pipeline.mesh, result.estimate, result.patch, 1.0)
    assert kept.area_m2 == 0.0 and np.isnan(kept.center_of_pressure_m).all()
    assert not kept.node_mask.any()
    same = without_small(pipeline.mesh, result.estimate, result.patch, 0.0)
    assert same is result.patch
    one = without_small(pipeline.mesh, result.estimate, result.patch, whole[0].area_m2)
    np.testing.assert_allclose(one.center_of_pressure_m, whole[0].center_m)


def test_two_settings_are_measured_against_the_truth(
    drive: Drive, sensor: Sensor, press: FrameSource
) -> None:
    driver = drive(frame=CONTACT)
    panel = compare(driver)
    panel.b.nodes.setFocus()
    panel.b.nodes.setValue(100)
    driver.wait(lambda: panel.b.values["nodes"].text() not in ("–", panel.a.values["nodes"].text()))
    truth = truth_of(press, CONTACT)
    for column in (panel.a, panel.b):
        pipeline = Pipeline.of(sensor, options=column.setting.options)
        needed = frozenset({"estimate", "patch", "pixel_mask"})
        for _ in range(4):
            pipeline.process(press[CONTACT], needed)
        result = pipeline.process(press[CONTACT], needed)
        error = np.linalg.norm(result.patch.force_n - truth.force_n)
        relative = error / np.linalg.norm(truth.force_n)
        shown = float(column.values["force_error"].text().removesuffix(" %"))
        assert shown == pytest.approx(100 * relative, abs=1.0)
        agreed = iou(result.patch.pixel_mask, truth.patch_mask)
        assert float(column.values["iou"].text()) == pytest.approx(agreed, abs=0.05)
        assert column.values["total"].text().endswith(" ms")
        assert column.values["nodes"].text() == str(len(pipeline.mesh.nodes))


def test_the_comparison_follows_the_frame_and_costs_nothing_hidden(drive: Drive) -> None:
    driver = drive(frame=CONTACT)
    bench = driver.server.session.side_by_side
    driver.seek(CONTACT + 1)
    assert not bench.pipelines
    panel = compare(driver)
    own = driver.pipeline.counts["estimate"]
    driver.state.seek(2)
    driver.wait(lambda: panel.a.values["status"].text() == "no_contact")
    driver.settle()
    assert driver.pipeline.counts["estimate"] == own + 2  # at once, and settled
    driver.window.panels["kappa"].raise_()  # behind a tab is hidden, too
    driver.wait(lambda: panel.a.values["status"].text() == "–")
    driver.wait(lambda: not bench.pipelines)
    driver.window.panels["compare"].raise_()
    driver.wait(lambda: panel.a.values["status"].text() == "no_contact")
    driver.window.panels["compare"].hide()
    assert panel.a.values["status"].text() == "–"
    driver.wait(lambda: not bench.pipelines)  # nor does it hold memory
    driver.seek(CONTACT)
    assert not bench.pipelines


def test_lambda_and_blocks_reach_the_estimator(drive: Drive) -> None:
    driver = drive(frame=CONTACT)
    panel = compare(driver)
    panel.b.pressure_scale.setValue(0.5)
    panel.b.block.setValue(3)
    panel.b.recasts.setValue(1)
    assert panel.b.setting.options == EstimatorOptions(
        "linear", relinearisations=1, pressure_scale=0.5, block=3
    )
    bench = driver.server.session.side_by_side
    driver.wait(lambda: panel.b.setting.options in bench.pipelines)
    assert bench.pipelines[panel.b.setting.options].estimator.observer.block == 3


def test_nothing_is_clipped(drive: Drive) -> None:
    driver = drive(frame=CONTACT, live=True)
    panel = compare(driver)
    QApplication.processEvents()
    for label in panel.findChildren(QLabel):
        if not label.wordWrap():
            width = label.fontMetrics().horizontalAdvance(label.text())
            assert width <= label.width() + 1, label.text()
    panel = threshold(driver)
    for plot in (panel.histogram, panel.curve):
        words = plot.frame.words
        assert words.item.boundingRect().width() + words.pos().x() <= canvas(panel).width() + 8
    driver.window.panels["tools"].show()
    driver.window.panels["layers"].show()
    QApplication.processEvents()
    assert (driver.window.width(), driver.window.height()) == (1280, 800)
