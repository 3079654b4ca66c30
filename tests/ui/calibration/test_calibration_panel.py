"""The γ0 panel in the real window: clicks, drags and keys on a dome known exactly."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from calibration_bench import CTRL, Bench, Drive
from fakes import small_sensor
from PySide6.QtCore import QPoint, Qt
from resting import REST, TENSION, RestingSource

from bubbleviz.calibration.draft import Step
from bubbleviz.calibration.identification import Identification
from bubbleviz.frames.recording import Recording
from bubbleviz.frames.recording_writer import RecordingWriter
from bubbleviz.sensor import Sensor, load_sensor
from bubbleviz.simulation.synthetic_source import SyntheticSource, default_press
from bubbleviz_ui.calibration import report_page
from bubbleviz_ui.calibration.calibration_panel import Gamma0Panel
from bubbleviz_ui.model.scene_presets import load_scene


def test_steps_end_in_gamma0_and_each_is_undone_and_done_again(bench: Bench) -> None:
    panel = bench.panel
    assert not panel.strip.isVisible()
    bench.click(panel.next)
    assert abs(bench.ranges[0][1] - REST) <= 3 and panel.strip.isVisible()
    for step in (Step.PIXELS, Step.SURFACE, Step.TENSION):
        bench.click(panel.next)
        assert panel.calibration.answer.work.settings.reached == step
        assert panel.page.view.image is not None
    estimate = panel.calibration.answer.draft.tension
    value, half = estimate.tension.value, estimate.tension.half_width
    assert panel.tension.numbers.text("γ0") == f"{value:.1f} ± {half:.1f} N/m"
    assert estimate.tension.low < TENSION < estimate.tension.high
    assert value == pytest.approx(TENSION, rel=0.01)
    assert panel.verdict.isVisible() and f"{value:.1f} N/m" in panel.verdict.text()
    gauge = estimate.gauge_pressure_pa
    for system, text in {"psi": f"{gauge / 6894.757:.4f} psi", "kPa": f"{gauge:.0f} Pa"}.items():
        with bench.driver.window.settings.unrecorded():
            bench.driver.state.choose(pressure_unit=system)
        assert f"at {text} gauge pressure" in panel.verdict.text()
        assert panel.tension.numbers.text("gauge pressure") == text
        assert panel.tension.numbers.text("γ0 by gauge pressure").endswith(
            "100 Pa more" if system == "kPa" else "0.0145 psi more"
        )
    last = panel.calibration.answer
    for step in (Step.SURFACE, Step.PIXELS, Step.FRAMES, Step.START):
        bench.undo()
        assert panel.calibration.settings.reached == step
        assert (panel.calibration.answer.draft.tension is None) and not panel.verdict.isVisible()
    assert not panel.strip.isVisible()
    for _ in range(4):
        bench.redo()
    assert panel.calibration.answer.work == last.work
    got = panel.calibration.answer.draft.tension.tension
    assert got == last.draft.tension.tension


def test_the_strip_goes_with_the_panel_and_the_boxes_say_what_was_found(bench: Bench) -> None:
    panel = bench.panel
    bench.click(panel.next)
    found = panel.frames.first.value(), panel.frames.last.value() + 1
    assert found == bench.ranges[0]
    dock = next(d for d in bench.driver.window.panels.values() if d.isAncestorOf(panel))
    for shown in (False, True):
        dock.setVisible(shown)
        assert panel.strip.isVisible() == shown
    dock.close()
    assert not panel.strip.isVisible()


def test_ends_are_moved_on_the_timeline_by_mouse_and_by_keys(bench: Bench) -> None:
    bench.click(bench.panel.next)
    bench.click(bench.panel.next)
    before, strip = bench.panel.calibration.answer.draft, bench.panel.strip
    stop, frame = before.ranges[0][1], bench.driver.state.frame
    bench.drag(strip, stop - 1, 13)
    assert bench.ranges == ((0, 14),)
    assert bench.panel.calibration.answer.draft.samples.frames == tuple(range(14))
    assert bench.panel.calibration.answer.draft.pixels is not before.pixels
    bench.drag(strip, 16, 19)  # over empty frames: another range
    assert bench.ranges == ((0, 14), (16, 20))
    bench.undo()
    bench.undo()
    assert bench.panel.calibration.answer.draft is before  # remembered, not computed again
    strip.setFocus()
    none = Qt.KeyboardModifier.NoModifier
    bench.key(Qt.Key.Key_Left, none, strip)
    bench.key(Qt.Key.Key_Left, none, strip)
    assert bench.ranges == ((0, stop - 2),)
    bench.key(Qt.Key.Key_Space, none, strip)
    bench.key(Qt.Key.Key_Right, none, strip)
    assert bench.ranges == ((1, stop - 2),)
    assert bench.driver.state.frame == frame and not bench.driver.state.playing


def test_a_sample_is_taken_out_and_the_rest_is_kept(bench: Bench) -> None:
    bench.identify()
    panel, before = bench.panel, bench.panel.calibration.answer.draft
    bench.click(panel.steps.button(0))
    panel.frames.first.setValue(5)
    panel.frames.last.setValue(9)
    bench.click(panel.frames.remove)
    after = panel.calibration.answer.draft
    assert after.ranges == ((0, 5), (10, before.ranges[0][1]))
    assert not set(range(5, 10)) & set(after.samples.frames)
    assert after.contact_free is before.contact_free
    assert after.tension.tension.value != before.tension.tension.value
    assert panel.frames.said.text().startswith("frames 0–4, 10–")


def test_another_range_replaces_the_frames_and_what_was_found_of_them(bench: Bench) -> None:
    bench.identify()
    panel, frames = bench.panel, bench.panel.frames
    bench.click(panel.steps.button(2))
    panel.surface.nodes.setValue(150)
    bench.done()
    before = panel.calibration.answer
    bench.click(panel.steps.button(0))
    type_range(bench, "3", "14")
    bench.click(frames.replace)
    after = panel.calibration.answer
    assert after.draft.ranges == ((3, 15),) == panel.strip.ranges
    assert after.work.settings.nodes == 150  # what was chosen later stays
    assert after.draft.tension.tension.value != before.draft.tension.tension.value
    value = after.draft.tension.tension.value
    assert f"{value:.1f} N/m" in panel.verdict.text()
    type_range(bench, "3", "5")
    bench.click(frames.replace)
    assert "at least 5" in bench.driver.window.message.label.text()
    assert panel.verdict.text().startswith("Out of date, of what was chosen before: ")
    tips = [panel.steps.button(k).toolTip() for k in range(7)]
    assert tips[0].endswith("needs attention") and not any(tip.endswith("done") for tip in tips)
    bench.click(panel.steps.button(6))
    assert not panel.report.use_it.isEnabled() and not panel.report.save_as.isEnabled()
    bench.undo()
    assert panel.report.use_it.isEnabled() and panel.report.save_as.isEnabled()
    assert panel.calibration.answer is after and "Out of date" not in panel.verdict.text()


def type_range(bench: Bench, first: str, last: str) -> None:
    for box, number in zip(
        (bench.panel.frames.first, bench.panel.frames.last), (first, last), strict=True
    ):
        box.setFocus()
        box.selectAll()
        bench.driver.bot.keyClicks(box, number + "\r")


def test_thresholds_move_the_mask_alone_and_a_drag_is_undone_at_once(bench: Bench) -> None:
    bench.identify()
    panel, before = bench.panel, bench.panel.calibration.answer.draft
    bench.click(panel.steps.button(1))
    assert " effective frames of " in panel.pixels.numbers.text("frames")
    shown, said = panel.pixels.view.image, panel.pixels.numbers.text("used")
    panel.pixels.deviations.box.setValue(1.0)
    bench.done()
    after = panel.calibration.answer.draft
    assert after.pixels.mask.sum() < before.pixels.mask.sum()
    assert (panel.pixels.view.image.sum(), panel.pixels.numbers.text("used")) == (
        after.pixels.mask.sum(),
        f"{after.pixels.mask.sum()} of {after.pixels.mask.size} pixels",
    )
    assert shown.sum() == before.pixels.mask.sum() and panel.pixels.numbers.text("used") != said
    assert after.surfaces is before.surfaces and after.tension is before.tension
    panel.pixels.validity.box.setValue(100.0)
    bench.done()
    assert panel.calibration.settings.min_validity == pytest.approx(1.0)
    slider, settings = panel.pixels.deviations.slider, panel.calibration.settings
    slider.setSliderDown(True)
    for place in (25, 20, 15):
        slider.setSliderPosition(place)
    slider.setSliderDown(False)
    bench.done()
    assert panel.calibration.settings.deviations == pytest.approx(1.5)
    bench.undo()
    assert panel.calibration.settings == settings


def test_undo_works_from_within_a_text_box(bench: Bench) -> None:
    for _ in range(3):
        bench.click(bench.panel.next)
    bench.click(bench.panel.steps.button(2))
    nodes = bench.panel.surface.nodes
    nodes.setFocus()
    nodes.selectAll()
    bench.driver.bot.keyClicks(nodes, "300\r")
    bench.done()
    assert bench.panel.calibration.settings.nodes == 300
    bench.key(Qt.Key.Key_Z, CTRL, nodes)
    assert bench.panel.calibration.settings.nodes == 200 == nodes.value()


def test_cancel_leaves_everything_as_it_was(drive: Drive) -> None:
    bench = Bench(drive(lambda sensor: RestingSource(sensor, slow_s=0.02)))
    panel = bench.panel
    bench.click(panel.next)
    before, work, index = panel.calibration.answer, panel.calibration.work, bench.undone
    bench.click(panel.all, wait=False)
    bench.driver.wait(lambda: panel.progress.isVisible() and panel.progress.value() > 5)
    bench.driver.seek(7)  # the window goes on
    assert panel.calibration.busy
    bench.click(panel.cancel)
    assert panel.calibration.answer is before and panel.calibration.work == work
    assert bench.undone == index and not panel.progress.isVisible()
    bench.click(panel.all)  # it can be done after all, in the same thread: the other job is over
    assert panel.calibration.answer.draft.tension is not None
    assert bench.undone == index + 1  # and nothing was heard of that one


def test_each_step_says_its_name_its_state_what_to_do_and_what_cannot_be(bench: Bench) -> None:
    panel = bench.panel
    tips = lambda: [panel.steps.button(k).toolTip() for k in range(7)]  # noqa: E731
    assert all(tip.endswith(": to do") for tip in tips())
    assert panel.steps.button(1).text() == "2\nPixels"
    assert "nothing touches" in panel.todo.text() and panel.todo.isVisible()
    bench.click(panel.next)
    bench.click(panel.next)
    assert [tip.endswith(": done") for tip in tips()] == [True, True] + 5 * [False]
    assert panel.steps.button(1).text() == "2 ✓\nPixels"
    assert "which pixels" in panel.todo.text()
    before, message = panel.calibration.answer, bench.driver.window.message
    panel.frames.set_ranges(((0, 3),), "Too few")
    bench.done()
    assert "at least 5" in message.label.text() and message.isVisible()
    assert tips()[0] == "Contact-free frames: needs attention"
    assert panel.calibration.answer is before
    bench.undo()
    assert panel.calibration.work == before.work
    assert tips()[0] == "Contact-free frames: done"
    bench.click(panel.all)
    assert not panel.all.isVisible() and tips()[3] == "γ0: done"


def test_the_report_compares_with_the_sensor_in_use_and_is_saved_once(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.identify()
    panel, out = bench.panel, tmp_path / "mine.toml"
    bench.click(panel.steps.button(len(panel.pages) - 1))
    found = panel.calibration.answer.draft.found
    check_report(panel, found)
    proposed = []
    monkeypatch.setattr(
        report_page,
        "new_file",
        lambda *given, **_: (proposed.append(given[2]) or out, ""),
    )
    bench.click(panel.report.save_as)
    window = bench.driver.window
    assert f"Saved {out}" in window.notice.label.text() and not window.message.isVisible()
    assert panel.steps.button(6).toolTip() == "Report: done"
    sensor = load_sensor(out)
    assert sensor.name == "mine"  # and not that of the sensor it started from
    assert Path(proposed[0]).name == f"resting_{time.strftime('%Y-%m-%d')}.toml"
    assert sensor.pneumatics.tension_n_per_m == pytest.approx(found.tension_n_per_m, abs=1e-3)
    assert sensor.resolve(sensor.calibration.pixels_file).exists()
    assert (tmp_path / "mine_report" / "report.html").exists()
    before = {p: p.stat().st_mtime_ns for p in tmp_path.rglob("*")}
    bench.click(panel.report.save_as)
    assert "exists already" in window.message.label.text()
    assert {p: p.stat().st_mtime_ns for p in tmp_path.rglob("*")} == before


def test_the_report_is_saved_and_used_from_where_other_steps_go_on(bench: Bench) -> None:
    bench.identify()
    window, panel = bench.driver.window, bench.panel
    bench.click(panel.steps.button(len(panel.pages) - 1))
    for height in (660, 1000):
        window.resize(1016, height)
        bench.driver.wait(lambda height=height: window.height() == height)
        bench.driver.settle()
        for button in (panel.report.use_it, panel.report.save_as):
            assert button.visibleRegion().boundingRect().size() == button.size()
            assert button.mapTo(panel, QPoint()).y() >= panel.stack.geometry().bottom()
    assert not panel.next.isVisible()
    bench.click(panel.back)
    assert panel.next.isVisible() and not panel.report.save_as.isVisible()


def check_report(panel: Gamma0Panel, found: Identification) -> None:
    """The table and the picture compare with the sensor in use."""
    table = panel.report.table
    cells = {
        table.item(k, 0).text(): (table.item(k, 1).text(), table.item(k, 2).text())
        for k in range(table.rowCount())
    }
    own = found.tension.tension
    assert cells["γ0"][1] == f"{own.value:.1f} ± {own.half_width:.1f} N/m"
    assert float(cells["γ0"][0].removesuffix(" N/m")) == pytest.approx(TENSION, rel=0.02)
    assert cells["height"][0] == "50.00 mm"
    assert cells["pixels used"] == ("– pixels", f"{found.pixels.mask.sum()} pixels")
    assert cells["λ"] == ("–", "–")  # the tension is constant
    assert panel.report.view.image.shape == found.pixels.mask.shape
    assert np.nanmedian(np.abs(panel.report.view.image)) < 1e-3


def test_it_takes_the_free_height_and_levels_are_added_without_scrolling(drive: Drive) -> None:
    driver = drive(frame=3)
    window = driver.window
    for scene in ("press", "review"):
        window.use_scene(load_scene(scene))
        window.panels["calibration"].show()
        window.gamma0.go_to(4)
        driver.settle()
        heights = {name: window.panels[name].height() for name in ("calibration", "kappa")}
        assert heights["calibration"] > 2 * heights["kappa"]
        levels = window.gamma0.rectification
        for button in (levels.add, levels.vented):
            assert button.visibleRegion().boundingRect() == button.rect()


@pytest.mark.long
def test_another_inflation_level_is_added_and_undone(bench: Bench, tmp_path: Path) -> None:
    bench.identify()
    panel = bench.panel
    low = small_sensor()
    membrane = low.membrane.model_copy(update={"height_m": 0.042})
    source = RestingSource(low.model_copy(update={"membrane": membrane}))
    with RecordingWriter(tmp_path / "low.mcap") as writer:
        for k in range(8):
            writer.write(source[k])
    bench.click(panel.steps.button(4))
    assert panel.rectification.numbers.text("line") == "offset only"
    panel.rectification.add_level(tmp_path / "low.mcap")
    bench.done()
    assert panel.calibration.answer.draft.found.pixels.line.levels == 2
    assert "2 levels" in panel.rectification.numbers.text("line")
    assert panel.rectification.numbers.text("λ").startswith("not determined: ")
    bench.undo()
    assert panel.calibration.answer.draft.found.pixels.line is None


def test_a_known_press_is_predicted_and_painted(drive: Drive, sensor: Sensor) -> None:
    """Some rest and one place of the built-in press: its object and pose are known."""
    frame = 18
    whole = default_press(sensor)
    poses = whole.poses[[0] * 16 + [80] * 5]
    source = SyntheticSource(sensor, whole.obj, poses, whole.noise)
    bench = Bench(drive(lambda _: source, frame=frame))
    panel = bench.panel
    bench.identify()
    bench.click(panel.steps.button(5))
    page = panel.validation
    page.obj.setCurrentText("two_legged_toy")
    from scipy.spatial.transform import Rotation

    pose = source.poses[frame]
    numbers = [*pose[:3, 3], *Rotation.from_matrix(pose[:3, :3]).as_quat()]
    page.pose.setText(" ".join(f"{x:.9g}" for x in numbers))
    page.first.setValue(frame)
    page.last.setValue(frame)
    bench.click(page.predict)
    assert not bench.driver.window.message.isVisible()
    found = panel.calibration.answer.draft.validation
    assert found.rms_m < 0.3 * found.untouched_rms_m
    assert page.numbers.text("distance, rms") == f"{1e3 * found.rms_m:.3f} mm"
    assert page.view.image.shape == found.predicted_patch.shape
    before = bench.driver.window.view.pixels()
    bench.click(page.paint)
    bench.driver.settle()
    assert np.any(bench.driver.window.view.pixels() != before)


@pytest.mark.long
def test_real_press(drive: Drive, punyo_press: Path) -> None:
    sensor = load_sensor("punyo_oval_d405")
    bench = Bench(drive(lambda _: Recording(punyo_press), sensor=sensor))
    bench.identify()
    draft = bench.panel.calibration.answer.draft
    assert len(draft.ranges) == 1 and abs(draft.ranges[0][1] - 60) <= 3
    assert draft.tension.tension.value == pytest.approx(219.3, rel=0.03)
