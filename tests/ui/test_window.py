"""The real window on the real pipeline, driven by clicks and keys, its pixels read back."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fakes import FRAMES, DentSource, small_sensor
from PySide6.QtCore import QEvent, QMimeData, QPoint, QPointF, Qt, QUrl
from PySide6.QtGui import QDropEvent
from PySide6.QtWidgets import QApplication, QMessageBox, QWidget
from vtkmodules.vtkRenderingCore import vtkTextActor
from window_driver import Driver, written

import bubbleviz
from bubbleviz.frames.frame import Frame
from bubbleviz.frames.frame_source import FrameSource
from bubbleviz.frames.recording_writer import RecordingWriter
from bubbleviz.sensor import Sensor
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.colour_bar import beside_bars
from bubbleviz_ui.view3d.colour_maps import rgb

Drive = Callable[..., Driver]
LEFT = Qt.MouseButton.LeftButton
CONTACT = 75
"""A frame of the synthetic press with the object well pressed in."""


def click(driver: Driver, widget: QWidget) -> None:
    """Click where a person would: check boxes on their box, everything else in the middle."""
    box = widget.objectName().startswith("layer_") or widget is driver.window.kappa.automatic
    place = QPoint(10, widget.height() // 2) if box else widget.rect().center()
    driver.bot.mouseClick(widget, LEFT, pos=place)


def press_key(driver: Driver, key: Qt.Key) -> None:
    with driver.bot.waitActive(driver.window):
        driver.window.activateWindow()
    driver.bot.keyClick(driver.window, key)


def test_shows_where_the_contact_is(drive: Drive) -> None:
    driver = drive(frame=CONTACT)
    warm = driver.warm_pixels()
    assert len(warm) > 200
    patch = driver.window.controller.result.patch
    renderer = driver.window.view.renderer
    renderer.SetWorldPoint(*patch.center_of_pressure_m, 1.0)
    renderer.WorldToDisplay()
    x, y, _ = renderer.GetDisplayPoint()
    height = driver.window.view.pixels().shape[0]
    row, column = warm.mean(axis=0)
    assert np.hypot(column - x, (height - row) - y) < 80
    driver.seek(0)
    assert len(driver.warm_pixels()) == 0  # no contact is neutral


class Outlier(DentSource):
    """One frame early on has the depth of the last, the deepest."""

    def __getitem__(self, index: int) -> Frame:
        return replace(super().__getitem__(FRAMES - 1 if index == 6 else index), index=index)


def test_one_outlier_does_not_fade_the_other_frames(drive: Drive) -> None:
    driver = drive(Outlier, frame=5)

    def end_pa() -> float:
        high = driver.window.scene.layers["membrane"].actor.mapper.scalar_range[1]
        return driver.state.units.pressure.to_si(high)

    def peak_pa(frame: int) -> float:
        driver.seek(frame)
        peak = float(driver.window.controller.result.estimate.contact_pressure_pa.max())
        assert end_pa() >= peak
        return peak

    usual, outlier = peak_pa(5), peak_pa(6)
    assert outlier > 2.0 * usual
    peak_pa(5)
    assert end_pa() < outlier
    peaks = [peak_pa(frame) for frame in range(7, FRAMES)]
    peak_pa(5)
    assert end_pa() >= sorted([usual, outlier, *peaks])[-3]


def test_hiding_the_membrane_takes_its_pixels_away(drive: Drive) -> None:
    driver = drive(frame=CONTACT)
    boxes = driver.window.layers.boxes
    click(driver, boxes["contour"])
    click(driver, boxes["membrane"])
    assert "membrane" not in driver.state.choices.layers
    driver.settle()
    assert len(driver.warm_pixels()) == 0
    click(driver, boxes["membrane"])
    driver.settle()
    assert len(driver.warm_pixels()) > 200


def test_each_layer_draws_something(drive: Drive) -> None:
    driver = drive(frame=CONTACT)
    driver.state.choose(layers=frozenset())
    driver.settle()
    empty = driver.window.view.pixels()
    for name in ("wireframe", "cloud", "contour", "force", "frustum", "rim"):
        click(driver, driver.window.layers.boxes[name])
        assert driver.state.choices.layers == {name}
        driver.settle()
        assert np.any(driver.window.view.pixels() != empty), name
        driver.state.choose(layers=frozenset())


def test_hidden_cloud_is_not_computed(drive: Drive) -> None:
    driver = drive(frame=CONTACT)
    click(driver, driver.window.layers.boxes["cloud"])
    before = driver.pipeline.counts["cloud"]
    driver.seek(CONTACT + 1)
    assert driver.pipeline.counts["cloud"] == before
    assert driver.window.controller.result.cloud_m is None
    click(driver, driver.window.layers.boxes["cloud"])
    driver.wait(lambda: driver.window.controller.result.cloud_m is not None)


def test_kappa_thresholds_anew_without_solving(drive: Drive) -> None:
    driver = drive(frame=CONTACT)
    panel = driver.window.kappa
    solved, area = driver.pipeline.counts["estimate"], panel.area.text()
    click(driver, panel.automatic)
    panel.slider.setFocus()
    for _ in range(3):
        driver.bot.keyClick(panel.slider, Qt.Key.Key_PageUp)
    kappa = driver.state.choices.kappa
    assert kappa == pytest.approx(panel.box.value())
    driver.wait(lambda: panel.area.text() != area)
    driver.wait(driver.thresholded)
    patch = driver.window.controller.result.patch
    assert panel.threshold.text() == f"{patch.threshold_pa / 1e3:.2f} kPa"
    assert driver.pipeline.counts["estimate"] == solved


def test_another_solver_starts_anew_at_the_same_frame(drive: Drive) -> None:
    driver = drive(frame=CONTACT)
    panel, nodes = driver.window.kappa, len(driver.pipeline.mesh.nodes)
    panel.solver.setFocus()
    driver.bot.keyClicks(panel.solver, "fast")
    assert driver.state.choices.solver == "fast"
    driver.wait(lambda: driver.pipeline.options.relinearisations == 1)
    driver.wait(lambda: driver.window.controller.result is not None)
    assert driver.state.frame == CONTACT
    assert len(driver.pipeline.mesh.nodes) != nodes
    assert driver.window.controller.result.patch.area_m2 > 0.0


def test_points_of_the_patch_follow_kappa_and_have_their_own_colour(drive: Drive) -> None:
    driver = drive(frame=CONTACT)
    driver.state.choose(cloud_colour="patch")
    result = lambda: driver.window.controller.result  # noqa: E731
    driver.wait(lambda: result().patch.pixel_mask is not None)
    driver.settle()
    few = result().patch.pixel_mask.sum()
    solved = driver.pipeline.counts["estimate"]
    driver.state.choose(kappa=0.2)
    driver.wait(lambda: result().patch.pixel_mask.sum() > few)
    assert driver.pipeline.counts["estimate"] == solved
    # in the picture, too
    driver.state.choose(layers=frozenset({"cloud"}))
    driver.settle()
    patch_colour = np.array(rgb(theme.PATCH_POINT))
    assert np.all(driver.window.view.pixels() == patch_colour, axis=2).sum() > 20
    driver.state.choose(cloud_colour="plain")
    driver.settle()
    assert not np.all(driver.window.view.pixels() == patch_colour, axis=2).any()


def test_keys_play_step_and_jump(drive: Drive) -> None:
    driver = drive()
    last = driver.state.facts.frames - 1
    press_key(driver, Qt.Key.Key_Right)
    assert driver.state.frame == 1
    press_key(driver, Qt.Key.Key_End)
    assert driver.state.frame == last
    press_key(driver, Qt.Key.Key_Left)
    assert driver.state.frame == last - 1
    press_key(driver, Qt.Key.Key_Home)
    assert driver.state.frame == 0
    press_key(driver, Qt.Key.Key_Space)
    assert driver.state.playing
    press_key(driver, Qt.Key.Key_Space)
    assert not driver.state.playing
    label = driver.window.status.labels["frame"]  # the frames passed by may come first
    driver.wait(lambda: f"frame {driver.state.frame} of {last + 1}" in label.text())
    box = driver.window.layers.boxes["wireframe"]
    box.setFocus()  # as by Tab
    driver.bot.keyClick(box, Qt.Key.Key_Space)
    assert box.isChecked() and not driver.state.playing


def test_every_number_has_a_unit_and_is_not_clipped(drive: Drive) -> None:
    driver = drive(frame=CONTACT)
    driver.window.show_rates()
    labels = driver.window.status.labels
    for name, unit in {
        "frame": "s", "force": "N", "area": "mm²", "gas": "Pa", "residual": "mm",
        "camera": "Hz", "solve": "Hz", "render": "fps", "dropped": "frames",
    }.items():  # fmt: skip
        assert labels[name].text().endswith(f" {unit}"), labels[name].text()
    assert " ms " in labels["solve"].text()
    driver.window.resize(1280, 800)
    QApplication.processEvents()
    assert driver.window.width() == 1280
    for label in labels.values():
        assert label.fontMetrics().horizontalAdvance(label.text()) <= label.width(), label.text()


def test_new_data_keeps_the_camera_and_the_choices(drive: Drive, sensor: Sensor) -> None:
    first = DentSource(sensor)
    driver = drive(lambda _: first, frame=6)
    view = driver.window.view
    middle = view.rect().center()
    driver.bot.mousePress(view, LEFT, pos=middle)
    driver.bot.mouseMove(view, middle + QPoint(60, 25))
    driver.bot.mouseRelease(view, LEFT, pos=middle + QPoint(60, 25))
    moved = tuple(view.camera.position)
    driver.state.choose(kappa=2.5, membrane_opacity=0.5)
    driver.seek(8)
    other = small_sensor("another", nodes=150)
    driver.window.controller.opening.open("dent", DentSource, lambda: other, frame=7, playing=False)
    driver.wait(lambda: driver.state.facts.sensor_name == "another")
    driver.settle()
    assert tuple(view.camera.position) == pytest.approx(moved)
    assert driver.state.choices.kappa == 2.5 and driver.thresholded()
    assert driver.state.choices.membrane_opacity == 0.5
    assert first.closed


def test_a_file_that_cannot_be_opened_is_a_message(drive: Drive, tmp_path: Path) -> None:
    driver = drive(frame=CONTACT)
    title, message = driver.window.windowTitle(), driver.window.message
    (tmp_path / "broken.mcap").write_bytes(b"not a recording")
    for bad in (tmp_path / "missing.mcap", tmp_path / "broken.mcap", tmp_path / "missing.toml"):
        message.hide()
        driver.window.open_file(bad)
        driver.wait(message.isVisible)
        assert bad.name in message.label.text()
    assert driver.window.windowTitle() == title
    driver.seek(CONTACT + 2)
    for bad in ("missing.toml", "broken.mcap", "missing.mcap"):
        assert bad in message.label.text()
        click(driver, message.dismiss)
    assert not message.isVisible()
    # a file that is dropped is tried as well
    data = QMimeData()
    data.setUrls([QUrl.fromLocalFile(str(tmp_path / "dropped.mcap"))])
    buttons, keys = Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier
    drop = QDropEvent(
        QPointF(5, 5), Qt.DropAction.CopyAction, data, buttons, keys, QEvent.Type.Drop
    )
    driver.window.view.dropEvent(drop)
    driver.wait(message.isVisible)
    assert "dropped.mcap" in message.label.text()


def test_playback_and_status_bar_name_the_same_frame_while_it_plays(drive: Drive) -> None:
    driver = drive(playing=True)
    window, seen = driver.window, list[tuple[str, str]]()

    def look() -> bool:
        texts = window.playback.readout.text(), window.status.labels["frame"].text()
        seen.append(tuple(text.replace("·", " ").split()[1] for text in texts))
        return len(set(seen)) > 12

    driver.wait(look)
    assert all(one == other for one, other in seen)


def test_errors_of_opening_do_not_outlive_what_is_opened(
    drive: Drive, press: FrameSource, tmp_path: Path
) -> None:
    driver, cut = drive(frame=CONTACT), tmp_path / "cut.mcap"
    with RecordingWriter(cut) as writer:
        for k in range(len(press)):
            writer.write(press[k])
    os.truncate(cut, cut.stat().st_size - 20)
    message = driver.window.message
    for bad in (tmp_path / "one.mcap", tmp_path / "two.mcap"):
        bad.write_text("text")
        driver.window.open_file(bad)
        driver.wait(lambda bad=bad: bad.name in message.label.text())
    driver.window.open_file(cut)
    driver.wait(lambda: message.kind.text() == "Warning")
    assert "cut off" in message.label.text() and not message.more.isVisible()


def test_a_frame_that_cannot_be_read_is_a_message_and_stops_playback(drive: Drive) -> None:
    driver = drive(lambda sensor: DentSource(sensor, broken_from=3), playing=True)
    driver.wait(driver.window.message.isVisible)
    assert "damaged" in driver.window.message.label.text()
    assert not driver.state.playing
    driver.seek(2)


def test_a_bug_in_the_solver_is_a_message_with_details(drive: Drive) -> None:
    driver = drive()

    def broken(*_: object) -> None:
        raise ZeroDivisionError("a bug")

    driver.pipeline.process = broken  # type: ignore[method-assign]
    driver.state.seek(1)
    driver.wait(driver.window.message.isVisible)
    click(driver, driver.window.message.copy)
    assert "Traceback" in QApplication.clipboard().text()


def test_closing_while_playing_stops_everything(drive: Drive) -> None:
    driver = drive(playing=True)
    driver.wait(lambda: driver.state.frame > 2)
    driver.window.close()


def test_playback_asks_ahead_but_never_goes_back(drive: Drive) -> None:
    driver = drive()
    driver.state.choose(loop=False, speed=0.25)
    driver.state.seek(0)
    played: list[int] = []
    driver.state.frame_changed.connect(lambda index, _: played.append(index))
    driver.state.set_playing(True)
    driver.wait(lambda: len(played) > 4)  # a slow machine leaves frames out
    driver.state.set_playing(False)
    assert played == sorted(set(played))


def test_play_button_plays_and_pauses_and_the_numbers_follow(drive: Drive) -> None:
    driver = drive()
    click(driver, driver.window.playback.play)
    driver.wait(lambda: driver.state.frame > 5)
    driver.wait(lambda: driver.window.controller.result.frame.index > 3)
    click(driver, driver.window.playback.play)
    assert not driver.state.playing
    driver.settle()
    shown = driver.window.controller.result.frame.index
    assert driver.window.status.labels["frame"].text().startswith(f"frame {shown} of ")
    assert f"frame {shown} of" in driver.window.playback.readout.text()


def test_full_screen_and_about_say_what_runs(drive: Drive) -> None:
    driver = drive()
    actions = driver.window.shortcuts.actions
    actions["View › Full screen"].trigger()
    assert driver.window.isFullScreen()
    actions["View › Full screen"].trigger()
    assert not driver.window.isFullScreen()
    actions["Help › About bubbleviz"].trigger()
    (about,) = driver.window.findChildren(QMessageBox)
    assert bubbleviz.__version__ in about.text() and "Qt 6" in about.informativeText()
    assert driver.window.view.quality.text in about.informativeText()
    about.accept()


def test_a_small_screen_holds_the_window_and_the_force(drive: Drive) -> None:
    driver = drive(DentSource, frame=6)
    labels = driver.window.status.labels
    driver.window.resize(1016, 660)
    driver.wait(lambda: driver.window.width() == 1016)
    driver.wait(lambda: not labels["dropped"].isVisible())
    shown = [label for label in labels.values() if label.isVisible()]
    assert labels["force"] in shown and labels["frame"] in shown
    for label in shown:
        assert label.geometry().right() <= driver.window.status.width()
        assert label.width() >= label.fontMetrics().horizontalAdvance(label.text())
    driver.window.resize(1500, 800)
    driver.wait(lambda: labels["dropped"].isVisible())


def right_end(driver: Driver, text: vtkTextActor) -> float:
    """Where a text of the 3-D view ends, pixels."""
    box, renderer = [0.0] * 4, driver.window.view.renderer
    text.GetBoundingBox(renderer, box)
    return text.GetPositionCoordinate().GetComputedViewportValue(renderer)[0] + box[1]


def test_a_large_scale_on_a_small_screen_holds_the_window(drive: Drive) -> None:
    """As 1024×700 at 150 %, less the frame."""
    driver = drive(DentSource, frame=6)
    window = driver.window
    window.resize(850, 427)
    driver.wait(lambda: window.minimumSize().width() <= 675)
    window.resize(675, 427)
    driver.settle()
    assert (window.width(), window.height()) == (675, 427)
    assert window.playback.mapTo(window, window.playback.rect().bottomRight()).x() <= 675
    assert window.layers.visibleRegion().boundingRect().height() > 50
    assert window.view.width() > 350 and window.view.height() > 150
    bars = window.view.width() * beside_bars(window.view.width())
    (rest,) = (text for text in written(driver) if text.GetInput().startswith("peak"))
    assert 0.3 * bars < right_end(driver, rest) < bars
    window.resize(1200, 700)
    driver.wait(lambda: window.playback.width() < window.width() - 200)
