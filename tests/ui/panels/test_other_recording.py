"""Another recording, or another sensor file, beside the open one: curves, numbers, membrane."""

import re
from dataclasses import replace

import numpy as np
import pytest
from fakes import FRAMES, DentSource, record, small_sensor
from PySide6.QtWidgets import QApplication, QFileDialog
from vtkmodules.vtkRenderingCore import vtkAssembly
from window_driver import vtk_props

from bubbleviz.sensor import save_sensor
from bubbleviz_ui.engine.source import Source
from tests.small_press import changed

LATER, STEP_S = 3, 1.0 / 30.0
"""Frames by which the press of the other recording is later."""
PRESSED = 8


@pytest.fixture
def driver(drive, tmp_path, sensor):
    """A window on a press, of which `later.mcap` is a recording that began earlier."""
    dent = DentSource(sensor)
    frames = [dent[k] for k in range(FRAMES)]
    press = record(tmp_path / "press.mcap", frames)
    # images without returns: further ones without contact would tell more of the camera's errors
    nothing = replace(frames[0], depth_m=np.full_like(frames[0].depth_m, np.nan))
    waiting = LATER * [nothing] + frames
    later = [replace(each, index=k, time_s=k * STEP_S) for k, each in enumerate(waiting)]
    record(tmp_path / "later.mcap", later)
    driver = drive(Source.of_recording(press), frame=PRESSED)
    driver.state.change(plots=frozenset({"force", "area"}), layers=frozenset({"membrane", "rim"}))
    driver.window.resize(1280, 800)
    driver.show("plots", "compare")
    driver.wait(lambda: driver.window.plots.isVisible() and bool(driver.window.plots.plots))
    QApplication.processEvents()
    driver.wait_until_shown()
    yield driver
    driver.release()


@pytest.fixture
def choose(driver, monkeypatch):
    """Click a button that asks for a file, and choose one."""

    def chosen(button, path):
        monkeypatch.setattr(QFileDialog, "getOpenFileName", lambda *_: (str(path), ""))
        driver.click(button)

    return chosen


def numbers(driver, title):
    """Those of a line of the panel: at the cursor, median, 95 %, largest."""
    (line,) = [line for line in driver.window.compare.other.result.text().splitlines()
               if line.startswith(title)]  # fmt: skip
    return [float(text) for text in re.findall(r"([\d.]+) (?:N|mm²)", line)]


def second_membranes(driver):
    return [p for p in vtk_props(driver) if isinstance(p, vtkAssembly) and p.GetVisibility()]


@pytest.mark.long  # in short: tests/api/test_compare.py
def test_another_recording_or_sensor_file_is_overlaid_compared_and_drawn_beside(
    driver, choose, sensor, tmp_path
):
    panel, plots = driver.window.compare.other, driver.window.plots
    assert not panel.start.isEnabled() and not panel.drawn.isEnabled()
    choose(panel.recording, tmp_path / "later.mcap")
    assert panel.recording.text() == "later.mcap"
    shares: list[float] = []
    panel.worker.progressed.connect(lambda _, share: shares.append(share))
    driver.click(panel.start)
    driver.wait(lambda: "median" in panel.result.text())
    assert shares == sorted(shares)  # of both recordings together
    by_time = numbers(driver, "|ΔF|")
    driver.pick(panel.align, "By first contact")
    assert f"-{LATER * STEP_S:.3f} s" in panel.result.text()
    here, median, _, largest = numbers(driver, "|ΔF|")
    assert max(here, median) <= largest < 0.2 * by_time[1]
    assert numbers(driver, "|Δarea|")[1] < 0.1 * 1e6 * driver.result.patch.area_m2
    # the curves of both lie on each other
    driver.click(plots.analyse)
    known = driver.state.history.quantity
    driver.wait(lambda: np.isfinite(known("force_n")).all())
    for plot, quantity, scale in (("force", "force_n", 1.0), ("area", "area_m2", 1e6)):
        times, values = plots.plots[plot].other_curves[quantity].getOriginalDataset()
        own, same = scale * known(quantity), times > -0.5 * STEP_S
        np.testing.assert_allclose(times[same], np.arange(FRAMES) * STEP_S, atol=1e-6)
        np.testing.assert_allclose(values[same], own, atol=0.1 * own.max())
    # its membrane is drawn beside at the same moment
    assert not second_membranes(driver)
    driver.click(panel.drawn)
    driver.wait_for_redraw()
    (second,) = second_membranes(driver)
    low, high = np.array(second.GetBounds()).reshape(3, 2).T
    own = driver.nodes()
    assert low[0] > own[:, 0].max() and high[1] == pytest.approx(own[:, 1].max(), rel=0.05)

    def warm_halves():
        """Pixels in the colours of pressure, left and right of the middle of the picture."""
        columns = driver.pressure_pixels()[:, 1]
        middle = driver.pixels().shape[1] / 2
        return np.count_nonzero(columns < middle), np.count_nonzero(columns > middle)

    left, right = warm_halves()
    assert min(left, right) > 20 and right == pytest.approx(left, rel=0.5)
    driver.seek(0)
    driver.wait_for_redraw()
    assert warm_halves() == (0, 0)  # neither touches
    driver.click(panel.drawn)
    assert not second_membranes(driver)
    # another setting makes other numbers: none of the old ones stays
    driver.state.change(kappa=3.0)
    assert (
        panel.result.text() == ""
        and plots.plots["force"].other_curves["force_n"].getData()[0] is None
    )
    driver.choose(kappa=None)
    # what cannot be read is said
    choose(panel.recording, tmp_path / "missing.mcap")
    driver.click(panel.start)
    driver.wait(lambda: "missing.mcap" in panel.result.text())
    assert panel.start.isEnabled()
    driver.click(panel.remove)
    assert panel.result.text() == "" and not panel.start.isEnabled()
    assert panel.recording.text() == "Recording…"
    # the same recording is compared with another sensor file
    driver.seek(PRESSED)
    gauge = {"gauge_pressure_pa": 1.5 * sensor.pneumatics.gauge_pressure_pa}
    save_sensor(changed(sensor, pneumatics=gauge), tmp_path / "other.toml")
    choose(panel.sensor_file, tmp_path / "other.toml")
    driver.click(panel.start)
    driver.wait(lambda: "median" in panel.result.text())
    here, *_ = numbers(driver, "|ΔF|")
    force = np.linalg.norm(driver.result.patch.force_n)
    assert here == pytest.approx(0.5 * force, rel=0.15)  # force is proportional to the gauge
    driver.click(panel.remove)
    assert panel.result.text() == "" and not panel.start.isEnabled()
    choose(panel.sensor_file, tmp_path / "other.toml")
    driver.click(panel.start)
    driver.wait(lambda: "median" in panel.result.text())
    # nothing of it stays with another source
    driver.click(panel.drawn)
    driver.wait_for_redraw()
    assert second_membranes(driver)
    driver.open("nothing of this", DentSource, small_sensor())
    driver.wait(lambda: panel.result.text() == "")
    assert not second_membranes(driver)
    driver.wait_until_shown()
