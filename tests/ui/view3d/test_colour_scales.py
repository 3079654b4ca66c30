"""One colour scale for a recording, locked by a click on its bar."""

import re
from dataclasses import replace

import numpy as np
import pytest
from fakes import FRAMES, DentSource, HeldSource
from PySide6.QtCore import QPoint, Qt
from window_driver import CTRL, Driver, colour_bar, hover, view_texts

from bubbleviz.diagnostics import Numbers
from bubbleviz_ui.export.exporting import KINDS
from bubbleviz_ui.model.frame_history import Extremes


@pytest.fixture
def few_sampled_frames():
    """As many as outside of tests."""


class LongSource(DentSource):
    """160 frames, of which `deep` have the dent of the last one of `DentSource`."""

    def __init__(self, sensor, deep, usual=7):
        super().__init__(sensor)
        self._deep, self._usual = deep, usual
        self.times_s = np.arange(160) / 30.0

    def __getitem__(self, index):
        like = FRAMES - 1 if index in self._deep else min(index, self._usual)
        frame = super().__getitem__(like)
        return replace(frame, index=index, time_s=float(self.times_s[index]))


def scale(driver, quantity="pressure"):
    """Upper end of a colour bar, displayed unit."""
    return colour_bar(driver, quantity).GetLookupTable().GetRange()[1]


def peak_kpa(driver, frame):
    driver.seek(frame)
    return 1e-3 * float(driver.result.estimate.contact_pressure_pa.max())


def test_playback_solves_only_frames_it_shows_and_idle_time_completes_the_scale(
    qtbot, new_window, sensor
):
    # reading a frame takes longer than a slice of frames solved in advance
    source, driver = HeldSource(sensor, slow_s=0.05), Driver(qtbot, new_window())
    driver.open("held", lambda _: source, sensor, playing=False)
    driver.window.show()
    driver.wait(lambda: not driver.state.facts.is_empty)
    state, shown = driver.state, []
    state.set_range((0, 3))  # without contact
    state.set_playing(True)
    driver.window.controller.shown.connect(lambda result: shown.append(result.frame.index))
    source.released.set()
    driver.wait(lambda: len(shown) > 12)
    before = scale(driver)
    assert state.playing and set(shown) | set(source.read) <= {0, 1, 2, 3}
    state.set_playing(False)
    driver.wait_until_solved_ahead()
    assert set(source.read) == set(range(FRAMES)) and scale(driver) > before


def test_frames_solved_ahead_are_drawn_again_only_for_another_scale(drive):
    driver = drive(lambda sensor: LongSource(sensor, deep=(), usual=3), frame=0)  # no contact
    before = driver.window.view.render_count
    driver.window.controller.client.scale_to(range(20))
    driver.wait_until_solved_ahead()
    assert driver.window.view.render_count == before + 1  # asked for by the driver


def test_usual_peak_pressure_never_shrinks_while_a_press_grows_and_leaves_out_outliers():
    extremes, seen = Extremes(), []
    for frame, peak_kpa in enumerate((1.0, 5.0, 9.0, 11.0, 12.0, 12.5, 12.2)):
        extremes.include(frame, Numbers(peak_pa=1e3 * peak_kpa))
        seen.append(extremes.usual_peak_pa)
    assert seen == sorted(seen) and seen[-1] == 12_500.0
    for frame in (7, 8):
        extremes.include(frame, Numbers(peak_pa=60e3))
    assert extremes.usual_peak_pa == 12_500.0
    extremes.include(9, Numbers(peak_pa=60e3))  # three are no outliers
    assert extremes.usual_peak_pa == 60e3
    for frame in (7, 8, 9):  # solved anew, as in a loop
        extremes.include(frame, Numbers(peak_pa=50e3))
    assert extremes.usual_peak_pa == 60e3


def test_scale_grows_only_in_the_first_pass_of_playback(qtbot, new_window, sensor):
    driver, shown, ends = Driver(qtbot, new_window()), [], []
    driver.window.controller.shown.connect(lambda result: shown.append(result.frame.index))
    driver.window.view.rendered.connect(lambda: shown and ends.append(scale(driver)))
    driver.state.change(loop=True, every_frame=True)  # before a frame is shown, or skipped
    driver.open("dent", DentSource, sensor, frame=0, playing=True)
    driver.window.show()
    driver.wait(lambda: len(shown) > FRAMES)
    driver.wait_for_redraw()
    first = len(ends)
    driver.wait(lambda: len(shown) > 3 * FRAMES)
    assert shown == [k % FRAMES for k in range(len(shown))]
    assert ends == sorted(ends) and set(ends[first:]) == {ends[-1]}


def test_scale_is_the_same_in_all_frames_of_a_video_and_without_outliers(drive, sensor, tmp_path):
    # although the frames solved ahead have a smaller pressure
    deep = range(75, 80)
    driver = drive(lambda sensor: LongSource(sensor, deep, usual=0), frame=0)
    before, window, seen = scale(driver), driver.window, []
    window.view.rendered.connect(lambda: seen.append((window.controller.result, scale(driver))))
    out = tmp_path / "press.mp4"
    driver.choose(picture_size=(320, 240))
    seen.clear()
    (video,) = (kind for kind in KINDS if kind.is_video)
    window.exporting.start(video, range(70, 80), out)
    driver.wait(lambda: not window.exporting.busy)
    drawn = {result.frame.index: end for result, end in seen if result.frame.index >= 70}
    assert set(drawn) == set(range(70, 80)) and len(set(drawn.values())) == 1
    assert drawn[70] > before and out.stat().st_size > 1000
    outlier = 77
    # outliers do not change the scale
    driver.show_source(lambda sensor: LongSource(sensor, {outlier}), sensor)
    driver.wait_until_solved_ahead()
    end = scale(driver)
    usual = [peak_kpa(driver, frame) for frame in (8, 9, 76)]
    assert peak_kpa(driver, outlier) > end >= max(usual) and scale(driver) == end
    assert peak_kpa(driver, 78) <= end == scale(driver)


def place_of_bar(driver, quantity):
    """Middle of a colour bar in the view."""
    bar, view = colour_bar(driver, quantity), driver.window.view
    x, y = bar.GetPosition()
    x, y = x + 0.5 * bar.GetWidth(), y + 0.5 * bar.GetHeight()
    return QPoint(round(x * view.width()), round((1.0 - y) * view.height()))


def test_one_scale_for_all_frames_of_a_recording_and_for_images(drive):
    driver = drive(DentSource, frame=0)
    ends = {scale(driver)}
    for frame in range(FRAMES):
        peak = peak_kpa(driver, frame)
        ends.add(scale(driver))
    assert len(ends) == 1 and ends.pop() >= peak
    # the residual has the same scale in images and in the view
    driver.window.resize(1280, 800)
    driver.choose(layers=frozenset({"membrane", "cloud"}), images=frozenset({"residual"}))
    driver.show("images")
    panel = driver.window.images
    driver.wait(lambda: bool(panel.cells) and panel.cells["residual"].image is not None)
    driver.wait_until_solved_ahead()

    def ends():
        """Ends of the legend of the residual image, mm."""
        legend = panel.cells["residual"].text.partition("<br>")[2]
        low, *_, high, unit = re.sub("<[^>]*>", "", legend).split()
        return float(low), float(high), unit

    for locked_m in (None, 2.2e-4, None):
        driver.choose(residual_max_m=locked_m)
        driver.seek(7 if locked_m else 6)
        end = scale(driver, "residual")
        driver.wait(lambda end=end: ends() == (-end, end, "mm"))
        assert locked_m is None or end == 1e3 * locked_m


def test_a_click_on_the_bar_locks_its_scale(drive, sensor):
    driver = drive(DentSource, frame=6)
    for quantity, unit in (("pressure", "kPa"), ("residual", "mm")):
        driver.show_source(DentSource, sensor, frame=6)
        check_lock(driver, sensor, quantity, unit)
        driver.choose(pressure_max_pa=None, residual_max_m=None)


def check_lock(driver, sensor, quantity, unit):
    driver.choose(layers=frozenset({"membrane", "cloud"}))
    driver.wait_until_solved_ahead()
    end, title = scale(driver, quantity), {"pressure": "contact pressure"}.get(quantity, quantity)
    at, view = place_of_bar(driver, quantity), driver.window.view
    hover(view, QPoint(5, 5))
    assert not view.toolTip()
    hover(view, at)
    assert "lock" in view.toolTip()
    assert f"{title}\n({unit})" in view_texts(driver)
    driver.bot.mouseClick(view, Qt.MouseButton.LeftButton, pos=at)
    driver.wait(lambda: f"{title}\n({unit}), locked" in view_texts(driver))
    # another recording has the same scale, although its own would be smaller
    calm = lambda sensor: LongSource(sensor, set(), usual=0)  # noqa: E731
    driver.open("calm", calm, sensor, playing=False)
    driver.wait(lambda: driver.state.facts.frames == 160)
    driver.wait_until_solved_ahead()
    assert scale(driver, quantity) == end
    driver.bot.mouseClick(view, Qt.MouseButton.LeftButton, pos=at)
    driver.wait(lambda: f"{title}\n({unit})" in view_texts(driver))
    driver.wait_for_redraw()
    assert quantity == "residual" or scale(driver) < end
    driver.key(Qt.Key.Key_Z, CTRL)
    driver.wait_for_redraw()
    assert scale(driver, quantity) == end
