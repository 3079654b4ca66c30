"""Undo and redo of the window's settings, by keyboard."""

import gc
import math
import shutil
from dataclasses import fields

import pytest
from PySide6.QtCore import QPoint, Qt
from PySide6.QtGui import QKeySequence, QUndoStack
from PySide6.QtWidgets import QAbstractButton, QStyle, QStyleOptionSlider
from window_driver import no_pending_timers

from bubbleviz.files import presets_folder
from bubbleviz.inverse import EstimatorOptions
from bubbleviz_ui.model import undo as undo_module
from bubbleviz_ui.model.scene_presets import load_scene
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.settings import ComparedSetting, Settings
from bubbleviz_ui.model.undo import LAYOUT, UndoRecorder, UndoStep
from bubbleviz_ui.model.units import UNIT_CHOICES
from bubbleviz_ui.shell.theme import NEUTRAL

CHANGES = {
    "layers": frozenset({"rim"}),
    "kappa": 3.0,
    "solver": "fast",
    "speed": 2.0,
    "every_frame": True,
    "loop": False,
    "plots": frozenset({"area"}),
    "cloud_colour": "patch",
    "cloud_points": 5000,
    "membrane_opacity": 0.4,
    "pressure_max_pa": 3000.0,
    "residual_max_m": 2e-3,
    "theme": "light",
    "least_area_m2": 2e-5,
    "images": frozenset({"depth"}),
    "view_from": (0.0, -1.0, 1.0),
    "zoom": 2.0,
    "colour_map": "viridis",
    "exaggeration": 3.0,
    "section_axis": "x",
    "section_at_m": 0.01,
    "section_flipped": True,
    "pose_object": "cylinder",
    "pose_unit": "mm",
    "pose_start": (0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 1.0),
    "pose_track": True,
    "pose_stage": 1,
    "compared": (ComparedSetting(nodes=300), ComparedSetting(solver="osqp")),
    "picture_size": (800, 600),
    "pre_roll_s": 5.0,
    "record_folder": "/somewhere",
    "publish_at": "tcp/127.0.0.1:7450",
    "length_unit": "m",
    "pressure_unit": "psi",
    "force_unit": "mN",
    "duration_unit": "s",
}


def test_undo_and_redo_of_every_setting_by_its_control(drive):
    assert CHANGES.keys() | LAYOUT == {field.name for field in fields(Settings)}
    driver = drive(frame=3)
    seen = [driver.state.settings]
    for name, value in CHANGES.items():
        driver.state.change(**{name: value})
        seen.append(driver.state.settings)
    assert driver.window.undo_stack.index() == len(CHANGES)
    for before in reversed(seen[:-1]):
        driver.undo()
        assert driver.state.settings == before
    for after in seen[1:]:
        driver.redo()
        assert driver.state.settings == after
    driver.state.change(theme="system")
    driver.choose(**{name: getattr(Settings(), name) for name in CHANGES})
    driver.window.undo_stack.clear()
    # clicks, drags and typed numbers are steps
    layers = driver.window.layers
    for name in ("wireframe", "rim"):
        driver.click(layers.boxes[name])
    assert layers.boxes["wireframe"].isChecked() and not layers.boxes["rim"].isChecked()
    driver.undo()
    assert layers.boxes["rim"].isChecked() and layers.boxes["wireframe"].isChecked()
    driver.undo()
    assert not layers.boxes["wireframe"].isChecked()
    assert driver.state.settings.layers == Settings().layers

    slider = driver.window.layers.opacity
    option = QStyleOptionSlider()
    slider.initStyleOption(option)
    control, part = QStyle.ComplexControl.CC_Slider, QStyle.SubControl.SC_SliderHandle
    place = slider.style().subControlRect(control, option, part, slider).center()
    driver.drag(slider, *(place - QPoint(8 * step, 0) for step in range(8)))
    assert driver.state.settings.membrane_opacity < 0.8
    assert driver.window.undo_stack.index() == 1
    driver.undo()
    assert driver.state.settings.membrane_opacity == 1.0 and slider.value() == 100

    box = driver.window.kappa.box  # undo keys work while a number box has the focus
    driver.window.kappa.automatic.setChecked(False)
    driver.type(box, "2.5")
    assert driver.state.settings.kappa == 2.5
    driver.undo(box)
    assert driver.state.settings.kappa != 2.5
    # also controls of the calibration, shortcuts, a range and markers
    driver.window.undo_stack.clear()
    window, frames = driver.window, driver.window.calibration.frames.collect
    picture, stack = window.calibration.pixels.picture, window.undo_stack
    before = (picture.currentText(), frames.count.value(), frames.contact_free.isChecked())
    picture.setCurrentIndex(1)
    for count in (101, 150):  # typed, one digit after the other
        frames.count.setValue(count)
    frames.contact_free.click()
    after = (picture.currentText(), 150, not before[2])
    assert stack.count() == 3
    for _ in range(3):
        stack.undo()
    assert (picture.currentText(), frames.count.value(), frames.contact_free.isChecked()) == before
    for _ in range(3):
        stack.redo()
    assert (picture.currentText(), frames.count.value(), frames.contact_free.isChecked()) == after
    driver.seek(3)
    shortcuts = driver.window.shortcuts
    shortcuts.set_keys("View › Reset view", QKeySequence("Ctrl+J"))
    shortcuts.reset_all()
    driver.undo()
    assert shortcuts.keys("View › Reset view") == "Ctrl+J"
    driver.undo()
    assert shortcuts.keys("View › Reset view") == "R"
    driver.redo()
    assert shortcuts.keys("View › Reset view") == "Ctrl+J"

    driver.state.toggle_marker(3)
    driver.undo()
    assert driver.state.markers == ()
    driver.redo()
    assert driver.state.markers == (3,)


def opened(driver):
    """Open docks, by their checked entries in the View menu."""
    menu = driver.menu("View")
    menu.aboutToShow.emit()
    shown = {a.text() for a in menu.actions() if a.isCheckable() and a.isChecked()}
    return shown - {"&Clear probe"}  # checked without a tool


def test_undo_of_panels_scenes_objects_and_compared_settings(drive, tmp_path, monkeypatch):
    driver = drive(frame=3)
    window = driver.window
    names = ["Layers", "Contact patch", "Threshold", "Compare", "3-D tools", "Pose", "Calibration",
             "Plots", "Images", "Playback", "Status bar"]  # fmt: skip
    by_default = opened(driver)
    assert by_default == {"Layers", "Contact patch", "Playback", "Status bar"}
    seen = [by_default]
    for name in names:
        window.shortcuts.actions[f"View › {name}"].trigger()
        seen.append(opened(driver))
        assert seen[-1] ^ seen[-2] == {name}
    assert window.undo_stack.index() == len(names)
    assert "status" not in driver.state.settings.panels
    for before in reversed(seen[:-1]):
        driver.undo()
        assert opened(driver) == before
    assert "status" in driver.state.settings.panels and window.status.isVisible()
    for after in seen[1:]:
        driver.redo()
        assert opened(driver) == after
    assert window.undo_stack.index() == len(names)
    # a scene and closing a dock are steps; raising a tab is not
    for _ in names:
        driver.undo()
    stack = window.undo_stack
    stack.clear()
    window.use_scene(load_scene("residual"))
    assert driver.state.settings.layers != Settings().layers and stack.index() == 1
    assert window.panels["threshold"].isHidden() and window.panels["layers"].isVisible()
    for _ in range(2):  # the second time nothing changes: no step
        window.use_scene(load_scene("review"))
        assert window.panels["plots"].isVisible() and stack.index() == 2
    driver.undo()
    assert window.panels["plots"].isHidden()
    driver.undo()
    assert driver.state.settings.layers == Settings().layers
    assert driver.state.settings.view_from == Settings().view_from

    driver.trigger("View › Threshold")
    window.panels["kappa"].raise_()
    driver.wait(lambda: "threshold" not in driver.state.settings.panels)
    assert stack.index() == 1 and stack.undoText() == "open panels"
    driver.click(window.panels["layers"].findChild(QAbstractButton, "qt_dockwidget_closebutton"))
    assert window.panels["layers"].isHidden() and stack.index() == 2
    driver.undo()
    assert window.panels["layers"].isVisible()
    window.hide()
    window.show()
    assert stack.index() == 1 and stack.canRedo()
    # a dropped object is a step
    driver.seek(6)
    stack.clear()
    driver.window.use_scene(load_scene("calibrate"))
    driver.wait_until_shown()
    for name in ("cylinder", "frustum"):
        shutil.copy(presets_folder("objects") / f"{name}.ply", tmp_path)
        driver.window.files.open(tmp_path / f"{name}.ply")
        driver.wait(lambda name=name: driver.window.pose.session.obj is not None
                    and driver.window.pose.session.obj.name == name)  # fmt: skip
    assert stack.index() == 3
    driver.wait_until_shown()
    drawn = driver.window.scene.object  # drawn as not found yet
    assert drawn.actor.GetVisibility() and drawn.actor.prop.color.hex_rgb == NEUTRAL
    driver.undo()
    driver.wait(lambda: driver.window.pose.session.obj.name == "cylinder")
    driver.wait(lambda: driver.window.pose.object.currentText() == "cylinder.ply")
    driver.undo()
    driver.wait(lambda: driver.window.pose.session.obj is None)
    assert driver.window.panels["pose"].isHidden()
    driver.redo()
    driver.wait(lambda: driver.window.pose.session.obj is not None)
    # compared settings are undone in their boxes
    driver.show("compare")
    panel = driver.window.compare
    driver.type(panel.b.controls["nodes"], "300")
    driver.wait(lambda: panel.b.setting.options.nodes == 300)
    driver.undo(panel.b.controls["nodes"])
    assert panel.b.controls["nodes"].value() == 0 and panel.b.setting.options.nodes is None
    assert panel.b.setting.options == EstimatorOptions("linear")
    assert panel.a.setting.options == EstimatorOptions()  # the defaults are the estimator's

    # a pressed arrow is one step, however slow the machine
    monkeypatch.setattr(undo_module, "GESTURE_S", math.inf)
    column = panel.b
    before = stack.index()
    for box in (column.controls["nodes"], column.controls["pressure_scale"]):
        box.setFocus()
        for _ in range(4):
            driver.bot.keyClick(box, Qt.Key.Key_Up)
    assert column.controls["nodes"].value() == 400 and stack.index() == before + 2
    driver.undo(column.controls["nodes"])
    assert column.controls["nodes"].value() == 400
    assert column.setting.options.pressure_scale == EstimatorOptions().pressure_scale
    driver.undo(column.controls["nodes"])
    assert column.controls["nodes"].value() == 0


@pytest.mark.long
def test_controls_follow_undo(drive):
    driver = drive(frame=3)
    window, state = driver.window, driver.state
    window.panels["tools"].show()

    def shown():
        playback, layers, tools, kappa = window.playback, window.layers, window.tools, window.kappa
        return [
            kappa.solver.currentText(), kappa.automatic.isChecked(), kappa.box.value(),
            playback.speed.currentText(), playback.mode.currentText(),
            playback.buttons["Loop"].isChecked(),
            layers.cloud_colour.currentText(), layers.cloud_points.currentText(),
            layers.opacity.value(), layers.pressure_max.value(), layers.residual_max.value(),
            [box.isChecked() for box in layers.boxes.values()], tools.colour_map.currentText(),
            tools.exaggeration.value(), tools.section.currentText(), tools.section_at.value(),
            tools.flipped.isChecked(), tools.width_box.value(), tools.height_box.value(),
            window.pose.object.currentText(), window.pose.unit.currentText(),
            window.pose.search.isChecked(), window.pose.track.isChecked(),
            window.pose.stage.currentText(), window.threshold.least.value(),
            window.compare.a.controls["nodes"].value(),
            window.compare.b.controls["solver"].currentText(),
            [action.isChecked() for action in window.plots.boxes.values()],
            [action.isChecked() for action in window.images.boxes.values()],
        ]  # fmt: skip

    def settled():
        """Wait until solver, object and pose panel are up to date."""
        driver.wait(lambda: not window.pose.session.busy and no_pending_timers(window.pose))
        driver.wait(lambda: window.controller.cold_solved and no_pending_timers(window.pose))
        return shown()

    elsewhere = {"panels", "pre_roll_s", "record_folder", "publish_at", "view_from", "zoom",
                 "theme"} | UNIT_CHOICES.keys()  # fmt: skip
    before = settled()
    for name in sorted(CHANGES.keys() - elsewhere):
        state.change(**{name: CHANGES[name]})
        changed = settled()
        assert sum(a != b for a, b in zip(before, changed, strict=True)) >= 1, name
        driver.undo()
        assert settled() == before, name


def test_the_changes_of_a_gesture_are_one_step_and_one_object(qapp):
    recorder, applied = UndoRecorder(SessionState(), QUndoStack()), []
    for k in range(100):
        recorder.push("drag", applied.append, k, k + 1, "a gesture")
    assert recorder.stack.count() == 1 and applied == [*range(1, 101)]
    assert sum(isinstance(each, UndoStep) for each in gc.get_objects()) == 1
    recorder.stack.undo()
    recorder.stack.redo()
    assert applied[-2:] == [0, 100]
    recorder.push("drag", applied.append, 100, 101, "another")
    assert recorder.stack.count() == 2
