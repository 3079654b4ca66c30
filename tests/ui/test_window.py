"""The complete window, driven by clicks and keys, its pixels read back."""

import os
import re

import numpy as np
import pytest
from fakes import DentSource, record, small_sensor
from PySide6.QtCore import QEvent, QMargins, QObject, QPoint, Qt
from PySide6.QtGui import QAction
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractSlider,
    QAbstractSpinBox,
    QApplication,
    QComboBox,
    QLabel,
    QScrollBar,
    QWidget,
)
from window_driver import CONTACT, LEFT, clipped_texts, text_actors, turn_wheel

from bubbleviz.sensor import Membrane
from bubbleviz_ui.model.demand import STAGES
from bubbleviz_ui.model.scene_presets import load_scene
from bubbleviz_ui.model.settings import Settings
from bubbleviz_ui.panels.status_bar import TIPS
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.colours import rgb
from bubbleviz_ui.view3d.text import left_of_bars


def test_contact_and_layers_are_drawn_for_each_threshold_and_solver(drive):
    driver = drive(frame=CONTACT)
    warm = driver.pressure_pixels()
    assert len(warm) > 200
    patch = driver.result.patch
    renderer = driver.window.view.renderer
    renderer.SetWorldPoint(*patch.center_of_pressure_m, 1.0)
    renderer.WorldToDisplay()
    x, y, _ = renderer.GetDisplayPoint()
    height = driver.pixels().shape[0]
    row, column = warm.mean(axis=0)
    assert np.hypot(column - x, (height - row) - y) < 80
    driver.seek(0)
    assert len(driver.pressure_pixels()) == 0  # neutral without contact
    # another κ needs no solving
    driver.seek(CONTACT)
    panel = driver.window.kappa
    solved, area = driver.pipeline.counts["estimate"], panel.area.text()
    driver.click(panel.automatic)
    panel.by_kappa.slider.setFocus()
    for _ in range(3):
        driver.bot.keyClick(panel.by_kappa.slider, Qt.Key.Key_PageUp)
    kappa = driver.state.settings.kappa
    assert kappa == pytest.approx(panel.box.value())
    driver.wait(lambda: panel.area.text() != area)
    driver.wait(driver.shows_chosen_kappa)
    patch = driver.result.patch
    assert panel.threshold.text() == f"{patch.threshold_pa / 1e3:.2f} kPa"
    assert driver.pipeline.counts["estimate"] == solved
    # each layer draws something and can be hidden
    driver.choose(kappa=None)
    boxes = driver.window.layers.boxes
    driver.click(boxes["contour"])
    for shown in (False, True):
        driver.click(boxes["membrane"])
        assert ("membrane" in driver.state.settings.layers) == shown
        driver.wait_until_shown()
        assert (len(driver.pressure_pixels()) > 200) == (len(driver.pressure_pixels()) > 0) == shown
    # a hidden cloud is not computed
    before = driver.pipeline.counts["cloud"]
    driver.seek(CONTACT + 1)
    assert driver.pipeline.counts["cloud"] == before and driver.result.cloud_m is None
    driver.click(boxes["cloud"])
    driver.wait(lambda: driver.result.cloud_m is not None)
    driver.choose(layers=frozenset())
    empty = driver.pixels()
    for name in ("wireframe", "cloud", "contour", "force", "frustum", "rim"):
        driver.click(boxes[name])
        assert driver.state.settings.layers == {name}
        driver.wait_until_shown()
        assert np.any(driver.pixels() != empty), name
        driver.state.change(layers=frozenset())
    # points of the patch follow κ and have their own colour
    driver.state.change(layers=frozenset({"membrane", "cloud"}))
    driver.seek(CONTACT)
    driver.state.change(cloud_colour="patch")
    result = lambda: driver.result  # noqa: E731
    driver.wait(lambda: result().patch.pixel_mask is not None)
    driver.wait_until_shown()
    few = result().patch.pixel_mask.sum()
    solved = driver.pipeline.counts["estimate"]
    driver.state.change(kappa=0.2)
    driver.wait(lambda: result().patch.pixel_mask.sum() > few)
    assert driver.pipeline.counts["estimate"] == solved
    # also in the picture
    driver.choose(layers=frozenset({"cloud"}))
    patch_colour = np.array(rgb(theme.PATCH_POINT))
    assert np.all(driver.pixels() == patch_colour, axis=2).sum() > 20
    driver.choose(cloud_colour="plain")
    assert not np.all(driver.pixels() == patch_colour, axis=2).any()
    # another solver reopens at the same frame
    driver.choose(layers=Settings().layers, kappa=None)
    panel, nodes = driver.window.kappa, len(driver.pipeline.mesh.nodes)
    panel.solver.setFocus()
    driver.bot.keyClicks(panel.solver, "fast")
    assert driver.state.settings.solver == "fast"
    driver.wait(lambda: driver.pipeline.options.nodes == 400)
    assert driver.state.frame == CONTACT
    assert len(driver.pipeline.mesh.nodes) != nodes
    assert driver.result.patch.area_m2 > 0.0


def test_numbers_have_units_and_room_and_every_control_has_a_tooltip(drive):
    driver = drive(frame=CONTACT)
    driver.window.show_rates()
    labels = driver.window.status.labels
    for name, unit in {
        "frame": "s", "force": "N", "area": "mm²", "gas": "Pa", "residual": "mm",
        "camera": "Hz", "solve": "Hz", "render": "fps",
    }.items():  # fmt: skip
        assert labels[name].text().endswith(f" {unit}"), labels[name].text()
    assert " ms " in labels["solve"].text() and " frame" in labels["dropped"].text()
    for label in (labels["frame"], labels["force"]):  # whatever the other labels need
        assert label.fontMetrics().horizontalAdvance(label.text()) <= label.minimumWidth()
    # every control has a tooltip, and labels say what they mean
    silent = []
    for name, panel in driver.window.panels.items():
        for widget in panel.findChildren(QWidget):
            own = not widget.objectName().startswith("qt_") and not isinstance(widget, QScrollBar)
            if isinstance(widget, CONTROLS) and own and not widget.toolTip():
                text = widget.text() if isinstance(widget, QAbstractButton) else ""
                silent.append((name, type(widget).__name__, text))
    assert not silent
    texts = said(driver.window) | set(STAGES.values())
    assert texts >= {
        "Colour points by", "Maximum pressure", "Maximum residual ±", "Rotate", "Probe",
        "Turntable", "Remove", "Remove parts below", "Pressure prior",
        "Pixel binning", "Gas pressure change p_v",
    }  # fmt: skip
    assert driver.window.status.labels["gas"].text().startswith("p_v ")
    bare = re.compile(r"(?<!section )\b(V-C|VI)\b|^\W*Eq\.")
    assert not [text for text in texts if bare.search(text)]
    for name in ("force", "area", "gas", "residual"):
        assert "Eq." in TIPS[name] or "V-C" in TIPS[name]
    # numbers of another frame lay out nothing unless they need more room
    driver.resize(1024, 700)
    driver.wait_until_shown()
    status, requests = driver.window.status, LayoutRequests()
    status.installEventFilter(requests)
    text = status.labels["force"].text()
    for frame in range(CONTACT + 1, CONTACT + 5):
        driver.seek(frame)
    assert status.labels["force"].text() != text and requests.count == 0
    status.labels["force"].setText("8" * 40)
    driver.wait(lambda: requests.count > 0 and not clipped_texts(status))
    # nor does a window at rest, also with panels behind tabs that are wider in front
    requests = LayoutRequests()
    driver.window.installEventFilter(requests)
    for name in ("compare", "sensor"):
        driver.show(name)
        driver.wait_until_shown()
        for _ in range(20):
            before = requests.count
            QApplication.processEvents()
        assert before == requests.count > 0


def test_new_source_keeps_camera_and_settings_and_is_shown_whole(drive, sensor):
    first = DentSource(sensor)
    driver = drive(lambda _: first, frame=6)
    view = driver.window.view
    turn_view(driver)
    moved = tuple(view.camera.position)
    driver.state.change(kappa=2.5, membrane_opacity=0.5)
    driver.seek(8)
    other = small_sensor("another", nodes=150)
    driver.open("dent", DentSource, other, frame=7, playing=False)
    driver.wait(lambda: driver.state.facts.sensor_name == "another")
    driver.wait_until_shown()
    assert tuple(view.camera.position) == pytest.approx(moved)
    assert driver.state.settings.kappa == 2.5 and driver.shows_chosen_kappa()
    assert driver.state.settings.membrane_opacity == 0.5
    assert first.closed
    # a sensor of another size
    turn_wheel(view, 5)  # zooms
    half = Membrane(rim_radius_m=0.0375, height_m=0.025, nodes=150)
    other = sensor.model_copy(update={"name": "half", "membrane": half})
    driver.open("dent", DentSource, other, frame=7, playing=False)
    driver.wait(lambda: driver.state.facts.sensor_name == "half")
    driver.wait_until_shown()
    seen = [view.screen_position(node) for node in driver.pipeline.mesh.nodes]
    across, down = (np.ptp([getattr(at, axis)() for at in seen]) for axis in "xy")
    assert all(view.rect().contains(at.toPoint()) for at in seen)
    assert max(across / view.width(), down / view.height()) > 0.5


def turn_view(driver):
    """Drag the 3-D view to another viewpoint."""
    view = driver.window.view
    middle = view.rect().center()
    driver.drag(view, middle, middle + QPoint(60, 25))


def test_errors_of_files_and_frames_are_shown_until_another_file_opens(drive, tmp_path, press):
    driver = drive(frame=CONTACT)
    title, message = driver.window.windowTitle(), driver.window.message
    (tmp_path / "broken.mcap").write_bytes(b"not a recording")
    for bad in (tmp_path / "missing.mcap", tmp_path / "broken.mcap", tmp_path / "missing.toml"):
        message.hide()
        driver.window.files.open(bad)
        driver.wait(message.isVisible)
        assert bad.name in message.label.text()
    assert driver.window.windowTitle() == title
    driver.seek(CONTACT + 2)
    for bad in ("missing.toml", "broken.mcap", "missing.mcap"):
        assert bad in message.label.text()
        driver.click(message.dismiss)
    assert not message.isVisible()
    # dropped files too, and bugs in a reader are reported
    driver.drop(tmp_path / "dropped.mcap")
    driver.wait_for_message("dropped.mcap")
    driver.open("buggy", lambda _: int("no"), driver.window.controller.sensor)
    driver.wait_for_message("ValueError: ")
    driver.seek(CONTACT)
    # opening another source removes the errors
    cut = tmp_path / "cut.mcap"
    record(cut, (press[k] for k in range(5)))
    os.truncate(cut, cut.stat().st_size - 20)
    message = driver.window.message
    for bad in (tmp_path / "one.mcap", tmp_path / "two.mcap"):
        bad.write_text("text")
        driver.window.files.open(bad)
        driver.wait(lambda bad=bad: bad.name in message.label.text())
    driver.window.files.open(cut)
    driver.wait(lambda: message.kind.text() == "Warning")
    assert "ends early" in message.label.text() and not message.more.isVisible()
    # an unreadable frame stops playback
    broken_file = lambda sensor: DentSource(sensor, broken_from=3)  # noqa: E731
    driver.open("broken", broken_file, driver.window.controller.sensor, playing=True)
    driver.wait_for_message("damaged")
    assert not driver.state.playing
    driver.seek(2)
    driver.click(driver.window.message.dismiss)
    # also a bug in the solver, with details

    def broken(*_):
        raise ZeroDivisionError("a bug")

    driver.pipeline.process = broken
    driver.state.seek(1)
    driver.wait_for_message("a bug")
    driver.click(driver.window.message.copy)
    assert "Traceback" in QApplication.clipboard().text()


def test_window_force_readout_and_panels_fit_a_small_screen(drive):
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
    window = driver.window
    driver.resize_to_smallest()
    driver.wait_until_shown()
    assert driver.size == (675, 427)
    assert window.playback.mapTo(window, window.playback.rect().bottomRight()).x() <= 675
    assert window.layers.visibleRegion().boundingRect().height() > 50
    assert window.view.width() > 350 and window.view.height() > 150
    bars = window.view.width() * left_of_bars(window.view.width())
    window.scene.reset_view()  # leaves a border
    assert np.abs(window.view.projected(driver.pipeline.mesh.nodes)[:, :2]).max() < 0.98
    (rest,) = (text for text in text_actors(driver) if text.GetInput().startswith("peak"))
    assert 0.3 * bars < right_end(driver, rest) < bars
    # a long message scrolls; the readout leaves most of a low view free
    driver.show("plots", "pose")
    driver.state.set_range((2, 8))  # with its statistics
    driver.wait_until_shown()
    window.messages.add("warning", "another")  # so that the bar's controls need a row
    window.messages.add("warning", 20 * "long message ")
    driver.wait(lambda: window.message.isVisible() and window.view.height() < 180)
    driver.wait_until_shown()
    headline, *others = text_actors(driver)
    assert headline.GetInput().startswith("contact")
    assert text_bottom(driver, headline) < 0.4 * window.view.height()
    assert not any(text.GetInput().startswith("peak") for text in others)
    for name in ("plots", "pose"):
        window.panels[name].hide()
    # panels become tabs where the window would grow beyond the screen
    driver.show("compare")
    results = [label for of in (window.compare.a, window.compare.b) for label in of.values.values()]
    driver.wait(lambda: all(seen(label) == label.height() for label in results))
    for name, panel in (("plots", window.plots), ("calibration", window.calibration)):
        driver.show(name)
        driver.wait(lambda panel=panel: seen(panel) > 100)
        driver.wait_until_shown()
        assert driver.size == (675, 427)
    assert seen(window.plots.statistics) > 30 and seen(window.view) > 100
    assert seen(window.message.dismiss) == window.message.dismiss.height()
    driver.click(window.message.dismiss)
    driver.click(window.message.dismiss)
    driver.wait(lambda: any(t.GetInput().startswith("peak") for t in text_actors(driver)))
    assert window.panels["layers"] in window.tabifiedDockWidgets(window.panels["compare"])
    entry = window.panels["compare"].toggleViewAction()
    entry.trigger()  # in front of the tabs it is behind
    driver.wait(lambda: seen(window.compare) > 50)
    assert entry.isChecked()
    entry.trigger()
    driver.wait(lambda: window.panels["compare"].isHidden())
    assert not entry.isChecked()
    driver.show("compare")
    window.panels["compare"].hide()
    driver.show("compare")  # in front of the tabs it was behind
    driver.wait(lambda: seen(window.compare) > 50)
    driver.resize(1200, 700)
    driver.wait(lambda: window.playback.width() < window.width() - 200)


def seen(widget):
    """Height of the part of a widget that is on the screen, px."""
    return widget.visibleRegion().boundingRect().height()


def test_all_panels_fit_a_small_window_and_come_apart_in_a_large_one(drive, tmp_path):
    """With the first-run hint."""
    driver = drive(DentSource, frame=6)
    window, panels = driver.window, driver.window.panels
    window.hint.show()
    driver.resize_to_smallest()
    opened = "shear", "plots", "images", "threshold", "pose", "calibration", "compare", "tools"
    for name in opened:
        driver.show(name)
        driver.wait(lambda name=name: seen(panels[name].widget()) > 60)
        driver.wait_until_shown()
        assert driver.size == (675, 427)
        bottom = panels[name].y() if name in ("plots", "images") else 427
        assert window.view.mapTo(window, window.view.rect().bottomLeft()).y() < bottom
    for name in opened[3:]:
        panels[name].hide()
    panels["shear"].raise_()
    driver.wait(lambda: seen(panels["shear"]) > 60)
    window.session_saver.save_as(tmp_path / "small.bubbleviz")
    driver.resize(1400, 900)
    tabs = window.tabifiedDockWidgets
    driver.wait(lambda: all(seen(panels[name]) > 80 for name in ("layers", "shear", "playback")))
    assert tabs(panels["shear"]) == [panels["kappa"]]
    assert panels["layers"].y() < panels["shear"].y()
    assert tabs(panels["plots"]) == [panels["images"]]
    assert panels["images"].y() < panels["playback"].y() and not tabs(panels["playback"])
    assert seen(window.view) > 300
    # also those of a session that was saved in a small window
    driver.drop(tmp_path / "small.bubbleviz")
    driver.wait(lambda: panels["layers"] in tabs(panels["shear"]))
    driver.resize(1400, 900)
    driver.wait(lambda: panels["layers"] not in tabs(panels["shear"]))
    driver.wait(lambda: all(seen(panels[name]) > 80 for name in ("layers", "shear", "playback")))
    # tabs that the operator made stay
    window.tabifyDockWidget(panels["layers"], panels["shear"])
    driver.resize(1390, 890)
    assert panels["shear"] in tabs(panels["layers"])


@pytest.mark.parametrize("dragged", [0, 40])
def test_panels_have_their_sizes_again_after_a_wide_one(drive, dragged):
    """Also those that the operator dragged."""
    driver = drive(DentSource, frame=6)
    window, panels = driver.window, driver.window.panels
    layers, wide = panels["layers"], panels["calibration"]
    driver.resize_to_smallest()
    expected = layers.size().grownBy(QMargins(dragged, 0, 0, 0))
    line = QPoint(layers.x() - 2, 150)
    driver.bot.mousePress(window, LEFT, pos=line)
    driver.bot.mouseMove(window, line - QPoint(dragged, 0))
    driver.wait(lambda: layers.size() == expected)
    driver.bot.mouseRelease(window, LEFT, pos=line - QPoint(dragged, 0))
    for _ in range(2):
        window.use_scene(load_scene("calibrate"))
        driver.wait(lambda: wide.width() > expected.width() + 20)
        window.use_scene(load_scene("press"))
        driver.wait(lambda: layers.size() == expected)


def right_end(driver, text):
    """Right end of a text of the 3-D view, pixels."""
    box, renderer = [0.0] * 4, driver.window.view.renderer
    text.GetBoundingBox(renderer, box)
    return text.GetPositionCoordinate().GetComputedViewportValue(renderer)[0] + box[1]


def text_bottom(driver, text):
    """Distance of the lower end of a text of the 3-D view from the top, pixels."""
    box, renderer = [0.0] * 4, driver.window.view.renderer
    text.GetBoundingBox(renderer, box)
    position = text.GetPositionCoordinate().GetComputedViewportValue(renderer)
    return driver.window.view.height() - position[1] - box[2]


CONTROLS = (QAbstractButton, QAbstractSlider, QAbstractSpinBox, QComboBox)


def said(window):
    """Every label, button, menu item and tooltip of a window."""
    shown = [*window.findChildren(QLabel), *window.findChildren(QAbstractButton)]
    texts = {each.text() for each in [*shown, *window.findChildren(QAction)]}
    return texts | {widget.toolTip() for widget in window.findChildren(QWidget)}


class LayoutRequests(QObject):
    """Counts how often a widget is asked to lay its children out."""

    count = 0

    def eventFilter(self, _, event):
        self.count += event.type() == QEvent.Type.LayoutRequest
        return False


def test_a_low_panel_that_floats_is_opened_again_as_it_was(drive):
    driver = drive()
    driver.resize(1300, 800)
    panels = driver.window.panels
    driver.show("images")
    panels["images"].setFloating(True)
    panels["images"].close()
    panels["images"].resize(500, 100)
    driver.show("images")
    low = panels["images"].height()
    assert low < panels["images"].sizeHint().height() / 2
    driver.show("plots")  # the others are placed again
    driver.wait_until_shown()
    assert panels["images"].isFloating() and panels["images"].height() == low
    assert not driver.window.tabifiedDockWidgets(panels["playback"])
