"""Confidence intervals of shown numbers, and dashes for untrusted results."""

import re
from dataclasses import replace

import numpy as np
import pytest
from fakes import FIRST_CONTACT, FRAMES, DentSource, record, small_sensor
from PySide6.QtCore import QPoint, QPointF, Qt
from PySide6.QtGui import QColor
from window_driver import LEFT, drawn_curve, graphics_view, view_texts

from bubbleviz.recordings import Recording
from bubbleviz_ui.shell import theme

PRESSED, ALT = FIRST_CONTACT + 2, Qt.KeyboardModifier.AltModifier
BIAS = np.array([-0.4, -0.6, -0.5])


class Measured(DentSource):
    """A dent with a known wrench, N; from one frame on, an implausible gas pressure."""

    def __init__(self, sensor, wrong_from=FRAMES):
        super().__init__(sensor)
        self._wrong_from, self._rest_pa = wrong_from, sensor.pneumatics.reference_pressure_pa

    def __getitem__(self, index):
        push = 2.0 if index >= FIRST_CONTACT else 0.0
        wrench = np.concatenate([BIAS + push * np.array([0.6, 0.0, -0.8]), np.zeros(3)])
        gas = self._rest_pa + 5e4 if index >= self._wrong_from else None
        return replace(super().__getitem__(index), wrench=wrench, gas_pressure_pa=gas)


class Noisy(Measured):
    """The same with noise of 0.3 N on the wrench."""

    def __getitem__(self, index):
        frame = super().__getitem__(index)
        noise = np.random.default_rng(index).normal(0.0, 0.3, 6)
        return replace(frame, wrench=frame.wrench + noise)


def analyse(driver):
    """Show the force plot and analyse all frames."""
    driver.show("plots")
    driver.wait(lambda: bool(driver.window.plots.plots))
    driver.click(driver.window.plots.analyse)
    known = lambda: not len(driver.state.history.missing(frozenset({"patch"})))  # noqa: E731
    driver.wait(known)
    driver.wait(
        lambda: len(drawn_curve(driver.window.plots.plots["force"], "force_n")[0]) == FRAMES
    )


def heading(driver):
    return re.sub(r"<[^>]*>", "", driver.window.plots.plots["force"].text)


def test_force_has_its_interval_everywhere_and_the_measured_force_is_plotted(drive):
    sensor = small_sensor(prestretch=1.3)
    driver = drive(Measured, sensor=sensor, frame=PRESSED)
    estimate = driver.result.estimate
    force = np.linalg.norm(estimate.force_n)
    along = estimate.force_n / force
    half = 1.96 * np.sqrt(along @ estimate.wrench_covariance[:3, :3] @ along)
    assert half > 0.0
    shown = f"{force:.2f} ± {half:.2f} N"
    window = driver.window
    assert window.status.labels["force"].text() == f"force {shown}"
    assert window.kappa.force.text() == shown
    assert f"contact  {shown}" in view_texts(driver)
    analyse(driver)
    plot = window.plots.plots["force"]
    driver.wait(lambda: heading(driver).startswith(f"Force: {shown[:-2]}"))
    edges = (plot.bands["force_n"].low, plot.bands["force_n"].high)
    driver.wait(lambda: np.isfinite(edges[0].getOriginalDataset()[1][PRESSED]))
    low, high = (edge.getOriginalDataset()[1] for edge in edges)
    assert np.isclose(high[PRESSED] + low[PRESSED], 2.0 * force, rtol=0.05)
    assert high[PRESSED] > low[PRESSED] and np.isnan(low[0])  # no contact has no interval
    # the measured force is plotted too, without its bias
    driver.wait(lambda: np.isfinite(drawn_curve(plot, "measured_force_n")[1]).all())
    values = drawn_curve(plot, "measured_force_n")[1]
    np.testing.assert_allclose(values[:FIRST_CONTACT], 0.0, atol=1e-9)
    np.testing.assert_allclose(values[FIRST_CONTACT:], 2.0)
    driver.wait(lambda: "wrench 2.00 N" in heading(driver))
    # and the estimate over it, with a mark at the frame shown
    window.plots.boxes["wrench"].trigger()
    scatter = window.plots.plots["wrench"]
    driver.wait(lambda: len(scatter.dots.getData()[0]) == FRAMES)
    known = driver.state.history.values["force_n"]
    np.testing.assert_allclose(scatter.dots.getData(), (values, known), atol=1e-9)
    assert scatter.here.getData()[1] == pytest.approx(known[PRESSED])
    # a click on the point of another frame shows that frame, one beside all points none
    driver.wait_for_redraw()
    shown = graphics_view(window.plots)
    for frame, beside in ((0, 40), (FRAMES - 1, -40)):  # px, towards the middle
        before = driver.state.frame
        at = scatter.box.mapViewToScene(QPointF(values[frame], known[frame]))
        at = shown.mapFromScene(at)
        driver.bot.mouseClick(shown.viewport(), LEFT, pos=at + QPoint(beside, 0))
        assert driver.state.frame == before
        driver.bot.mouseClick(shown.viewport(), LEFT, pos=at)
        driver.wait(lambda: values[driver.state.frame] == pytest.approx(values[frame]))  # noqa: B023
    driver.seek(PRESSED)
    # rubber and linear are compared side by side
    driver.show("compare")
    driver.window.panels["compare"].raise_()
    a, b = driver.window.compare.a.values, driver.window.compare.b.values
    driver.wait(lambda: (a["solver"].text(), b["solver"].text()) == ("rubber", "linear"))
    shown = driver.window.status.labels["force"].text().split()
    force, half = float(shown[1]), float(shown[3])
    assert abs(float(a["force"].text().split()[0]) - force) < max(half, 0.02 * force)
    assert "±" in a["force"].text() and "±" in b["force"].text()
    assert b["force"].text().endswith(" N") and b["status"].text() == "ok"
    # the measured force does not depend on the frames computed: it is known before any is
    driver.window.panels["compare"].hide()
    window.plots.boxes["wrench"].trigger()
    driver.show_source(Noisy, sensor, frame=PRESSED)
    wrench = lambda: re.search(r"wrench ([\d.]+)", heading(driver))  # noqa: E731
    driver.wait(lambda: bool(driver.window.plots.plots) and wrench() is not None)
    forces = np.array([Noisy(sensor)[k].wrench[:3] for k in range(FRAMES)])
    expected = np.linalg.norm(forces[PRESSED] - np.median(forces[:FIRST_CONTACT], axis=0))
    assert wrench()[1] == f"{expected:.2f}"
    for frame in (0, 2, PRESSED):
        driver.seek(frame)
    driver.wait(lambda: wrench() is not None)
    assert wrench()[1] == f"{expected:.2f}"
    analyse(driver)
    assert wrench()[1] == f"{expected:.2f}"


def test_mean_image_gas_zero_and_contradicted_sensor_file_of_a_recording_are_reported(
    drive, sensor, tmp_path
):
    dent, random = DentSource(sensor)[PRESSED], np.random.default_rng(0)
    noise = 3e-4 * random.standard_normal((9, *dent.depth_m.shape), dtype=np.float32)
    held = (
        replace(dent, index=k, time_s=k / 30.0, depth_m=dent.depth_m + noise[k]) for k in range(9)
    )
    path = record(tmp_path / "held.mcap", held)
    driver = drive(lambda _: Recording(path), frame=4)
    tip = driver.window.status.labels["force"].toolTip()
    assert "constant tension" in tip and driver.result.frame.images > 5
    assert f"from the mean of {driver.result.frame.images} depth images" in tip
    # a zero of the gas pressure is reported
    gas, messages = driver.window.status.labels["gas"], driver.window.messages
    for shift_pa in (20.0, 1200.0):
        gas_pa = sensor.pneumatics.reference_pressure_pa + shift_pa
        frames = (
            replace(frame, gas_pressure_pa=gas_pa + 100.0 * (frame.index >= FIRST_CONTACT))
            for frame in DentSource(sensor)
        )
        path = record(tmp_path / f"{shift_pa:.0f}.mcap", frames)
        driver.open("dent", lambda _, path=path: Recording(path), sensor, frame=PRESSED)
        done = f"gas pressure zero: {shift_pa:+.0f} Pa from "
        driver.wait(lambda done=done: done in gas.toolTip())
        driver.state.set_playing(False)
        driver.seek(PRESSED)
        assert any(done in each.text for each in messages.all) == (shift_pa > 50.0)
        driver.wait(lambda: gas.text() == "p_v +100 Pa")  # of the contact only
        driver.window.controller.opening.close_source()
        driver.wait(lambda: driver.state.facts.is_empty)
        assert "zero" not in gas.toolTip()
    # and depth that contradicts the sensor file
    still = DentSource(sensor)[0]
    depth = (still.depth_m + 1e-3).astype(np.float32)
    frames = (replace(still, index=k, time_s=k / 30.0, depth_m=depth) for k in range(FRAMES))
    record(tmp_path / "rest.mcap", frames)
    driver.open("rest", lambda _: Recording(tmp_path / "rest.mcap"), sensor, playing=True)
    driver.wait_for_message("depth has drifted by +1.0")
    assert driver.state.playing


def test_untrusted_numbers_are_dashes_with_reason_and_colour(drive):
    driver = drive(lambda sensor: Measured(sensor, PRESSED), frame=PRESSED)
    window, result = driver.window, driver.result
    assert result.estimate.status == "implausible"
    driver.wait_for_message("no frame looks like the membrane of this sensor")
    driver.click(window.message.dismiss)
    assert "153.9 kPa (absolute) in the recording" in driver.message_text
    assert window.status.labels["force"].text() == "force –"
    assert window.status.labels["area"].text() == "patch –"
    assert window.status.labels["residual"].text() == "residual –"
    assert window.kappa.force.text() == "–" and window.kappa.area.text() == "–"
    assert "file by +50.0 kPa" in window.kappa.doubt.text() and window.kappa.doubt.isVisible()
    assert "implausible" in view_texts(driver) and "no contact" not in view_texts(driver)
    assert any("file by +50.0 kPa" in text for text in view_texts(driver))
    driver.resize_to_smallest()
    window.panels["kappa"].raise_()
    assert window.kappa.force.height() >= window.kappa.force.sizeHint().height()  # not squeezed
    picture = window.playback.timeline.grab().toImage()
    bar = window.playback.timeline
    at = QColor(picture.pixel(round(bar.x_at(PRESSED)) + 3, bar.height() - 11))
    assert at == QColor(theme.UNTRUSTED)
    driver.seek(0)
    assert window.status.labels["force"].text() == "force 0.00 N"
    assert not window.kappa.doubt.isVisible() and "no contact" in view_texts(driver)
    analyse(driver)
    driver.seek(PRESSED)
    driver.wait(lambda: heading(driver).startswith("Force: – "))
    assert "not trusted" in heading(driver)
    # by keys to the first of those frames, from both sides
    driver.seek(FRAMES - 1)
    driver.key(Qt.Key.Key_PageUp, ALT)
    assert driver.state.frame == PRESSED
    driver.seek(0)
    driver.key(Qt.Key.Key_PageDown, ALT)
    assert driver.state.frame == PRESSED
    driver.key(Qt.Key.Key_PageDown, ALT)
    assert driver.state.frame == PRESSED
    assert "No further frame that is not trusted" in window.notice.label.text()
