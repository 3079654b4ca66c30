"""A calibration that is not saved: used, sent along, asked for and kept when its source goes."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest
from calibration_bench import CTRL, Bench, Drive, answered, cancelling, record
from PySide6.QtCore import Qt
from resting import RestingSource, never_written

from bubbleviz.calibration import save_identification
from bubbleviz.sensor import Sensor, load_sensor
from bubbleviz_ui.calibration import report_page
from bubbleviz_ui.engine.source_openers import recording


def test_the_new_sensor_is_used_undone_and_sent_with_the_session(
    drive: Drive, sensor: Sensor, resting: RestingSource, tmp_path: Path
) -> None:
    """Identified and used, but saved nowhere: its files are gone when the window is."""
    mine = tmp_path / "mine"
    mine.mkdir()
    record(resting, mine / "rest.mcap")
    bench = Bench(drive(recording(mine / "rest.mcap")))
    bench.identify()
    window, calibration = bench.driver.window, bench.panel.calibration
    answer = calibration.answer
    bench.click(bench.panel.steps.button(len(bench.panel.pages) - 1))
    bench.click(bench.panel.report.use_it)
    bench.driver.wait(lambda: window.controller.sensor is not sensor)
    assert f"{sensor.name}, identified (not saved)" in window.windowTitle()
    assert bench.driver.pipeline.model.pixels is not None
    assert calibration.answer is answer  # the same source: nothing is lost
    bench.undo()
    bench.driver.wait(lambda: window.controller.sensor is sensor)
    bench.redo()
    bench.driver.wait(lambda: window.controller.sensor is not sensor)
    used = window.controller.sensor
    assert used.calibration is not None
    assert not any(str(used.folder) in path for path in window.session_saver.recent)
    window.session_saver.save_as(mine / "look.bubbleviz")
    answered(bench, window.close, "Discard")
    assert not used.folder.exists()
    mine.rename(tmp_path / "theirs")
    other = drive()
    other.window.open_file(tmp_path / "theirs" / "look.bubbleviz")
    other.wait(lambda: other.state.facts.frames == len(resting))
    other.settle()
    theirs = other.window.controller.sensor
    assert theirs.pneumatics == used.pneumatics and theirs.calibration == used.calibration
    assert other.pipeline.model.pixels is not None and not other.window.message.isVisible()


def test_an_identification_outlives_close_and_another_recording_asks_for_it(
    drive: Drive, resting: RestingSource, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("rest", "other"):
        record(resting, tmp_path / f"{name}.mcap")
    bench = Bench(drive(recording(tmp_path / "rest.mcap")))
    bench.identify()
    window, panel = bench.driver.window, bench.panel
    answer, title = panel.calibration.answer, lambda: bench.driver.state.facts.title
    bench.key(Qt.Key.Key_W, CTRL)
    bench.driver.wait(lambda: bench.driver.state.facts.nothing)
    assert panel.calibration.answer is answer and panel.verdict.isVisible()
    assert not panel.strip.isVisible()  # there is no timeline that it is of
    window.open_file(tmp_path / "rest.mcap")
    bench.driver.wait(lambda: title() == "rest.mcap")
    assert panel.calibration.answer is answer and panel.strip.isVisible()

    def other() -> None:
        window.open_file(tmp_path / "other.mcap")

    assert "rest.mcap is not saved" in answered(bench, other, "Cancel")
    bench.driver.settle()
    assert title() == "rest.mcap" and panel.calibration.answer is answer
    out = tmp_path / "mine.toml"
    monkeypatch.setattr(report_page, "new_file", lambda *_, **__: (None, ""))
    answered(bench, other, "Save…")  # and cancelled there
    bench.driver.settle()
    assert title() == "rest.mcap" and panel.calibration.answer is answer
    monkeypatch.setattr(report_page, "new_file", lambda *_, **__: (out, ""))
    with monkeypatch.context() as slowly, cancelling(bench):
        slowly.setattr(save_identification, "save", never_written)
        answered(bench, other, "Save…")
    bench.driver.settle()
    assert title() == "rest.mcap" and panel.calibration.answer is answer and not out.exists()
    answered(bench, other, "Save…")
    bench.driver.wait(lambda: title() == "other.mcap")
    found = answer.draft.found.tension_n_per_m
    assert load_sensor(out).pneumatics.tension_n_per_m == pytest.approx(found, abs=1e-3)
    assert panel.calibration.answer.draft.found is None


def test_closing_asks_and_a_session_that_is_refused_changes_nothing(
    drive: Drive, resting: RestingSource, tmp_path: Path
) -> None:
    for name in ("rest", "other"):
        record(resting, tmp_path / f"{name}.mcap")
    other = drive(recording(tmp_path / "other.mcap"))
    other.state.choose(layers=frozenset({"rim"}))
    other.window.session_saver.save_as(tmp_path / "look.bubbleviz")
    bench = Bench(drive(recording(tmp_path / "rest.mcap")))
    bench.identify()
    window, state = bench.driver.window, bench.driver.state
    before = state.choices, window.open_panels.names, state.facts
    look = partial(window.open_file, tmp_path / "look.bubbleviz")
    assert "rest.mcap is not saved" in answered(bench, look, "Cancel")
    bench.driver.settle()
    assert (state.choices, window.open_panels.names, state.facts) == before
    close = window.shortcuts.actions["File › Quit"].trigger
    assert "rest.mcap is not saved" in answered(bench, close, "Cancel")
    assert window.isVisible() and bench.panel.calibration.unsaved
    answered(bench, look, "Discard")
    bench.driver.wait(lambda: state.facts.title == "other.mcap")
    assert state.choices.layers == {"rim"}
    window.close()  # nothing to ask
    assert not window.isVisible()


@pytest.mark.long
def test_an_identification_is_discarded_when_asked_and_not_asked_for_when_saved(
    drive: Drive, resting: RestingSource, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("rest", "other"):
        record(resting, tmp_path / f"{name}.mcap")
    bench = Bench(drive(recording(tmp_path / "other.mcap")))
    window, panel = bench.driver.window, bench.panel
    bench.identify()
    answered(bench, lambda: window.open_file(tmp_path / "rest.mcap"), "Discard")
    bench.driver.wait(lambda: bench.driver.state.facts.title == "rest.mcap")
    assert panel.calibration.answer.draft.found is None
    bench.identify()
    bench.click(panel.steps.button(len(panel.pages) - 1))
    out = tmp_path / "mine.toml"
    monkeypatch.setattr(report_page, "new_file", lambda *_, **__: (out, ""))
    bench.click(panel.report.save_as)
    window.open_file(tmp_path / "other.mcap")  # saved: nothing to ask
    bench.driver.wait(lambda: bench.driver.state.facts.title == "other.mcap")
