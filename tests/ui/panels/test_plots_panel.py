"""The plots by clicks; what they show read back; what nobody chose is not computed."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pyqtgraph as pg
import pytest
from fakes import FIRST_CONTACT, FRAMES, DentSource, GappySource
from PySide6.QtCore import QEvent, QPoint, QPointF, Qt
from PySide6.QtGui import QFontMetrics, QImage
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot
from window_driver import Driver, canvas, hover

from bubbleviz.camera.membrane_view import MembraneView
from bubbleviz.diagnostics.kappa_curve import KAPPAS, kappa_curve
from bubbleviz.diagnostics.overlap import iou
from bubbleviz.frames.frame import Frame
from bubbleviz.frames.frame_source import FrameSource
from bubbleviz.frames.gaps import find_gaps
from bubbleviz.patch.patch_finder import PatchFinder
from bubbleviz.pipeline import Pipeline
from bubbleviz.sensor import Sensor
from bubbleviz.simulation.synthetic_source import SyntheticSource, default_press
from bubbleviz_ui.engine.source_openers import CachedSource
from bubbleviz_ui.model.frame_history import thinned
from bubbleviz_ui.model.source_facts import SourceFacts
from bubbleviz_ui.panels.plot_frame import PlotFrame
from bubbleviz_ui.panels.plots_panel import PlotsPanel
from bubbleviz_ui.panels.time_plot import Band

Drive = Callable[..., Driver]
LEFT = Qt.MouseButton.LeftButton


def opened(driver: Driver, *plots: str) -> PlotsPanel:
    """The panel with these plots, shown and laid out."""
    driver.state.choose(plots=frozenset(plots))
    driver.window.resize(1280, 800)
    driver.window.panels["plots"].show()
    driver.wait(lambda: driver.window.plots.isVisible() and bool(driver.window.plots.plots))
    QApplication.processEvents()
    driver.settle()
    return driver.window.plots


def place(panel: PlotsPanel, name: str, time_s: float) -> QPoint:
    """Where a time lies in a plot, in the graphics widget."""
    box = panel.plots[name].box
    low, high = box.viewRange()[1]
    return canvas(panel).mapFromScene(box.mapViewToScene(QPointF(time_s, 0.5 * (low + high))))


def plain(panel: PlotsPanel, name: str) -> str:
    return re.sub(r"<[^>]*>", "", panel.plots[name].frame.text)


def test_all_frames_are_analysed_in_the_background(drive: Drive, sensor: Sensor) -> None:
    whole = default_press(sensor)
    fewer = CachedSource(SyntheticSource(sensor, whole.obj, whole.poses[::5], whole.noise))
    driver = drive(lambda _: fewer)
    panel = opened(driver, "force", "area")
    steps: list[tuple[int, int]] = []
    driver.window.controller.analysis.progressed.connect(lambda *step: steps.append(step))
    driver.bot.mouseClick(panel.analyse, LEFT)
    driver.wait(lambda: steps and steps[-1][0] == steps[-1][1] > 0)
    history = driver.state.history
    assert len(history.missing(frozenset({"estimate", "patch"}))) == 0
    driver.wait(lambda: len(panel.plots["force"].data["force_n"][0]) == 30)
    driver.wait(lambda: np.isfinite(panel.plots["force"].data["force_n"][1]).all())
    force = panel.plots["force"].data["force_n"][1]
    assert not panel.progress.isVisible() and driver.state.frame == 0
    for frame in (1, 12, 15):  # the same as when one looks at them
        driver.seek(frame)
        found = np.linalg.norm(driver.window.controller.result.patch.force_n)
        assert force[frame] == pytest.approx(found, rel=0.05, abs=1e-6)
    assert force[1] == 0.0 and force[15] > 0.5
    # areas of all frames follow κ: they are found in the estimates that were made
    driver.wait(lambda: np.isfinite(history.of("area_m2")).all())
    before, solved = history.of("area_m2").copy(), driver.server.counts["estimate"]
    for kappa in (2.0, 4.0):
        driver.state.choose(kappa=kappa)
    driver.wait(lambda: np.isfinite(history.of("area_m2")).all())
    area = history.of("area_m2")
    touching = before > 0.0
    assert touching.any() and np.all(area[touching] != before[touching])
    assert driver.server.counts["estimate"] == solved
    driver.seek(15)
    assert area[15] == pytest.approx(driver.window.controller.result.patch.area_m2, rel=0.05)


class Repeated:
    """A short source again and again: too long to be analysed while a test looks on."""

    def __init__(self, source: FrameSource, frames: int) -> None:
        self.name, self._source = source.name, source
        self.times_s = np.arange(frames) / 30.0

    def __len__(self) -> int:
        return len(self.times_s)

    def __getitem__(self, index: int) -> Frame:
        return replace(self._source[index % len(self._source)], index=index)

    def close(self) -> None:
        pass


def test_analysis_is_cancelled_and_seeking_stays_possible(drive: Drive, press: FrameSource) -> None:
    driver = drive(lambda _: Repeated(press, 5000))
    panel = opened(driver, "force")
    driver.bot.mouseClick(panel.analyse, LEFT)
    driver.wait(lambda: panel.progress.value() > 3)
    driver.seek(100)  # answered in between
    assert panel.cancel.isVisible()
    driver.bot.mouseClick(panel.cancel, LEFT)
    assert not panel.cancel.isVisible() and panel.analyse.isEnabled()
    missing = driver.state.history.missing(frozenset({"patch"}))
    driver.seek(200)  # what was on its way is through
    after = driver.state.history.missing(frozenset({"patch"}))
    assert 0 < len(missing) < 5000 and len(missing) - len(after) < 40
    driver.seek(300)
    assert len(after) - 2 <= len(driver.state.history.missing(frozenset({"patch"})))


def test_curves_and_bands_break_where_frames_are_missing(drive: Drive) -> None:
    driver = drive(GappySource)
    panel = opened(driver, "force", "residual")
    driver.bot.mouseClick(panel.analyse, LEFT)
    driver.wait(lambda: len(driver.state.history.missing(frozenset({"estimate", "patch"}))) == 0)
    force, residual = panel.plots["force"], panel.plots["residual"]
    for read in (lambda: force.data["force_n"], lambda: residual.data["residual_m"]):
        driver.wait(lambda read=read: np.count_nonzero(np.isfinite(read()[1])) == FRAMES)
        times, values = read()
        assert list(np.flatnonzero(np.isnan(values))) == [6]
        np.testing.assert_array_equal(np.delete(times, 6), driver.state.facts.times_s)
    band = force.bands["force_n"]
    for edge in (band.low, band.high):
        np.testing.assert_array_equal(edge.getOriginalDataset()[0], times)


class FlickeringSource(DentSource):
    """Has no depth before and after its eighth frame."""

    def __getitem__(self, index: int) -> Frame:
        frame = super().__getitem__(index)
        return replace(frame, depth_m=frame.depth_m * np.nan) if index in (6, 8) else frame


def test_a_good_frame_between_two_without_a_number_is_a_dot(drive: Drive) -> None:
    driver = drive(FlickeringSource)
    panel = opened(driver, "residual")
    driver.bot.mouseClick(panel.analyse, LEFT)
    plot = panel.plots["residual"]
    driver.wait(lambda: np.count_nonzero(np.isfinite(plot.data["residual_m"][1])) == FRAMES - 2)
    times, values = plot.data["residual_m"]
    np.testing.assert_array_equal(plot.dots["residual_m"].getData()[0], times[[7]])

    def drawn() -> bool:
        place = canvas(panel).mapFromScene(plot.box.mapViewToScene(QPointF(times[7], values[7])))
        colour = canvas(panel).grab().toImage().pixelColor(place)
        return colour.blue() > colour.red() + 60

    driver.wait(drawn)  # the axes follow the curve once it is there


def test_a_band_fills_no_gap_beside_a_single_known_frame(qapp: QApplication) -> None:
    facts = cast(SourceFacts, SimpleNamespace(times_s=np.arange(10.0), gaps=()))
    values = np.array([0.0, 1.0, 2.0, np.nan, 4.0, np.nan, 6.0, 7.0, np.nan, 9.0])
    box = pg.ViewBox(enableMenu=False)  # owns what is in it
    band = Band(box, "#ffffff")
    band.draw(facts, values, np.full(10, 0.2), (0.0, 9.0))
    path = band.fill.path()
    filled = [t for t in np.arange(0.25, 9.0, 0.5) if path.contains(QPointF(t, t))]
    assert filled == [0.25, 0.75, 1.25, 1.75, 6.25, 6.75]


def test_the_numbers_follow_a_click_and_the_mouse(drive: Drive) -> None:
    driver = drive(DentSource)
    panel = opened(driver, "force", "residual")
    frame = FIRST_CONTACT + 4
    time_s = float(driver.state.facts.times_s[frame])
    driver.bot.mouseClick(canvas(panel).viewport(), LEFT, pos=place(panel, "residual", time_s))
    assert driver.state.frame == frame
    driver.settle()
    driver.wait(lambda: driver.window.controller.result.patch is not None)
    for name in ("force", "residual"):
        assert panel.plots[name].cursor.value() == pytest.approx(time_s)
    patch = driver.window.controller.result.patch
    force = driver.state.units.force.text(float(np.linalg.norm(patch.force_n)))
    driver.wait(lambda: plain(panel, "force") == f"Force: {force}")
    # pointing at a plot shows time and numbers there
    times, history, units = driver.state.facts.times_s, driver.state.history, driver.state.units
    driver.seek(2)
    known = lambda: np.isfinite(history.of("residual_m")[[2, frame]]).all()  # noqa: E731
    driver.wait(known)
    at_cursor = f"Residual rms: {units.fine_length.text(history.of('residual_m')[2])}"
    driver.wait(lambda: plain(panel, "residual") == at_cursor)
    hover(canvas(panel).viewport(), place(panel, "residual", times[frame]))
    there = units.fine_length.text(history.of("residual_m")[frame])
    driver.wait(lambda: plain(panel, "residual") == f"at {times[frame]:.3f} s: {there}")
    assert plain(panel, "force").startswith("Force: ") and driver.state.frame == 2
    QApplication.sendEvent(canvas(panel), QEvent(QEvent.Type.Leave))
    driver.wait(lambda: plain(panel, "residual") == at_cursor)


def test_only_chosen_plots_ask_for_what_they_need(drive: Drive) -> None:
    driver = drive(frame=75)
    driver.state.choose(layers=frozenset({"rim"}), panels=frozenset())
    driver.window.panels["kappa"].hide()
    panel = opened(driver, "latency")
    driver.state.choose(panels=frozenset({"plots"}))
    counts = driver.pipeline.counts
    before = dict(counts)
    driver.seek(76)
    assert counts["estimate"] == before["estimate"] and counts["patch"] == before["patch"]
    panel.boxes["residual"].trigger()
    driver.wait(lambda: counts["estimate"] > before["estimate"])
    assert counts["patch"] == before["patch"] and counts["look kappa_curve"] == 0
    panel.boxes["force"].trigger()
    panel.boxes["kappa"].trigger()
    driver.wait(lambda: counts["patch"] > before["patch"] and counts["look kappa_curve"] > 0)
    driver.window.panels["plots"].hide()
    driver.wait(lambda: "plots" not in driver.state.choices.panels)
    driver.seek(77)  # what was asked of frame 76 is done by then
    looked = counts["look kappa_curve"], counts["estimate"]
    driver.seek(78)
    assert (counts["look kappa_curve"], counts["estimate"]) == looked


def test_measured_and_estimated_gas_pressure(drive: Drive) -> None:
    driver = drive(frame=75)
    panel = opened(driver, "gas")
    frame = driver.window.controller.result.frame
    measured = (
        frame.gas_pressure_pa - driver.window.controller.sensor.pneumatics.reference_pressure_pa
    )
    history = driver.state.history.values
    assert history["gas_measured_pa"][75] == pytest.approx(measured)
    mesh, estimate = driver.pipeline.mesh, driver.window.controller.result.estimate
    a_bit = 1e-4 * estimate.displacement_m
    change = 1e4 * (mesh.cap_volume(a_bit) - mesh.cap_volume())
    V0 = driver.window.controller.sensor.pneumatics.chamber_volume_m3 + mesh.cap_volume()
    P0 = frame.gas_pressure_pa - measured
    law = P0 * V0 / (V0 + change) - P0
    assert history["gas_law_pa"][75] == pytest.approx(law, rel=5e-3)
    driver.wait(lambda: f"measured {measured:.0f} Pa" in plain(panel, "gas"))
    assert driver.window.status.labels["gas"].text() == f"p_v {measured:+.0f} Pa"


def test_the_status_bar_says_that_a_gas_pressure_was_not_measured(drive: Drive) -> None:
    driver = drive(DentSource, frame=8)
    law = driver.state.history.values["gas_law_pa"][8]
    assert law > 1.0
    assert driver.window.status.labels["gas"].text() == f"p_v {law:+.0f} Pa"


def test_the_plots_follow_the_theme(drive: Drive) -> None:
    driver = drive(DentSource)
    panel = opened(driver, "force")
    for name, light in (("dark", False), ("light", True)):
        driver.state.choose(theme=name)
        image = canvas(panel).grab().toImage().convertToFormat(QImage.Format.Format_RGB888)
        assert (image.pixelColor(image.width() - 3, 3).lightness() > 127) == light
    driver.state.choose(theme="system")


def test_the_plots_are_not_clipped_at_1280x800(drive: Drive) -> None:
    driver = drive(frame=75)
    panel = opened(driver, *driver.window.plots.boxes)
    driver.wait(lambda: "mm" in plain(panel, "center"))
    for plot in panel.plots.values():
        place, words = plot.frame.item.sceneBoundingRect(), plot.frame.words
        width = words.item.boundingRect().width() + words.pos().x()
        assert width <= place.width() + 8, plot.frame.text
        assert plot.box.height() > 40
    assert driver.window.width() == 1280 and driver.window.height() == 800


def test_the_kappa_curve_is_that_of_the_thresholds(drive: Drive) -> None:
    driver = drive(frame=75)
    panel = opened(driver, "kappa")
    driver.wait(lambda: driver.window.controller.inspection.kappa_curve is not None)
    curve = driver.window.controller.inspection.kappa_curve
    estimate, pipeline = driver.window.controller.result.estimate, driver.pipeline
    finder = PatchFinder(pipeline.mesh, 1.0, 1e-3)
    for k in (0, 20, 40):
        area = finder.find(estimate, float(KAPPAS[k])).area_m2
        assert curve.area_m2[k] == pytest.approx(area)
    x, y = panel.kappa.curve.getOriginalDataset()
    np.testing.assert_allclose(y, 1e6 * curve.area_m2)
    np.testing.assert_allclose(10.0**x, KAPPAS)


def test_iou_over_kappa_is_that_of_the_masks(sensor: Sensor, press: FrameSource) -> None:
    pipeline = Pipeline.of(sensor)
    estimate = pipeline.process(press[75], frozenset({"estimate"})).estimate
    view = MembraneView(pipeline.camera, pipeline.mesh)
    truth = np.zeros(view.shape, bool)
    truth[20:35, 30:50] = True
    curve = kappa_curve(pipeline.mesh, estimate, truth, view)
    pressure = estimate.contact_pressure_pa
    mean = pipeline.mesh.areas @ pressure / pipeline.mesh.areas.sum()
    for k in (5, 25, 40):
        mask = view.above(estimate.displacement_m, pressure, float(KAPPAS[k] * mean))
        assert curve.iou[k] == pytest.approx(iou(mask, truth), abs=0.02)


def test_thin_curves_keep_every_peak() -> None:
    times = np.arange(36_000) / 30.0
    values = np.full(36_000, np.nan)
    values[1000:30_000] = 1.0
    values[17_100:17_140:2] = np.nan
    values[17_123] = 50.0
    x, y = thinned(times, values, (0.0, 1200.0))
    assert len(x) == len(y) <= 3000
    assert np.nanmax(y) == 50.0 and np.isnan(y[0])
    assert x[np.nanargmax(y)] == pytest.approx(times[17_123], abs=1.0)
    x, y = thinned(times, values, (570.0, 572.0))
    assert len(x) < 70 and 17_123 / 30 in x


def test_thin_curves_break_at_gaps() -> None:
    frame = np.arange(36_000)
    times = frame / 30.0 + 60.0 * (frame > 17_123)
    gaps = find_gaps(times)
    x, y = thinned(times, np.ones(36_000), (0.0, 1300.0), gaps)
    (broken,) = np.flatnonzero(np.isnan(y))
    assert x[broken - 1] <= times[17_123] < x[broken] == x[broken + 1] == times[17_124]
    for window_s in ((0.0, 100.0), (700.0, 1300.0)):
        assert np.isfinite(thinned(times, np.ones(36_000), window_s, gaps)[1]).all()


def test_times_need_no_pixels(sensor: Sensor) -> None:
    x, y = thinned(np.zeros(1), np.ones(1), (0.0, 1.0))
    assert list(x) == [0.0] and list(y) == [1.0]


def test_statistics_of_the_range_on_the_timeline_and_how_many_are_known(drive: Drive) -> None:
    driver = drive(DentSource)
    panel = opened(driver, "force", "gas", "residual")
    assert not panel.statistics.isVisible()
    driver.seek(3)
    driver.state.choose_range((3, 8))
    assert panel.statistics.isVisible()
    driver.wait(lambda: panel.statistics.item(4, 0).text() == "1 of 6")
    assert panel.statistics.item(1, 0).text() == "–"
    for frame in (7, 8, 6):
        driver.seek(frame)
    actions = driver.window.shortcuts.actions
    actions["Playback › Range begins here"].trigger()
    driver.seek(9)
    actions["Playback › Range ends here"].trigger()
    assert driver.state.play_range == (6, 9) and panel.statistics.isVisible()
    force = driver.state.history.of("force_n")
    driver.wait(lambda: np.isfinite(force[6:10]).all())
    table = panel.statistics
    driver.wait(lambda: table.item(4, 0).text() == "4")
    driver.bot.mouseClick(panel.statistics.copy, LEFT)
    rows = [line.split("\t") for line in copied().splitlines()]
    assert rows[0][:3] == ["Frames 6 to 9", "Force (N)", "Gas pressure change p_v, gas law (Pa)"]
    assert [row[0] for row in rows[1:]] == [
        "mean", "standard deviation", "minimum", "maximum", "frames"
    ]  # fmt: skip
    known = force[6:10]
    expected = [known.mean(), known.std(ddof=1), known.min(), known.max(), 4]
    assert [float(row[1]) for row in rows[1:]] == pytest.approx(expected, rel=1e-5)
    assert table.item(0, 0).text() == f"{known.mean():.3f}"
    driver.state.choose(force_unit="mN", plots=frozenset({"force"}))
    driver.bot.mouseClick(panel.statistics.copy, LEFT)
    assert copied().splitlines()[0] == "Frames 6 to 9\tForce (mN)\tκ\tsensor"
    assert float(copied().splitlines()[1].split("\t")[1]) == pytest.approx(1e3 * known.mean())
    name = driver.window.controller.sensor.name
    assert {tuple(line.split("\t")[2:]) for line in copied().splitlines()[1:]} == {("", name)}
    driver.state.choose(kappa=2.5)
    driver.bot.mouseClick(panel.statistics.copy, LEFT)
    assert {tuple(line.split("\t")[2:]) for line in copied().splitlines()[1:]} == {("2.5", name)}
    actions["Playback › Play all frames"].trigger()
    driver.wait(lambda: not panel.statistics.isVisible())


def copied() -> str:
    return QApplication.clipboard().text()


def test_plots_open_with_room_for_two_rows_in_a_small_window(drive: Drive) -> None:
    """Of those that are chosen at first, two are side by side there; more rows are scrolled to."""
    driver = drive(frame=5)
    window = driver.window
    window.resize(1016, 660)
    window.shortcuts.actions["View › Plots"].trigger()
    driver.settle()
    assert (window.width(), window.height()) == (1016, 660)
    shown = canvas(window.plots).viewport()
    assert shown.visibleRegion().boundingRect().height() == shown.height() > 200
    for box in window.plots.boxes.values():
        if not box.isChecked():
            box.trigger()
    driver.settle()
    assert (window.width(), window.height()) == (1016, 660)
    assert shown.height() >= 2 * shown.visibleRegion().boundingRect().height()


@pytest.mark.parametrize("width", [110, 150, 310, 900])
@pytest.mark.parametrize("span_s", [0.4, 2.9, 44.0, 700.0])
def test_times_below_a_plot_do_not_touch(qtbot: QtBot, width: int, span_s: float) -> None:
    frame = PlotFrame("seconds")
    (axis,) = (a for a in frame.item.items if getattr(a, "orientation", "") == "bottom")
    step, _ = axis.tickSpacing(0.0, span_s, width)[0]
    texts = axis.tickStrings(np.arange(0.0, span_s, step), 1.0, step)
    metrics = QFontMetrics(QApplication.font())
    assert max(metrics.horizontalAdvance(text) for text in texts) < width * step / span_s
    assert span_s / step < 20
