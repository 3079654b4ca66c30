"""Frames that contradict the calibration: the window has the same warnings as the commands."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from fakes import DentSource, small_sensor
from window_driver import clipboard_text

import bubbleviz as bv
from bubbleviz.recordings import Recording
from bubbleviz_ui.live.connection import single
from bubbleviz_ui.shell.text_dialogs import MessagesDialog
from tests.small_press import record, small_source, write_small_sensor

REST, PRESSED = 18, 10


def camera_moved(frame):
    return replace(frame, depth_m=frame.depth_m + np.float32(1e-3 * (frame.index >= REST)))


def gas_pressure_wrong(frame):
    """A tenth of its change by contact is measured."""
    rest_pa = bv.load_sensor("pico_flexx_75mm").pneumatics.reference_pressure_pa
    return replace(frame, gas_pressure_pa=0.1 * frame.gas_pressure_pa + 0.9 * rest_pa)


def as_it_is(frame):
    return frame


def one_scale_wrong(frame):
    return scale_wrong(frame) if frame.index == REST else frame


def scale_wrong(frame):
    return replace(frame, depth_m=1.4 * frame.depth_m)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return write_small_sensor(tmp_path_factory.mktemp("sensor") / "small.toml")


@cache
def frames(file):
    """Of a cylinder that is pressed in after frames without contact."""
    heights = [0.060] * REST + np.linspace(0.049, 0.036, PRESSED).tolist()
    return list(small_source(file, heights))


def recorded(folder, file, change):
    return record(folder / f"{change.__name__}.mcap", map(change, frames(file)))


def warnings(driver):
    """All that were ever logged."""
    return [each.text for each in driver.window.messages.all if each.kind == "warning"]


@pytest.mark.parametrize("change", [camera_moved, gas_pressure_wrong])
def test_warning_of_the_command_is_shown_once_until_it_is_dismissed(drive, tmp_path, file, change):
    """With the number of frames solved so far, also in the list of all messages."""
    path, sensor = recorded(tmp_path, file, change), bv.load_sensor(file)
    driver = drive(lambda _: Recording(path), sensor)
    window = driver.window
    assert not warnings(driver)  # frames without contact tell nothing
    window.menus.shortcuts.actions["Help › Messages"].trigger()
    (listed,) = window.findChildren(MessagesDialog)
    for frame in range(REST, REST + PRESSED - 1):
        driver.seek(frame)
    driver.wait_for_message("with contact contradicts depth")
    driver.show("plots")
    driver.click(window.plots.analyse)
    expected = f"{bv.estimate(path, file).warning}."
    driver.wait(lambda: driver.message_text == expected)
    assert warnings(driver) == [expected]
    assert listed.text.toPlainText().count("contradicts depth") == 1
    driver.click(listed.copy)
    assert clipboard_text().count("contradicts depth") == 1
    listed.close()
    assert not window.message.more.isVisible()
    # another source has none of it
    driver.show_source(DentSource, sensor)
    assert not window.message.isVisible()


def test_dismissed_warning_stays_away_although_its_number_grows(drive, tmp_path, file):
    path = recorded(tmp_path, file, camera_moved)
    driver = drive(lambda _: Recording(path), bv.load_sensor(file), frame=REST)
    last = iter(range(REST + 1, REST + PRESSED))
    while not warnings(driver):
        driver.seek(next(last))
        driver.wait_until_counted()
    before = driver.message_text
    driver.click(driver.window.message.dismiss)
    while warnings(driver) == [before]:
        driver.seek(next(last))
        driver.wait_until_counted()
    assert not driver.window.message.isVisible()


def test_wrong_scale_is_told_at_the_first_frame(drive, tmp_path, file):
    path = recorded(tmp_path, file, scale_wrong)
    driver = drive(lambda _: Recording(path), bv.load_sensor(file), frame=REST)
    with pytest.raises(bv.InputError, match="no frame looks like the membrane") as refused:
        bv.estimate(path, file)
    driver.wait_for_message("no frame looks like the membrane of this sensor (1 solved)")
    advice = driver.message_text.split("; ")[1].rstrip(".")
    assert advice in str(refused.value)


def test_one_misfit_among_frames_that_fit_says_nothing_of_the_sensor_file(drive, tmp_path, file):
    """The zeros are of frames without contact, which the file fits, although none was looked at."""
    path = recorded(tmp_path, file, one_scale_wrong)
    driver = drive(lambda _: Recording(path), bv.load_sensor(file), frame=REST)
    assert driver.window.controller.result.estimate.status == "implausible"
    for frame in (REST, REST + 4):  # with contact
        driver.seek(frame)
        driver.wait_until_counted()
        assert not warnings(driver)


def test_reloading_one_sensor_keeps_the_warnings_of_the_other(open_bench, file):
    bench = open_bench()
    bench.drop(*(recorded(bench.folder, file, change) for change in (as_it_is, scale_wrong)), file)
    bench.wait_for_message("scale_wrong: no frame looks like the membrane")
    bench.trigger("File › Reload")
    bench.wait(lambda: not bench.window.controller.opening.busy)
    assert bench.window.message.isVisible()
    bench.wait_for_message("scale_wrong: no frame looks like the membrane")


def test_one_frame_with_contact_tells_no_movement_of_the_camera(drive, tmp_path):
    """Its image may be explained by a movement of the camera instead of by the contact."""
    sensor = small_sensor(nodes=80)
    path = record(tmp_path / "dent.mcap", DentSource(sensor))
    driver = drive(lambda _: Recording(path), sensor, frame=8)
    driver.wait_until_counted()
    assert not warnings(driver)


def test_live_frames_that_contradict_those_without_contact(open_bench, file):
    bench = open_bench()
    path = recorded(bench.folder, file, camera_moved)
    bench.connect(single(f"replay:{path}?loop=true", str(file)))
    bench.wait_for_message("with contact contradicts depth in the contact-free ones")
    counted = bench.message_text
    bench.wait(lambda: bench.message_text != counted)  # more of them
    assert len(warnings(bench)) == 1 and "contradicts depth" in bench.message_text
    bench.window.live.leave.click()
    bench.show_source(DentSource, bv.load_sensor(file))
    assert not bench.window.message.isVisible()
