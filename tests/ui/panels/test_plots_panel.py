"""Plots panel by clicks: curves read back, and only chosen quantities computed."""

import re
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from fakes import FIRST_CONTACT, FRAMES, DentSource, GappySource, small_sensor
from PySide6.QtCore import QEvent, QPoint, QPointF
from PySide6.QtGui import QFontMetrics
from PySide6.QtWidgets import QApplication
from window_driver import CONTACT, LEFT, clipboard_text, drawn_curve, graphics_view, hover, painted

from bubbleviz.inverse import PatchFinder
from bubbleviz.recordings import find_gaps
from bubbleviz.simulation import LoopedSource, SyntheticSource, default_press
from bubbleviz_ui.model.frame_history import decimated
from bubbleviz_ui.model.source_facts import SourceFacts, force_text
from bubbleviz_ui.panels.plot_host import Plot
from bubbleviz_ui.panels.time_plot import Band

PATCH = frozenset({"estimate", "patch"})


@pytest.fixture(scope="session")
def sensor():
    """A coarse one: the panel shows what is known of a frame, whatever the mesh."""
    return small_sensor(nodes=80)


def opened(driver, *plots):
    """The panel with these plots, shown and laid out."""
    driver.state.change(plots=frozenset(plots))
    driver.window.resize(1280, 800)
    driver.show("plots")
    driver.wait(lambda: driver.window.plots.isVisible() and bool(driver.window.plots.plots))
    QApplication.processEvents()
    driver.wait_until_shown()
    return driver.window.plots


def place(panel, name, time_s):
    """Position of a time of a plot in the graphics widget."""
    box = panel.plots[name].box
    low, high = box.viewRange()[1]
    return graphics_view(panel).mapFromScene(
        box.mapViewToScene(QPointF(time_s, 0.5 * (low + high)))
    )


def plain(panel, name):
    return re.sub(r"<[^>]*>", "", panel.plots[name].text)


def curve(driver, plot, name, known):
    """Times and values of a curve, once it has this many known values."""
    shown = driver.window.plots.plots[plot]
    driver.wait(lambda: np.count_nonzero(np.isfinite(drawn_curve(shown, name)[1])) == known)
    return drawn_curve(shown, name)


class Repeated:
    """A looping source."""

    name = "repeated"

    def __init__(self, source, frames):
        self._source, self._frames = source, frames
        self.times_s = np.arange(frames) / 30.0

    def __len__(self):
        return self._frames

    def __getitem__(self, index):
        return replace(self._source[index % len(self._source)], index=index)

    def close(self):
        pass


class FlickeringSource(GappySource):
    """Has no depth before and after its tenth frame."""

    def __getitem__(self, index):
        frame = super().__getitem__(index)
        return replace(frame, depth_m=frame.depth_m * np.nan) if index in (8, 10) else frame


def test_all_frames_are_analysed_in_the_background_and_missing_ones_break_curves(
    drive, sensor, press
):
    whole = default_press(sensor)
    some = SyntheticSource(sensor, whole.obj, whole.poses[::10], whole.noise)
    fewer = LoopedSource(some, some.camera)
    driver = drive(lambda _: fewer)
    panel, history = opened(driver, "force", "area"), driver.state.history
    driver.click(panel.analyse)
    driver.wait(lambda: not len(history.missing(PATCH)))
    _, force = curve(driver, "force", "force_n", 15)
    driver.wait(lambda: not panel.progress.isVisible())
    assert driver.state.frame == 0
    for frame in (0, 6, 8):  # the same as when shown
        driver.seek(frame)
        found = np.linalg.norm(driver.result.patch.force_n)
        assert force[frame] == pytest.approx(found, rel=0.05, abs=1e-6)
    assert force[0] == 0.0 and force[8] > 0.5
    # areas of all frames follow κ, from cached estimates
    driver.wait(lambda: np.isfinite(history.quantity("area_m2")).all())
    before, solved = history.quantity("area_m2").copy(), driver.solver.counts["estimate"]
    for kappa in (2.0, 4.0):
        driver.state.change(kappa=kappa)
    driver.wait(lambda: np.isfinite(history.quantity("area_m2")).all())
    area = history.quantity("area_m2")
    touching = before > 0.0
    assert touching.any() and np.all(area[touching] != before[touching])
    assert driver.solver.counts["estimate"] == solved
    driver.seek(8)
    assert area[8] == pytest.approx(driver.result.patch.area_m2, rel=0.05)
    # an analysis is cancelled, and seeking stays possible
    driver.choose(kappa=None)
    driver.show_source(lambda _: Repeated(press, 5000), sensor)
    panel, missing = opened(driver, "force"), lambda: len(driver.state.history.missing(PATCH))
    driver.trigger("Playback › Play / pause")
    assert driver.state.playing
    driver.click(panel.analyse)  # pauses, as the solver analyses while idle
    driver.wait(lambda: panel.progress.value() > 3)
    assert not driver.state.playing
    assert re.fullmatch(r"\d+ / \d+, \d\d+:\d\d left", panel.progress.text())
    assert panel.minimumSizeHint().width() < 675  # of a window of 1024 px at 150 %
    driver.seek(100)  # handled in between
    assert panel.cancel.isVisible()
    driver.click(panel.cancel)
    assert not panel.cancel.isVisible() and panel.analyse.isVisible()
    left = missing()
    driver.seek(200)  # pending results have arrived
    after = missing()
    assert 0 < left < 5000 and left - after < 40
    driver.seek(300)
    assert after - 2 <= missing()
    # curves and bands break at missing frames, and isolated ones are dots
    driver.show_source(FlickeringSource, sensor)
    panel = opened(driver, "force", "residual")
    driver.click(panel.analyse)
    for plot, name in (("force", "force_n"), ("residual", "residual_m")):
        times, values = curve(driver, plot, name, FRAMES - 2)
        assert list(np.flatnonzero(np.isnan(values))) == [6, 9, 11]
        np.testing.assert_array_equal(np.delete(times, 6), driver.state.facts.times_s)
    band = panel.plots["force"].bands["force_n"]
    for edge in (band.low, band.high):
        np.testing.assert_array_equal(edge.getOriginalDataset()[0], times)
    box = panel.plots["residual"].box

    def drawn():
        view = graphics_view(panel)
        at = view.mapFromScene(box.mapViewToScene(QPointF(times[10], values[10])))
        if not view.rect().contains(at):
            return False
        red, _, blue = painted(view)[at.y(), at.x()].astype(int)
        return blue > red + 60

    driver.wait(drawn)  # the axes follow the curve once it is there


def test_band_does_not_fill_gaps_next_to_an_isolated_frame(qapp):
    facts = cast(SourceFacts, SimpleNamespace(times_s=np.arange(10.0), gaps=()))
    values = np.array([0.0, 1.0, 2.0, np.nan, 4.0, np.nan, 6.0, 7.0, np.nan, 9.0])
    plot = Plot("number")  # owns its items
    band = Band(plot, "#ffffff")
    band.draw(facts, values, np.full(10, 0.2), (0.0, 9.0))
    path = band.fill.path()
    filled = [t for t in np.arange(0.25, 9.0, 0.5) if path.contains(QPointF(t, t))]
    assert filled == [0.25, 0.75, 1.25, 1.75, 6.25, 6.75]


def test_only_chosen_plots_are_computed_and_their_contents(drive):
    driver = drive(frame=CONTACT)
    driver.state.change(layers=frozenset({"rim"}), panels=frozenset())
    driver.window.panels["kappa"].hide()
    panel, counts = opened(driver, "latency"), driver.pipeline.counts
    driver.state.change(panels=frozenset({"plots"}))
    before = dict(counts)
    driver.seek(76)
    assert counts["estimate"] == before["estimate"] and counts["patch"] == before["patch"]
    panel.boxes["residual"].trigger()
    driver.wait(lambda: counts["estimate"] > before["estimate"])
    assert counts["patch"] == before["patch"] and counts["diagnose kappa_curve"] == 0
    panel.boxes["force"].trigger()
    panel.boxes["kappa"].trigger()
    driver.wait(lambda: counts["patch"] > before["patch"] and counts["diagnose kappa_curve"] > 0)
    driver.window.panels["plots"].hide()
    driver.wait(lambda: "plots" not in driver.state.settings.panels)
    driver.seek(77)  # requests of frame 76 are done by then
    looked = counts["diagnose kappa_curve"], counts["estimate"]
    driver.seek(78)
    assert (counts["diagnose kappa_curve"], counts["estimate"]) == looked
    # κ curve, and no clipped text
    driver.seek(CONTACT)
    panel = opened(driver, *driver.window.plots.boxes)
    driver.wait(lambda: "mm" in plain(panel, "center"))
    for plot in panel.plots.values():
        at, words = plot.item.sceneBoundingRect(), plot.label
        width = words.item.boundingRect().width() + words.pos().x()
        assert width <= at.width() + 8, plot.text
        assert plot.box.height() > 40
    assert driver.size == (1280, 800)
    driver.wait(lambda: driver.inspection.kappa_curve is not None)
    finder = PatchFinder(driver.pipeline.mesh, 1.0, 1e-3)
    x, y = panel.plots["kappa"].curve.getOriginalDataset()
    for k in (0, 20, 40):
        area = finder.find(driver.result.estimate, float(10.0 ** x[k])).area_m2
        assert y[k] == pytest.approx(1e6 * area)
    drawn = list[object]()
    panel.plots["kappa"].curve.sigPlotChanged.connect(drawn.append)
    hover(graphics_view(panel).viewport(), place(panel, "force", 0.1))
    assert plain(panel, "force").startswith("at ") and not drawn  # the curve is that of the frame
    QApplication.sendEvent(graphics_view(panel), QEvent(QEvent.Type.Leave))
    # measured and estimated gas pressure
    panel, history = opened(driver, "gas"), driver.state.history.values
    rest_pa = driver.window.controller.sensor.pneumatics.reference_pressure_pa
    measured = driver.result.frame.gas_pressure_pa - rest_pa
    # without the plots of shear, the frame is solved again
    driver.wait(lambda: np.isfinite(history["gas_measured_pa"][CONTACT]))
    assert history["gas_measured_pa"][CONTACT] == pytest.approx(measured)
    assert np.isfinite(history["gas_law_pa"][CONTACT])
    driver.wait(lambda: f"measured {measured:.0f} Pa" in plain(panel, "gas"))
    gas = driver.window.status.labels["gas"]
    assert gas.text() == f"p_v {measured:+.0f} Pa"
    driver.show_source(DentSource, frame=8)
    driver.wait_until_shown()  # not measured: from the gas law
    law = driver.state.history.values["gas_law_pa"][8]
    assert law > 1.0 and gas.text() == f"p_v {law:+.0f} Pa"


def test_decimated_curves_keep_peaks_and_break_at_gaps():
    frame = np.arange(36_000)
    times, values = frame / 30.0, np.full(36_000, np.nan)
    values[1000:30_000] = 1.0
    values[17_100:17_140:2] = np.nan
    values[17_123] = 50.0
    x, y = decimated(times, values, (0.0, 1200.0))
    assert len(x) == len(y) <= 3000
    assert np.nanmax(y) == 50.0 and np.isnan(y[0])
    assert x[np.nanargmax(y)] == pytest.approx(times[17_123], abs=1.0)
    x, y = decimated(times, values, (570.0, 572.0))
    assert len(x) < 70 and 17_123 / 30 in x
    x, y = decimated(np.zeros(1), np.ones(1), (0.0, 1.0))  # times need no pixels
    assert list(x) == [0.0] and list(y) == [1.0]

    times = times + 60.0 * (frame > 17_123)
    gaps = find_gaps(times)
    x, y = decimated(times, np.ones(36_000), (0.0, 1300.0), gaps)
    (broken,) = np.flatnonzero(np.isnan(y))
    assert x[broken - 1] <= times[17_123] < x[broken] == x[broken + 1] == times[17_124]
    for window_s in ((0.0, 100.0), (700.0, 1300.0)):
        assert np.isfinite(decimated(times, np.ones(36_000), window_s, gaps)[1]).all()


def test_height_of_plots_statistics_of_a_range_and_values_at_cursor_and_mouse(drive):
    driver = drive(DentSource)
    # plots keep their height, after the window was smaller, and beside the statistics of a range
    driver.resize(1280, 900)
    driver.trigger("View › Plots")
    driver.wait_until_shown()
    panel, shown = driver.window.plots, graphics_view(driver.window.plots).viewport()

    def height():
        return shown.visibleRegion().boundingRect().height()

    def share(name):
        return panel.plots[name].item.rect().height() / height()

    driver.wait(lambda: height() > 200)
    full = height()
    driver.resize(1024, 700)  # two columns: the first of three plots is higher
    driver.wait(lambda: share("force") > 0.9 and share("area") < 0.5)
    driver.resize(1024, 500)
    assert 100 < height() < full
    driver.bot.mouseClick(panel, LEFT, pos=QPoint(3, 3))  # drags no line
    driver.wait(lambda: share("force") < 0.9)  # else it would be scrolled to see its axis
    driver.resize(1280, 900)
    driver.wait(lambda: height() == full)
    driver.state.set_range((2, 8))
    driver.wait(lambda: panel.statistics.isVisible() and height() == full)
    rows = panel.statistics.verticalHeader()
    assert rows.viewport().visibleRegion().boundingRect().height() >= rows.length()
    driver.resize(1024, 600)
    assert height() > 80
    driver.state.set_range(None)
    driver.resize(1280, 900)
    driver.wait(lambda: height() == full)
    # dragged by the line above it
    dock = driver.window.panels["plots"]
    line = QPoint(300, dock.y() - 2)
    driver.bot.mousePress(driver.window, LEFT, pos=line)
    driver.bot.mouseMove(driver.window, line - QPoint(0, 60))
    driver.wait(lambda: height() == full + 60)
    driver.bot.mouseRelease(driver.window, LEFT, pos=line - QPoint(0, 60))
    saver = driver.window.session_saver
    saved = saver.snapshot()
    for _ in range(2):
        driver.resize(1024, 500)
        driver.resize(1280, 900)
        driver.wait(lambda: height() == full + 60)
        dock.hide()
        saver.apply_settings(saved)
        driver.wait_until_shown()
        driver.wait(lambda: height() == full + 60)
    # also if it was closed in the session
    dock.hide()
    saver.apply_settings(saver.snapshot())
    driver.trigger("View › Plots")
    driver.wait(lambda: height() == full + 60)
    # statistics of a range
    panel = opened(driver, "force", "gas", "residual")
    table, force = panel.statistics, driver.state.history.quantity("force_n")

    def rows():
        """The copied table."""
        driver.click(table.copy)
        return [line.split("\t") for line in clipboard_text().splitlines()]

    assert not table.isVisible()
    driver.seek(3)
    driver.state.set_range((3, 8))
    assert table.isVisible()
    driver.wait(lambda: table.item(4, 0).text() == "1 of 6")
    assert table.item(1, 0).text() == "–"
    for frame in (7, 8, 6):
        driver.seek(frame)
    driver.trigger("Playback › Start range here")
    driver.seek(9)
    driver.trigger("Playback › End range here")
    assert driver.state.play_range == (6, 9) and table.isVisible()
    driver.wait(lambda: np.isfinite(force[6:10]).all())
    driver.wait(lambda: table.item(4, 0).text() == "4")
    known, (head, *body) = force[6:10], rows()
    assert head[:3] == ["Frames 6 to 9", "Force (N)", "Gas pressure change p_v, gas law (Pa)"]
    names = ["mean", "standard deviation", "minimum", "maximum", "frames"]
    assert [row[0] for row in body] == names
    expected = [known.mean(), known.std(ddof=1), known.min(), known.max(), 4]
    assert [float(row[1]) for row in body] == pytest.approx(expected, rel=1e-5)
    assert table.item(0, 0).text() == f"{known.mean():.3f}"
    driver.state.change(force_unit="mN", plots=frozenset({"force"}))
    name = driver.window.controller.sensor.name
    for kappa in (None, 2.5):
        driver.state.change(kappa=kappa)
        head, *body = rows()
        assert head == ["Frames 6 to 9", "Force (mN)", "κ", "sensor"]
        assert {tuple(row[2:]) for row in body} == {(f"{kappa or ''}", name)}
    assert float(body[0][1]) == pytest.approx(1e3 * known.mean(), rel=1e-5)
    driver.trigger("Playback › Play all frames")
    driver.wait(lambda: not table.isVisible())
    # values at the cursor and under the mouse
    driver.choose(force_unit="N", kappa=None)
    panel, frame = opened(driver, "force", "residual"), FIRST_CONTACT + 4
    times, history, units = driver.state.facts.times_s, driver.state.history, driver.state.units
    view = graphics_view(panel).viewport()
    driver.click(view, place(panel, "residual", times[frame]))
    assert driver.state.frame == frame
    driver.wait_until_shown()
    for name in ("force", "residual"):
        assert panel.plots[name].cursor.value() == pytest.approx(times[frame])
    force = force_text(driver.result, units)
    driver.wait(lambda: plain(panel, "force") == f"Force: {force}")
    # hovering shows time and values
    driver.seek(2)
    driver.wait(lambda: np.isfinite(history.quantity("residual_m")[[2, frame]]).all())
    at_cursor = f"Residual rms: {units.fine_length.text(history.quantity('residual_m')[2])}"
    driver.wait(lambda: plain(panel, "residual") == at_cursor)
    hover(view, place(panel, "residual", times[frame]))
    there = units.fine_length.text(history.quantity("residual_m")[frame])
    driver.wait(lambda: plain(panel, "residual") == f"at {times[frame]:.3f} s: {there}")
    assert plain(panel, "force").startswith("Force: ") and driver.state.frame == 2
    QApplication.sendEvent(graphics_view(panel), QEvent(QEvent.Type.Leave))
    driver.wait(lambda: plain(panel, "residual") == at_cursor)
    for name, light in (("dark", False), ("light", True)):
        driver.state.change(theme=name)
        assert (painted(graphics_view(panel))[3, -3].mean() > 127) == light


@pytest.mark.parametrize("width", [110, 150, 310, 900])
@pytest.mark.parametrize("span_s", [0.4, 2.9, 44.0, 700.0])
def test_time_labels_of_a_plot_do_not_overlap(qtbot, width, span_s):
    frame = Plot("seconds")
    (axis,) = (a for a in frame.item.items if getattr(a, "orientation", "") == "bottom")
    step, _ = axis.tickSpacing(0.0, span_s, width)[0]
    texts = axis.tickStrings(np.arange(0.0, span_s, step), 1.0, step)
    metrics = QFontMetrics(QApplication.font())
    assert max(metrics.horizontalAdvance(text) for text in texts) < width * step / span_s
    assert span_s / step < 20
