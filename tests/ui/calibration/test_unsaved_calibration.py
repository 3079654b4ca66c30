"""Unsaved calibrations: use, session files, questions, and a closed source."""

import gc
import weakref
from functools import partial

import pytest
from calibration_bench import Bench, answered, cancelling
from fakes import record
from PySide6.QtCore import Qt
from resting import never_written
from window_driver import CTRL

from bubbleviz.sensor import load_sensor
from bubbleviz_ui.calibration import calibration_panel
from bubbleviz_ui.engine.source import Source


@pytest.fixture
def folder(resting, tmp_path):
    """A folder with two recordings at rest."""
    mine = tmp_path / "mine"
    mine.mkdir()
    for name in ("rest", "other"):
        record(mine / f"{name}.mcap", resting)
    return mine


def released(each):
    """Whether nothing keeps an object any more but a cycle."""
    gc.collect()
    return each() is None


def test_unsaved_sensor_is_used_undone_and_saved_with_the_session(drive, sensor, folder, tmp_path):
    """An identified sensor that was not saved; its temporary files are deleted with the window."""
    bench = Bench(drive(Source.of_recording(folder / "rest.mcap")))
    bench.identify()
    window, answer = bench.window, bench.answer
    bench.step(len(bench.panel.pages) - 1)
    bench.click(bench.panel.use)
    bench.wait(lambda: window.controller.sensor is not sensor)
    assert f"{sensor.name}, identified (not saved)" in window.windowTitle()
    assert bench.pipeline.model.pixels is not None
    assert bench.answer is answer  # the same source keeps the results
    bench.undo()
    bench.wait(lambda: window.controller.sensor is sensor)
    bench.redo()
    bench.wait(lambda: window.controller.sensor is not sensor)
    used = window.controller.sensor
    assert used.calibration is not None
    assert not any(str(used.folder) in path for path in window.session_saver.recent)
    window.session_saver.save_as(folder / "look.bubbleviz")
    answered(bench, window.close, "Discard")
    assert not used.folder.exists()
    folder.rename(tmp_path / "theirs")
    other = drive()
    other.window.files.open(tmp_path / "theirs" / "look.bubbleviz")
    other.wait(lambda: other.state.facts.title == "rest.mcap")
    other.wait_until_shown()
    theirs = other.window.controller.sensor
    assert theirs.pneumatics == used.pneumatics and theirs.calibration == used.calibration
    assert other.pipeline.model.pixels is not None and not other.window.message.isVisible()


def test_a_saved_sensor_is_used_by_its_file_and_of_it_nothing_is_asked(
    drive, folder, tmp_path, monkeypatch
):
    bench = Bench(drive(Source.of_recording(folder / "rest.mcap")))
    bench.identify()
    bench.step(len(bench.panel.pages) - 1)
    bench.panel.save(tmp_path / "mine.toml")
    bench.wait(lambda: not bench.panel.calibration.unsaved and bench.panel.use.isEnabled())
    bench.click(bench.panel.use)
    bench.wait(lambda: bench.window.controller.sensor.name == "mine")
    assert "not saved" not in bench.window.windowTitle()
    bench.undo()
    bench.wait(lambda: bench.window.controller.sensor.name != "mine")
    (tmp_path / "mine.toml").unlink()
    bench.click(bench.panel.use)
    bench.wait(lambda: "not saved" in bench.window.windowTitle())
    monkeypatch.setattr(calibration_panel, "new_file", lambda *_, **__: (folder / "own.toml", ""))
    bench.click(bench.panel.save_as)
    bench.wait(lambda: "– own (" in bench.window.windowTitle())  # and opened again from its file
    assert "not saved" not in bench.window.windowTitle()
    bench.window.files.open(folder / "other.mcap")
    bench.wait(lambda: bench.state.facts.title == "other.mcap")


@pytest.mark.long  # in short: below
def test_identification_survives_close_and_another_recording_asks_to_save_it(
    drive, folder, monkeypatch
):
    bench = Bench(drive(Source.of_recording(folder / "rest.mcap")))
    bench.identify()
    window, panel, answer = bench.window, bench.panel, bench.answer
    bench.key(Qt.Key.Key_W, CTRL)
    bench.wait(lambda: bench.state.facts.is_empty)
    assert bench.answer is answer and panel.verdict.isVisible()
    window.files.open(folder / "rest.mcap")
    bench.wait(lambda: bench.state.facts.title == "rest.mcap")
    assert bench.answer is answer
    other, out = partial(window.files.open, folder / "other.mcap"), folder / "mine.toml"

    def refused(button, file):
        """Answer the question, or its dialog; the current source stays open."""
        monkeypatch.setattr(calibration_panel, "new_file", lambda *_, **__: (file, ""))
        assert "rest.mcap is not saved" in answered(bench, other, button)
        bench.wait_until_shown()
        assert bench.state.facts.title == "rest.mcap" and bench.answer is answer
        assert not out.exists()

    refused("Cancel", None)
    refused("Save…", None)
    with monkeypatch.context() as slowly, cancelling(bench):
        slowly.setattr("bubbleviz.calibration.write_sensor", never_written)
        refused("Save…", out)
    monkeypatch.setattr(calibration_panel, "new_file", lambda *_, **__: (out, ""))
    answered(bench, other, "Save…")
    bench.wait(lambda: bench.state.facts.title == "other.mcap")
    found = answer.found.tension_n_per_m
    assert load_sensor(out).pneumatics.tension_n_per_m == pytest.approx(found, abs=1e-3)
    assert not bench.found.complete


def test_closing_asks_to_save_and_a_cancelled_session_changes_nothing(drive, folder):
    other = drive(Source.of_recording(folder / "other.mcap"))
    other.state.change(layers=frozenset({"rim"}))
    other.window.session_saver.save_as(folder / "look.bubbleviz")
    other.window.files.open(folder / "rest.mcap")
    other.wait(lambda: other.state.facts.title == "rest.mcap")
    bench = Bench(other)
    bench.identify()
    window, state = bench.window, bench.state
    before = state.settings, window.open_panels, state.facts
    samples = weakref.ref(bench.answer.found.samples)  # a hundred MB of a large camera
    look = partial(window.files.open, folder / "look.bubbleviz")
    assert "rest.mcap is not saved" in answered(bench, look, "Cancel")
    bench.wait_until_shown()
    assert (state.settings, window.open_panels, state.facts) == before
    close = partial(bench.trigger, "File › Quit")
    assert "rest.mcap is not saved" in answered(bench, close, "Cancel")
    assert window.isVisible() and bench.panel.calibration.unsaved
    answered(bench, look, "Discard")
    bench.wait(lambda: state.facts.title == "other.mcap")
    assert state.settings.layers == {"rim"} and not bench.found.complete
    bench.wait(lambda: released(samples))
    window.close()  # no question
    assert not window.isVisible()
