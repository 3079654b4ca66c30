"""Sensor panel: values in use, saving of an edited copy, and a sensor file that changes on disk."""

import numpy as np
import pytest
from fakes import DentSource, small_sensor
from window_driver import Driver, answer_file_dialog

from bubbleviz.sensor import Calibration, load_sensor, sensor_to_toml
from bubbleviz_ui.sensor import sensor_panel
from tests.small_press import changed

GAUGE, TENSION = "pneumatics.gauge_pressure_pa", "pneumatics.tension_n_per_m"


@pytest.fixture
def left(tmp_path):
    """Sensor file of an identified sensor."""
    sensor = small_sensor("left finger")
    size = sensor.camera.height, sensor.camera.width
    np.savez(
        tmp_path / "left.npz",
        mask=np.ones(size, bool),
        bias_m=np.zeros(size),
        noise_m=np.full(size, 1e-4),
        correlated_pixels=1.0,
    )
    calibration = Calibration(
        pixels_file="left.npz",
        recording="rest.mcap",
        date="2026-11-20T09:30:00+00:00",
        tension_interval_n_per_m=(103.0, 107.5),
        gauge_interval_pa=(2500.0, 2700.0),
        gauge_from="a manometer",
        sheet_share_interval=(0.1, 0.7),
        stiffness_gradient_y_interval=(-0.25, 0.05),
    )
    air = sensor.pneumatics.model_copy(update={"tension_n_per_m": 105.25})
    rim = sensor.membrane.model_copy(update={"sheet_share": 0.4, "stiffness_gradient_y": -0.1})
    update = {"calibration": calibration, "pneumatics": air, "membrane": rim}
    known = sensor.model_copy(update=update)
    path = tmp_path / "left.toml"
    path.write_text("# by hand\n" + sensor_to_toml(known))
    return path


class Bench(Driver):
    @property
    def panel(self):
        return self.window.sensor

    @property
    def sensor(self):
        return self.window.controller.sensor

    def write(self, key, text):
        box = self.panel.rows[key].box
        box.selectAll()
        self.bot.keyClicks(box, text)

    def save(self, path, monkeypatch):
        monkeypatch.setattr(sensor_panel, "new_file", lambda *_, **__: (path, ""))
        self.click(self.panel.save)


@pytest.fixture
def bench(drive, left):
    made = Bench(**vars(drive(DentSource, sensor=load_sensor(left), frame=6)))
    made.show("sensor")
    made.wait(made.panel.edit.isVisible)
    yield made
    made.release()


def test_sensor_panel_shows_name_and_file_and_saves_an_edited_copy(bench, left, monkeypatch):
    window, panel = bench.window, bench.panel
    assert "left finger (left.toml)" in window.windowTitle()
    assert "left finger (left.toml)" in window.status.labels["sensor"].toolTip()
    assert panel.name.text() == "left finger" and panel.file.text() == str(left)
    assert panel.camera.text() == "80×60 pixels"
    tension, gauge = panel.rows[TENSION], panel.rows[GAUGE]
    assert tension.shown.text() == "105.25 N/m" and tension.interval.text() == "103.0 … 107.5 N/m"
    assert gauge.interval.text() == "2500 … 2700 Pa"
    assert panel.rows["membrane.prestretch"].shown.text() == "not in the file"
    share = panel.rows["membrane.sheet_share"]
    assert (share.shown.text(), share.interval.text()) == ("0.4000", "0.10 … 0.70")
    uneven = panel.rows["membrane.stiffness_gradient_y"]
    assert (uneven.shown.text(), uneven.interval.text()) == ("-0.1000", "-0.25 … 0.05")
    assert gauge.interval.toolTip() == "from a manometer"
    assert panel.identified.text() == "2026-11-20 09:30 UTC"
    assert panel.recording.text() == "rest.mcap"
    bench.state.change(pressure_unit="psi")
    assert panel.rows[GAUGE].shown.text().endswith(" psi")
    # a failed save keeps the edits
    before = left.read_bytes()
    bench.click(bench.panel.edit)
    bench.write(TENSION, "101.5")
    bench.state.change(pressure_unit="psi", solver="linear")  # reopens the sensor
    bench.wait_until_shown()
    bench.save(left, monkeypatch)
    assert "exists already" in bench.message_text
    assert left.read_bytes() == before
    assert bench.panel.rows[TENSION].box.text() == "101.5" and bench.panel.save.isEnabled()
    bench.click(bench.panel.cancel)
    assert bench.panel.rows[TENSION].shown.text() == "105.25 N/m"
    # a copy with another value is saved and used
    bench.click(bench.window.message.dismiss)
    bench.state.change(pressure_unit="kPa", solver=None)
    bench.wait_until_shown()
    copy = left.with_name("right.toml")
    bench.click(bench.panel.edit)
    bench.write(GAUGE, "5.259")
    assert "gauge_pressure_pa = 5.259" in bench.panel.problem.text()
    assert "pressures are in pascals" in bench.panel.problem.text()
    assert not bench.panel.save.isEnabled()
    bench.write(GAUGE, "2610.5")
    assert bench.panel.problem.isHidden()
    bench.save(copy, monkeypatch)
    bench.wait(lambda: bench.sensor.file == "right.toml")
    saved = load_sensor(copy)
    assert saved.pneumatics.gauge_pressure_pa == 2610.5 and saved.name == "left finger, edited"
    assert saved.calibration is not None and saved.calibration.gauge_interval_pa is None
    assert saved.calibration.tension_interval_n_per_m == (103.0, 107.5)
    assert saved.calibration.pixels_file == "right.npz" and left.read_bytes() == before
    assert "right.toml" in bench.window.windowTitle() and bench.panel.edit.isVisible()
    bench.wait(lambda: bench.panel.identified.text().endswith("UTC, edited since"))
    assert f"Saved {copy}" in bench.window.notice.label.toolTip()
    # named without its suffix it is a TOML file
    monkeypatch.undo()
    bench.click(bench.panel.edit)
    assert answer_file_dialog(bench, bench.panel.save.click, str(left.parent / "double")) == [
        "dialog"
    ]
    bench.wait(lambda: bench.sensor.file == "double.toml")
    assert not bench.window.message.isVisible()
    bench.click(bench.panel.edit)
    answer_file_dialog(bench, bench.panel.save.click, str(left.parent / "double"))
    bench.wait_for_message("double.toml: exists already")


def test_changed_sensor_file_is_reported_and_reloaded_and_a_preset_is_labelled(bench, left):
    message, text = bench.window.message, left.read_text()
    left.write_text(text.replace("by hand", "by hand, tidied"))  # says the same
    new = left.with_suffix(".new")
    new.write_text(text.replace("105.25", "106.5"))
    new.replace(left)  # as editors do
    bench.wait(message.isVisible)
    assert f"{left}: has changed on disk" in message.label.text()
    assert message.kind.text() == "Warning"
    assert bench.panel.rows[TENSION].shown.text() == "105.25 N/m"
    bench.click(bench.panel.reload)
    bench.wait(lambda: bench.panel.rows[TENSION].shown.text() == "106.50 N/m")
    assert not message.isVisible() and bench.panel.difference.isHidden()
    left.write_text("nonsense")
    bench.wait(message.isVisible)
    assert "cannot be used" in message.label.text()
    left.unlink()
    bench.wait(lambda: "was removed" in message.label.text())
    left.write_text(text.replace("105.25", "106.5"))
    bench.wait(lambda: bench.panel.difference.isHidden())
    # so are pixels that change, and the panel fits a small screen
    pixels, dock = left.with_suffix(".npz"), bench.window.panels["sensor"]
    pixels.write_bytes(pixels.read_bytes())
    bench.wait_for_message("mesh or pixels have changed on disk")
    bench.click(bench.panel.reload)
    bench.wait(bench.panel.difference.isHidden)
    bench.resize(1016, 660)
    assert bench.window.tabifiedDockWidgets(dock)
    right = dock.mapTo(bench.window, dock.rect().bottomRight())
    assert right.x() <= 1016 and right.y() <= 660
    assert dock.height() > 250
    # noise of depth has three digits, and a preset is labelled
    panel, other = bench.panel, changed(load_sensor(left), camera={"noise_relative": 0.000643})
    bench.open("dent", DentSource, other, playing=False)
    bench.wait(lambda: bench.sensor.camera.noise_relative == 0.000643)
    row = panel.rows["camera.noise_relative"]
    bench.wait(row.isVisible)
    assert row.shown.text() == "0.0643 % of the range"
    bench.click(panel.edit)
    assert row.box.text() == "0.000643" and row.unit.text() == "of the range"
    assert row.unit.isVisible()
    bench.click(panel.cancel)
    bench.open("dent", DentSource, load_sensor("pico_flexx_75mm"), playing=False)
    bench.wait(lambda: "soft-bubble pico flexx (preset)" in bench.window.windowTitle())
    assert panel.file.text() == "preset"
