"""Calibration panel by clicks, drags and keys, on an exactly known dome."""

import json
import time
from pathlib import Path

import numpy as np
import pytest
from calibration_bench import Bench
from fakes import DentSource, record, small_sensor
from pyqtgraph import ViewBox
from PySide6.QtCore import QPoint, QPointF, Qt
from PySide6.QtWidgets import QGraphicsView, QLabel
from resting import REST, TENSION, RestingSource
from scipy.spatial.transform import Rotation
from window_driver import CTRL, LEFT, graphics_view, turn_wheel

from bubbleviz.calibration import Step
from bubbleviz.recordings import SIGNIFICANT
from bubbleviz.sensor import load_sensor
from bubbleviz.simulation import default_press
from bubbleviz_ui.calibration import calibration_panel, levels_page
from bubbleviz_ui.calibration.calibration_page import NumberForm
from bubbleviz_ui.model.scene_presets import load_scene
from bubbleviz_ui.model.units import DASH
from tests.small_press import HeldPress, changed


def test_frames_are_chosen_by_mouse_removed_and_replaced(bench):
    # ends of ranges are moved by mouse
    panel, strip = bench.panel, bench.panel.frames.strip
    bench.click(panel.next)
    assert (panel.frames.first.value(), panel.frames.last.value() + 1) == bench.found.ranges[0]
    # the deviations from rest below have the same time axis
    plot = panel.frames.plot
    view, box, (depth, _) = graphics_view(plot), plot.drawn.box, plot.curves
    places, score = depth.getOriginalDataset()
    assert score[: bench.found.ranges[0][1]].max() < np.log10(SIGNIFICANT) < score[-1]

    def aligned(frame):
        seen = view.mapFromScene(box.mapViewToScene(QPointF(places[frame], score[frame])))
        expected = strip.mapTo(panel, QPoint(round(strip.x_at(frame)), 0)).x()
        return abs(view.mapTo(panel, seen).x() - expected) <= 2

    bench.wait(lambda: all(map(aligned, (0, 13, len(places) - 1))))
    bench.click(panel.next)
    before = bench.found
    stop = before.ranges[0][1]
    bench.move_end(stop - 1, 13)
    assert bench.found.ranges == ((0, 14),)
    assert bench.found.samples.frames == tuple(range(14))
    assert bench.found.pixels is not before.pixels
    shorter = bench.found
    bench.move_end(16, 19)  # over empty frames: adds a range
    assert bench.found.ranges == ((0, 14), (16, 20))
    bench.undo()
    assert bench.found is shorter  # from the cache
    bench.undo()
    assert bench.found.samples.frames == before.samples.frames
    bench.move_end(0, 3)
    assert bench.found.ranges == ((3, stop),)
    bench.undo()
    # results follow the frames; settings of later steps are kept
    bench.identify()
    frames, before = panel.frames, bench.found
    bench.step(2)
    panel.surface.nodes.setValue(150)
    bench.done()
    bench.step(0)
    frames.first.setValue(5)
    frames.last.setValue(9)
    bench.click(frames.remove)
    after = bench.found
    assert after.ranges == ((0, 5), (10, before.ranges[0][1]))
    assert not set(range(5, 10)) & set(after.samples.frames)
    assert after.contact_free is before.contact_free
    assert after.tension.value != before.tension.value
    assert frames.message.text().startswith("frames 0–4, 10–")

    def replace(first, last):
        bench.type(frames.first, first)
        bench.type(frames.last, last)
        bench.click(frames.replace)

    replace("3", "14")
    replaced = bench.answer
    assert replaced.found.ranges == ((3, 15),) == strip.ranges
    assert replaced.work.settings.nodes == 150
    value = replaced.found.tension.value
    assert value != after.tension.value and f"{value:.1f} N/m" in panel.verdict.text()
    replace("3", "5")
    assert "at least 5" in bench.message_text
    assert panel.verdict.text().startswith("Outdated: settings changed since. ")
    tips = [panel.steps.button(k).toolTip() for k in range(7)]
    assert tips[0].endswith("needs attention") and not any(tip.endswith("done") for tip in tips)
    bench.step(6)
    assert not panel.use.isEnabled() and not panel.save_as.isEnabled()
    bench.undo()
    assert panel.use.isEnabled() and panel.save_as.isEnabled()
    assert bench.answer is replaced and "Outdated" not in panel.verdict.text()


def test_cancel_restores_the_previous_state(drive):
    bench = Bench(drive(lambda sensor: RestingSource(sensor, slow_s=0.02)))
    panel = bench.panel
    bench.click(panel.next)
    before, work = bench.answer, panel.calibration.work
    index = bench.window.undo_stack.index()
    bench.click(panel.all, wait=False)
    bench.wait(lambda: panel.progress.isVisible() and panel.progress.value() > 5)
    bench.seek(7)  # the window stays responsive
    assert panel.calibration.busy
    bench.click(panel.cancel)
    assert bench.answer is before and panel.calibration.work == work
    assert bench.window.undo_stack.index() == index and not panel.progress.isVisible()
    bench.click(panel.all)  # runs after the other job has ended in the same thread
    assert bench.found.complete
    assert bench.window.undo_stack.index() == index + 1  # the cancelled job had no effect


def test_each_step_shows_name_state_task_and_errors_and_begins_anew_with_a_recording(bench):
    panel = bench.panel
    tips = lambda: [panel.steps.button(k).toolTip() for k in range(7)]  # noqa: E731
    assert all(tip.endswith(": to do") for tip in tips())
    assert panel.steps.button(1).text() == "2\nPixels"
    assert "nothing touches" in panel.page.about.text() and panel.page.about.isVisible()
    bench.click(panel.next)
    bench.click(panel.next)
    assert [tip.endswith(": done") for tip in tips()] == [True, True] + 5 * [False]
    assert panel.steps.button(1).text() == "2 ✓\nPixels"
    assert "which pixels" in panel.page.about.text() and panel.next.text() == "Fit the surface"
    before = bench.answer
    panel.frames.set_ranges(((0, 3),), "Too few")
    bench.done()
    assert "at least 5" in bench.message_text and bench.window.message.isVisible()
    assert tips()[0] == "Contact-free frames: needs attention"
    assert bench.answer is before
    bench.undo()
    assert panel.calibration.work == before.work
    assert tips()[0] == "Contact-free frames: done"
    bench.click(panel.all)
    assert not panel.all.isVisible() and tips()[3] == "γ0: done"
    assert panel.next.text() == "Next: Reference surface"  # computed already
    # another recording starts without results
    bench.undo()
    assert panel.pixels.numbers.text("used") != DASH
    panel.frames.set_ranges(((0, 3),), "Too few")
    bench.done()
    assert panel.steps.button(0).toolTip().endswith("needs attention")
    bench.show_source(DentSource, small_sensor())
    assert not bench.window.message.isVisible()
    assert panel.page is panel.frames and panel.steps.button(0).toolTip().endswith("to do")
    panel.go_to(1)
    assert panel.pixels.numbers.text("used") == DASH
    panel.calibration.edit("Open chamber", vented=Path("vented.mcap"))
    panel.go_to(4)
    assert panel.rectification.levels.text().endswith("Open chamber: vented.mcap")
    panel.calibration.cancel()


def test_steps_with_undo_and_redo_up_to_a_report_and_thresholds_that_change_only_the_mask(
    bench, tmp_path, monkeypatch
):
    panel = bench.panel
    bench.click(panel.next)
    assert abs(bench.found.ranges[0][1] - REST) <= 3
    for step in (Step.PIXELS, Step.SURFACE, Step.TENSION):
        bench.click(panel.next)
        assert bench.answer.work.settings.last_step == step
        assert panel.page.view.image is not None
        assert panel.stack.currentWidget().horizontalScrollBar().maximum() == 0
    estimate = bench.found
    value, half = estimate.tension.value, estimate.tension.half_width
    assert panel.tension.numbers.text("γ0") == f"{value:.1f} ± {half:.1f} N/m"
    assert estimate.tension.low < TENSION < estimate.tension.high
    assert value == pytest.approx(TENSION, rel=0.01)
    assert panel.verdict.isVisible() and f"{value:.1f} N/m" in panel.verdict.text()
    gauge = estimate.gauge.value
    for system, text, more in (
        ("psi", f"{gauge / 6894.757:.4f} psi", "0.0145 psi more"),
        ("kPa", f"{gauge:.0f} Pa", "100 Pa more"),
    ):
        with bench.window.undo_recorder.unrecorded():
            bench.state.change(pressure_unit=system)
        assert f"at {text} gauge pressure" in panel.verdict.text()
        assert panel.tension.numbers.text("gauge pressure") == text
        assert panel.tension.numbers.text("γ0 per gauge pressure").endswith(more)
    last = bench.answer
    for step in (Step.SURFACE, Step.PIXELS, Step.FRAMES, Step.START):
        bench.undo()
        assert panel.calibration.settings.last_step == step
        assert not bench.found.complete and not panel.verdict.isVisible()
    panel.go_to(3)
    assert panel.tension.numbers.text("95 % interval") == DASH
    for _ in range(4):
        bench.redo()
    assert bench.answer.work == last.work
    assert bench.found.tension == last.found.tension
    # undo while the number box has the focus
    bench.step(2)
    nodes = panel.surface.nodes
    bench.type(nodes, "300")
    bench.done()
    assert panel.calibration.settings.nodes == 300
    bench.undo(nodes)
    assert panel.calibration.settings.nodes == 200 == nodes.value()
    # a report is saved
    report, out = panel.report, tmp_path / "mine.toml"
    bench.step(len(panel.pages) - 1)
    for height in (1000, 660):  # the buttons are visible
        bench.resize(1016, height)
        bench.wait_until_shown()
        for button in (panel.use, panel.save_as):
            assert button.visibleRegion().boundingRect().size() == button.size()
            assert button.mapTo(panel, QPoint()).y() >= panel.stack.geometry().bottom()
    assert not panel.next.isVisible()
    bench.bot.mouseClick(panel.next, Qt.MouseButton.LeftButton)  # as if it were on its way
    assert panel.page is report
    found, table = bench.found, report.table
    cells = {
        table.item(k, 0).text(): (table.item(k, 1).text(), table.item(k, 2).text())
        for k in range(table.rowCount())
    }
    own = found.tension
    assert cells["γ0"][1] == f"{own.value:.1f} ± {own.half_width:.1f} N/m"
    assert float(cells["γ0"][0].removesuffix(" N/m")) == pytest.approx(TENSION, rel=0.02)
    # an interval is in the table only
    assert " ± " in cells["γ0"][1] and "γ0 (" in report.advice.text()
    assert "γ0: " not in report.advice.text()
    assert cells["height"][0] == "50.00 mm"
    assert cells["pixels used"] == ("–", f"{found.pixels.mask.sum()} pixels")
    assert "λ" not in cells  # constant tension
    assert report.view.image.shape == found.pixels.mask.shape
    assert np.nanmedian(np.abs(report.view.image)) < 1e-3

    proposed = []
    answer = lambda *given, **_: (proposed.append(given[2]) or out, "")  # noqa: E731
    monkeypatch.setattr(calibration_panel, "new_file", answer)
    bench.click(panel.save_as)
    window = bench.window
    assert window.notice.label.text() == f"Saved {out.name} and {out.stem}_report"
    assert not window.message.isVisible()
    assert panel.steps.button(6).toolTip() == "Report: done"
    sensor = load_sensor(out)
    assert sensor.name == "mine"  # not the name of the initial sensor
    assert Path(proposed[0]).name == f"resting_{time.strftime('%Y-%m-%d')}.toml"
    assert sensor.pneumatics.tension_n_per_m == pytest.approx(found.tension_n_per_m, abs=1e-3)
    assert sensor.resolve(sensor.calibration.pixels_file).exists()
    written = json.loads((tmp_path / "mine_report" / "report.json").read_text())
    for finding in written["verdict"]["advice"]:
        assert finding.replace("--vented", "step Levels") in report.advice.text()
    assert "(step Levels)" in report.advice.text() and "--" not in report.advice.text()
    assert (tmp_path / "mine_report" / "report.html").exists()
    before = {p: p.stat().st_mtime_ns for p in tmp_path.rglob("*")}
    bench.click(panel.save_as)
    assert "exists already" in bench.message_text
    assert {p: p.stat().st_mtime_ns for p in tmp_path.rglob("*")} == before
    bench.click(panel.back)
    assert panel.next.isVisible() and not panel.save_as.isVisible()
    # thresholds change only the mask, and a drag is one undo step
    page, before = bench.panel.pixels, bench.found
    bench.step(1)
    assert " independent ones" in page.numbers.text("frames")
    assert page.view.image.sum() == before.pixels.mask.sum()
    page.deviations.box.setValue(1.0)
    bench.done()
    after, used = bench.found, bench.found.pixels.mask.sum()
    assert used < before.pixels.mask.sum() and page.view.image.sum() == used
    assert page.numbers.text("used") == f"{used} of {after.pixels.mask.size} pixels"
    assert after.surfaces is before.surfaces
    page.validity.box.setValue(100.0)
    bench.done()
    assert panel.calibration.settings.min_validity == pytest.approx(1.0)
    slider, settings = page.deviations.slider, panel.calibration.settings
    slider.setSliderDown(True)
    for place in (40, 35, 30):
        slider.setSliderPosition(place)
    slider.setSliderDown(False)
    bench.done()
    assert panel.calibration.settings.deviations == pytest.approx(2.0)
    bench.undo()
    assert panel.calibration.settings == settings


def make_small(bench):
    """The size of the window on 1024×700 pixels at 150 %."""
    for size in ((800, 500), (675, 427)):
        bench.window.resize(*size)
        bench.wait_until_shown()
    assert bench.size == size


def test_a_low_window_shows_a_part_of_each_page_and_the_wheel_scrolls_it(bench):
    """1024×700 pixels at 150 %, with the verdict."""
    make_small(bench)
    bottom = lambda: bench.panel.next.mapTo(bench.window, QPoint()).y()  # noqa: E731
    before = bottom()
    bench.identify()
    assert bottom() == before  # the next click at the same place hits the same button
    for number in range(len(bench.panel.pages)):
        bench.step(number)
        area = bench.panel.stack.currentWidget()
        assert area.isVisible() and area.viewport().height() > 90, number
    # the wheel over a picture scrolls its page, also after a click, and zooms with Ctrl
    bench.step(1)
    make_small(bench)
    picture = bench.panel.page.view.findChild(QGraphicsView)
    canvas = picture.viewport()
    bar = bench.panel.stack.currentWidget().verticalScrollBar()
    bench.wait(lambda: bar.maximum() > 0)
    boxes = [item for item in picture.scene().items() if isinstance(item, ViewBox)]
    box = max(boxes, key=ViewBox.height)  # the other one is the colour bar
    before = box.viewRange()
    bench.wait(lambda: canvas.visibleRegion().boundingRect().height() > 20)
    place = canvas.visibleRegion().boundingRect().center()
    bench.activate()
    bench.bot.mouseClick(canvas, LEFT, pos=place)
    turn_wheel(canvas, -1, place)
    assert bar.value() > 0 and box.viewRange() == before
    bar.setValue(0)
    turn_wheel(canvas, 1, place, held=CTRL)
    assert bar.value() == 0 and box.viewRange() != before


def test_number_beside_long_names_is_in_one_line(qtbot, qapp):
    form = NumberForm()
    qtbot.addWidget(form)
    long = {"edge of the measured points above the rim plane": "0.015 ± 0.012 mm"}
    form.write({"misfit of ellipsoid": "0.060 mm rms"} | long)
    form.show()
    (number,) = (each for each in form.findChildren(QLabel) if each.text() == "0.060 mm rms")
    for width in range(420, form.minimumSizeHint().width(), -10):
        form.resize(width, 400)
        qtbot.waitUntil(lambda width=width: form.width() == width)
        assert number.height() < 1.5 * number.fontMetrics().lineSpacing(), width


def test_panel_takes_the_free_height_and_level_controls_are_visible(drive):
    driver = drive(frame=3)
    window = driver.window
    dock, panel = window.panels["calibration"], window.calibration
    driver.trigger("View › Calibration")
    driver.wait(lambda: not panel.visibleRegion().isEmpty())
    assert dock in window.tabifiedDockWidgets(window.panels["layers"]) and window.height() <= 700
    assert window.dockWidgetArea(dock) == Qt.DockWidgetArea.RightDockWidgetArea
    for part in (panel.stack, panel.next):  # not squeezed
        assert part.visibleRegion().boundingRect().height() == part.height()
    assert panel.stack.height() > 150
    for scene in ("press", "review"):
        window.use_scene(load_scene(scene))
        driver.show("calibration")
        window.calibration.go_to(4)
        driver.wait_until_shown()
        heights = {name: window.panels[name].height() for name in ("calibration", "kappa")}
        assert heights["calibration"] > 2 * heights["kappa"]
        levels = window.calibration.rectification
        for button in (levels.add, levels.vented):
            assert button.visibleRegion().boundingRect() == button.rect()


@pytest.mark.long
def test_another_inflation_level_is_added_and_undone(bench, tmp_path, monkeypatch):
    bench.identify()
    page, low = bench.panel.rectification, small_sensor()
    source = RestingSource(changed(low, membrane={"height_m": 0.042}))
    record(tmp_path / "low.mcap", (source[k] for k in range(8)))
    bench.step(4)
    assert page.numbers.text("line") == "offset only"
    monkeypatch.setattr(levels_page, "file_to_open", lambda *_, **__: tmp_path / "low.mcap")
    bench.click(page.add)
    assert bench.found.pixels.line.levels == 2
    assert "2 levels" in page.numbers.text("line")
    assert page.numbers.text("λ").startswith("not determined: ")
    bench.undo()
    assert bench.found.pixels.line is None


@pytest.mark.long  # in short: tests/calibration/test_levels.py
def test_known_press_is_predicted_and_compared(drive, sensor):
    """Contact-free frames and one pressed frame of the built-in press, whose pose is known."""
    frame, whole = 18, default_press(sensor)
    source = HeldPress(sensor, whole.obj, whole.poses[[0] * 16 + [80] * 5], whole.noise)
    bench = Bench(drive(lambda _: source, frame=frame))
    bench.identify()
    bench.step(5)
    page, pose = bench.panel.validation, source.poses[frame]
    assert not page.view.isVisible()  # no empty picture with a scale
    assert any("x y z in m" in label.text() for label in page.findChildren(QLabel))
    page.obj.setCurrentText("two_legged_toy")
    numbers = [*pose[:3, 3], *Rotation.from_matrix(pose[:3, :3]).as_quat()]
    page.pose.setText(" ".join(f"{x:.9g}" for x in numbers))
    page.first.setValue(frame)
    page.last.setValue(frame)
    bench.click(page.predict)
    assert not bench.window.message.isVisible()
    found = bench.found.validation
    assert found.rms_m < 0.3 * found.untouched_rms_m
    assert page.numbers.text("distance, rms") == f"{1e3 * found.rms_m:.3f} mm"
    assert page.view.isVisible() and page.view.image.shape == found.predicted_patch.shape
    # only a press that confirms the calibration is ticked
    tip = lambda: bench.panel.steps.button(bench.panel.pages.index(page)).toolTip()  # noqa: E731
    assert page.summary.text().startswith("Known press, good") and tip().endswith("done")
    page.pose.setText(" ".join(f"{x:.9g}" for x in [numbers[0] + 0.008, *numbers[1:]]))
    bench.click(page.predict)
    share = 100.0 * bench.found.validation.patch_overlap
    assert page.summary.text().startswith("Known press, poor")
    assert f"overlap by {share:.0f} %" in page.summary.text() and tip().endswith("needs attention")
