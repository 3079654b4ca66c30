"""Pose panel by clicks, keys and drags."""

import csv
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PySide6.QtCore import QPoint, Qt
from PySide6.QtWidgets import QApplication
from scipy.spatial.transform import Rotation
from window_driver import CTRL, LEFT, SHIFT, Driver, axes_corner, no_pending_timers, view_texts

from bubbleviz.files import presets_folder
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor import load_sensor
from bubbleviz.simulation import DepthNoise, SyntheticSource
from bubbleviz_ui.model.scene_presets import load_scene
from bubbleviz_ui.model.settings import Settings
from bubbleviz_ui.model.units import DASH
from bubbleviz_ui.pose import pose_panel
from bubbleviz_ui.pose.pose_panel import Curves
from bubbleviz_ui.shell.theme import AMBER, GAP, GREEN, LINE, NEUTRAL, OBJECT_PATCH
from bubbleviz_ui.view3d.colours import rgb
from bubbleviz_ui.view3d.object_layers import FitLayer
from tests.small_press import HeldPress, changed, coarser

TRUE = np.array([0.004, 0.002, 0.037])
FRAMES = 5
FLAT = "found; 3 of 6 directions not determined"
"""Undetermined directions of a flat face: translations and a rotation."""


@pytest.fixture(scope="module")
def source():
    """A press on the preset's dome, with half the camera resolution."""
    T = np.eye(4)
    T[:3, 3] = TRUE
    preset = load_sensor("pico_flexx_75mm")
    sensor = changed(preset, camera=coarser(preset, 2), membrane={"nodes": 400})
    poses = np.repeat(T[None], FRAMES, axis=0)
    noise = DepthNoise(relative=0.005)
    return HeldPress(sensor, load_object("frustum"), poses, noise, nodes=3_000)


class Bench(Driver):
    """The window with its pose panel open, driven by clicks and keys."""

    def __init__(self, driver):
        super().__init__(driver.bot, driver.window)
        self.window.use_scene(load_scene("pose"))
        self.wait_until_shown()

    @property
    def panel(self):
        return self.window.pose

    def choose_object(self, name):
        box = self.panel.object
        self.pick(box, box.itemText(box.findData(name)))
        box.activated.emit(box.currentIndex())
        obj = lambda: self.panel.session.obj  # noqa: E731
        self.wait(
            lambda: obj() is not None and obj().name == name
        )  # the arrow keys select others first

    def fit(self):
        self.click(self.panel.once)
        self.wait(lambda: not self.panel.session.busy)
        self.wait(lambda: self.text("state") != "fitting…")
        self.wait_until_shown()

    def text(self, name):
        return self.panel.values[name].text()

    def drawn(self):
        """Colour the object is drawn in."""
        layer = self.window.scene.object
        assert layer.T_B_O is not None
        return str(layer.actor.prop.color.hex_rgb)

    def green(self):
        """Pixels in the colour of a found object."""
        pixels = self.pixels()
        red, green, blue = (pixels[..., k].astype(int) for k in range(3))
        found = (green > red + 40) & (green > blue + 20) & ~axes_corner(pixels)
        return int(np.count_nonzero(found))


@pytest.fixture
def bench(drive, source):
    made = Bench(drive(lambda _: source, sensor=source.sensor))
    yield made
    made.release()


def test_fit_once_from_the_initial_pose_shows_object_and_quality_and_copies_the_pose(bench):
    assert bench.green() == 0
    assert not bench.panel.once.isEnabled()
    bench.choose_object("frustum")
    bench.click(bench.panel.once)
    assert bench.panel.session.busy
    for widget in (bench.panel.object, bench.panel.once, bench.panel.track, bench.panel.start):
        assert not widget.isEnabled()
    bench.wait(lambda: bench.text("state") == FLAT)
    bench.wait_until_shown()
    assert bench.panel.once.isEnabled()
    assert bench.green() == 0 and bench.drawn() == AMBER
    pose = bench.panel.session.pose
    assert abs(pose.T_B_O[2, 3] - TRUE[2]) < 1e-3
    assert "mm" in bench.text("fit") and "%" in bench.text("first")
    assert bench.text("open") == "translation along 2 directions and rotation about 1 axis"
    fit = bench.window.scene.layers["fit"]
    assert isinstance(fit, FitLayer) and fit.points.visibility and fit.arrows.actor.visibility
    assert pose.stage_one is not None
    box = bench.panel.stage
    box.setFocus()
    bench.bot.keyClick(box, Qt.Key.Key_Down)
    box.activated.emit(box.currentIndex())
    bench.wait_until_shown()
    assert np.array_equal(bench.window.scene.object.T_B_O, pose.stage_one.T_B_O)
    # shown in the chosen units, selectable and copied
    bench.undo()
    panel = bench.panel
    T = pose.T_B_O
    bench.wait(lambda: bench.text("place") != "–")
    assert bench.text("place") == ", ".join(f"{1e3 * each:.2f} mm" for each in T[:3, 3])
    turns = [float(each.removesuffix("°")) for each in bench.text("turn").split(", ")]
    assert np.allclose(Rotation.from_euler("xyz", turns, degrees=True).as_matrix(), T[:3, :3],
                       atol=3e-3)  # fmt: skip
    label = panel.values["place"]
    bench.bot.mouseDClick(label, LEFT, pos=QPoint(6, label.height() // 2))
    assert label.hasSelectedText()
    bench.click(panel.copy)
    head, place, turn, _, *rows = QApplication.clipboard().text().splitlines()
    assert head == "T_B_O, object to bubble frame: " + FLAT
    assert place.startswith("position x y z, m: ")
    assert np.allclose(np.array(place.split()[-3:], float), T[:3, 3], atol=1e-9)
    xyzw = np.array(turn.removeprefix("quaternion x y z w, no unit: ").split(), float)
    assert np.allclose(Rotation.from_quat(xyzw).as_matrix(), T[:3, :3], atol=1e-7)
    assert np.allclose(np.array([row.split() for row in rows], float), T, atol=1e-9)
    bench.state.change(length_unit="m")
    bench.wait(lambda: bench.text("place").endswith(" m"))
    bench.key(Qt.Key.Key_F, CTRL | SHIFT)
    bench.wait(lambda: bench.text("place") == "–")
    assert not panel.copy.isEnabled()
    # the fitted patch is the one shown, without small parts
    bench.state.change(least_area_m2=0.01)
    bench.fit()
    assert bench.result.patch.area_m2 == 0.0
    assert panel.session.pose is None or panel.session.pose.stage_two is None
    # the initial pose is typed, and reset discards poses
    bench.state.change(least_area_m2=Settings().least_area_m2, length_unit="mm")
    bench.key(Qt.Key.Key_F, CTRL | SHIFT)
    bench.wait(lambda: bench.text("state") == "not fitted")
    for box, value in zip(panel.start.places, (5.0, 1.0, 38.0), strict=True):
        bench.type(box, f"{value:g}")
    assert not panel.search.isChecked()
    assert np.allclose(panel.session.start[:3, 3], [5e-3, 1e-3, 38e-3], atol=1e-5)
    bench.wait_until_shown()
    assert bench.green() > 1_000 and bench.drawn() == GREEN  # drawn at the initial pose
    assert np.allclose(bench.window.scene.object.T_B_O, panel.session.start)
    bench.fit()
    assert bench.text("state") == FLAT
    place = bench.window.scene.object.T_B_O
    assert place is not None and np.linalg.norm(place[:3, 3] - TRUE) < 3e-3
    bench.key(Qt.Key.Key_F, CTRL | SHIFT)
    assert panel.session.pose is None
    controller = bench.window.controller
    with bench.bot.waitSignal(controller.shown):
        controller.client.request_cold_solve()  # of the shown frame, with its pose
    bench.wait(lambda: bench.text("state") == "not fitted")


def lose(monkeypatch, lost):
    """Insert a frame without depth."""
    seen = SyntheticSource.__getitem__

    def blinded(source, index):
        frame = seen(source, index)
        blank = np.full_like(frame.depth_m, np.nan)
        return replace(frame, depth_m=blank) if index == lost else frame

    monkeypatch.setattr(SyntheticSource, "__getitem__", blinded)


def test_an_object_that_the_contact_contradicts_is_doubtful(bench):
    bench.choose_object("hex_nut")
    bench.fit()
    assert bench.text("state").startswith("doubtful")


def test_other_poses_that_fit_as_well_are_told_and_fitted_in_turn(drive, source, tmp_path):
    mesh, T = tmp_path / "box.stl", np.eye(4)
    trimesh.creation.box((0.024, 0.018, 0.030)).export(mesh)  # faces alike in a light touch
    T[2, 3] = 0.062
    press = HeldPress(
        source.sensor, load_object(str(mesh)), np.stack([T, T]), DepthNoise(), nodes=3_000
    )
    bench = Bench(drive(lambda _: press, sensor=source.sensor))
    panel = bench.panel
    panel.use_file(mesh)
    bench.wait(panel.once.isEnabled)
    assert not panel.other.isVisible()
    bench.fit()
    first, others = panel.session.pose.T_B_O, [*panel.session.others]
    count = len(others)
    assert panel.other.isVisible() and count >= 2
    for expected in (*others, first):  # in the end the first one comes again
        bench.click(panel.other)
        np.testing.assert_allclose(panel.session.start, expected, atol=1e-6)
        bench.wait(lambda: bench.text("state") != "fitting…")
        bench.wait_until_shown()
        assert bench.text("state").startswith(("found", "doubtful"))
    assert panel.other.text().startswith(f"{count} ")
    bench.seek(1)
    bench.wait(lambda: not panel.other.isVisible())  # they are of the frame before
    bench.release()


def test_tracking_export_undo_of_reset_and_curves(bench, source, tmp_path, monkeypatch):
    bench.choose_object("frustum")
    counts = bench.pipeline.counts
    bench.seek(1)
    assert counts["pose"] == 0
    bench.click(bench.panel.track)
    session = bench.panel.session
    bench.wait(lambda: session.pose is not None)
    for frame in range(2, FRAMES):
        bench.seek(frame)
    bench.wait(lambda: len(session.rows) == FRAMES - 1)
    assert counts["pose"] >= FRAMES - 1
    bench.wait(lambda: bench.panel.csv.isEnabled())
    for button, name in ((bench.panel.csv, "p.csv"), (bench.panel.tum, "p.tum")):
        out = str(tmp_path / name)
        monkeypatch.setattr(pose_panel, "new_file", lambda *_, out=out, **__: (Path(out), ""))
        bench.click(button)
    with (tmp_path / "p.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["frame"]) for row in rows] == list(range(1, FRAMES))
    assert np.loadtxt(tmp_path / "p.tum").shape == (FRAMES - 1, 8)
    bench.click(bench.panel.csv)  # uses the path of the last dialog
    assert "exists already" in bench.window.message.label.text()
    # undo restores the poses
    stack, rows = bench.window.undo_stack, dict(session.rows)
    steps, place = stack.index(), bench.window.scene.object.T_B_O
    bench.key(Qt.Key.Key_X)  # next to Z: not a shortcut
    assert stack.index() == steps and session.rows == rows
    bench.key(Qt.Key.Key_F, CTRL | SHIFT)
    bench.wait_until_shown()
    assert not session.rows and not bench.panel.track.isChecked()
    assert bench.drawn() == NEUTRAL and stack.index() == steps + 1  # above the membrane
    bench.key(Qt.Key.Key_Z, CTRL)
    assert session.rows == rows and bench.panel.track.isChecked()
    assert np.array_equal(bench.window.scene.object.T_B_O, place)
    bench.seek(0)  # tracking continues
    bench.wait(lambda: 0 in session.rows)
    assert session.rows[0]["status"] == "ok"
    bench.key(Qt.Key.Key_Z, CTRL | SHIFT)
    bench.wait(lambda: bench.text("state") == "not fitted")
    assert not session.rows and not bench.panel.track.isChecked()
    bench.click(bench.panel.track)  # on the same frame
    bench.wait(lambda: session.pose is not None)
    # closing the panel stops tracking
    ran = counts["pose"]
    bench.window.panels["pose"].hide()
    bench.state.change(layers=frozenset({"membrane"}))
    bench.seek(1)
    assert counts["pose"] == ran
    # curves break at lost and skipped frames
    bench.show("pose")
    bench.key(Qt.Key.Key_F, CTRL | SHIFT)
    lose(monkeypatch, 1)
    bench.show_source(lambda _: source)
    bench.click(bench.panel.track)
    bench.wait(lambda: 0 in session.rows)
    for frame in (1, 2, 4):
        bench.seek(frame)
        bench.wait(lambda frame=frame: frame in session.rows)
        assert bench.drawn() == (GAP if frame == 1 else AMBER)
        bench.wait(lambda: no_pending_timers(bench.panel))
        curves = bench.panel.findChild(Curves)
        for curve in (*curves.frames, *curves.iterations):  # lost pose: no value, no curve
            assert curve.text.endswith((", %</span>", ", mm</span>")) == (frame == 1)
        for curve in curves.iterations:
            drawn = curve.curve.getOriginalDataset()[1]
            assert (drawn is None or len(drawn) == 0) == (frame == 1)
    assert [row["status"] for row in session.rows.values()] == ["ok", "lost", "ok", "ok"]
    for curve in curves.frames:
        drawn = curve.curve.getOriginalDataset()[1]
        assert np.isfinite(drawn).tolist() == [True, False, True, False, True]
        assert curve.curve.opts["connect"] == "finite" and curve.curve.opts["symbol"] == "o"


def test_without_the_panel_an_object_is_drawn_only_where_it_was_found(drive, source):
    press, away = np.eye(4), np.eye(4)
    press[:3, 3], away[:3, 3] = TRUE, TRUE + np.array([0.0, 0.0, 0.1])
    poses, noise = np.stack([press, press, away]), DepthNoise(relative=0.005)
    frames = HeldPress(source.sensor, load_object("frustum"), poses, noise, nodes=3_000)
    bench = Bench(drive(lambda _: frames, sensor=source.sensor))
    bench.choose_object("frustum")
    bench.click(bench.panel.track)
    bench.wait(lambda: bench.text("state") == FLAT)
    bench.seek(2)
    bench.wait(lambda: bench.text("state") == "no contact; the last good pose is kept")
    assert bench.drawn() == NEUTRAL
    bench.window.use_scene(load_scene("press"))
    bench.wait_until_shown()
    drawn = bench.window.scene.object.actor
    assert not drawn.GetVisibility()
    bench.seek(0)
    assert drawn.GetVisibility() and bench.drawn() == AMBER
    bench.state.change(pose_track=False)
    bench.seek(1)
    assert not drawn.GetVisibility()  # found in another frame
    bench.show("pose")
    bench.wait(lambda: bench.text("state") == f"{FLAT}; of frame 0")
    assert drawn.GetVisibility()
    bench.window.panels["pose"].hide()
    bench.seek(0)
    assert drawn.GetVisibility()
    bench.key(Qt.Key.Key_F, CTRL | SHIFT)
    bench.wait_until_shown()
    assert not drawn.GetVisibility()


def test_patch_by_the_object_is_shown_with_the_patch_and_follows_the_pose(bench):
    """Both outlines in their colours and both areas as text; not computed before."""
    driver, window = bench, bench.window
    driver.state.change(layers=frozenset({"membrane", "contour", "readout"}))
    bench.choose_object("frustum")
    bench.click(bench.panel.track)
    driver.seek(1)
    driver.wait_until_shown()
    assert outlined(driver) == (True, False) and not driver.pipeline.counts["object_patch"]
    assert not window.kappa.by_object.text() and "by object" not in " ".join(view_texts(driver))

    bench.click(bench.panel.patch)
    driver.wait(lambda: window.controller.result.object_patch is not None)
    driver.wait_until_shown()
    result = window.controller.result
    assert result.patch is not None and outlined(driver) == (True, True)
    assert result.object_patch.area_m2 != result.patch.area_m2
    words = " ".join(view_texts(driver))
    assert f"patch (white) {1e6 * result.patch.area_m2:.0f} (" in words
    assert f"by object (green) {1e6 * result.object_patch.area_m2:.0f} mm²" in words
    area = f"{1e6 * result.object_patch.area_m2:.0f} mm²"
    assert window.kappa.by_object.text() == area
    driver.wait(lambda: bench.panel.patch.text() == f"Patch by object: {area}")

    driver.pipeline.tracker.reset(np.diag([1.0, -1.0, -1.0, 1.0]))  # far off: the fit fails
    driver.seek(2)
    lost = window.controller.result
    assert lost.frame.index == 2 and lost.pose.status == "lost"
    assert lost.object_patch is None and outlined(driver) == (True, False)
    assert not window.kappa.by_object.text() and "by object" not in " ".join(view_texts(driver))
    driver.wait(lambda: bench.panel.patch.text() == "Patch by object")


def outlined(driver):
    """Whether the outlines of the patch and of the patch by the object are visible."""
    pixels = driver.pixels()[:, 60:]
    white, green = (np.all(pixels == rgb(colour), axis=2).sum() for colour in (LINE, OBJECT_PATCH))
    return bool(white > 40), bool(green > 40)


def test_object_is_dropped_rejected_or_removed_with_its_fit_and_curves_fit_a_small_screen(
    bench, tmp_path
):
    flat = tmp_path / "flat.obj"
    flat.write_text("v 0 0 0\nv 0.01 0 0\nv 0.02 0 0\nf 1 2 3\n")
    path = tmp_path / "mine.ply"
    shutil.copy(presets_folder("objects") / "cylinder.ply", path)
    bench.drop(path)
    bench.wait(lambda: bench.panel.session.obj is not None)
    assert bench.panel.session.obj.name == "mine"
    bench.drop(flat)
    bench.wait(lambda: "no area" in bench.window.message.label.text())
    bench.wait(lambda: bench.panel.session.obj is None)
    assert not bench.panel.once.isEnabled()
    fit = bench.window.scene.layers["fit"]
    panel, session = bench.panel, bench.panel.session
    bench.state.include("layers", "object_patch", True)

    def track():
        bench.choose_object("frustum")
        bench.click(panel.track)
        bench.wait(lambda: bench.result.object_patch is not None and session.pose is not None)
        bench.wait_until_shown()
        assert fit.points.visibility and fit.arrows.actor.visibility and panel.track.isChecked()
        assert outlined(bench)[1]

    def wait_for_nothing():
        bench.wait(lambda: session.obj is None and bench.text("place") == DASH)
        bench.wait_until_shown()
        assert not any(actor.GetVisibility() for actor in fit.actors)
        assert session.pose is None and not session.rows and not outlined(bench)[1]
        assert not panel.track.isChecked() and not bench.state.settings.pose_track

    track()
    bench.drop(flat)
    wait_for_nothing()
    bench.wait(lambda: "flat: its triangles have no area" in bench.text("state"))
    bench.wait_for_message("flat: its triangles have no area")
    track()
    assert not bench.window.message.isVisible()  # of the object before
    bench.pick(panel.object, "none")
    panel.object.activated.emit(panel.object.currentIndex())
    wait_for_nothing()
    bench.wait(lambda: bench.text("state") == "choose an object")
    bench.seek(1)
    assert not fit.points.visibility and bench.result.pose is None
    # undo restores object and tracking
    bench.undo()
    bench.wait(lambda: session.obj is not None and panel.track.isChecked())
    # curves fit a small screen, and RMSE is in the unit of length
    bench.choose_object("two_spheres")  # the frustum is pressed
    bench.fit()
    assert bench.text("state").startswith("no pose tried so far fits; ")  # and none before
    assert bench.text("place") == DASH
    # the reason in numbers; a found object has at least 70 % of the patch on it
    reason = re.fullmatch(
        r"best: fitness (\d+) % · rmse \d\.\d\d mm · \d+ points?", bench.text("fit")
    )
    assert reason is not None and int(reason[1]) < 70
    bench.choose_object("frustum")
    bench.fit()
    assert bench.text("state").startswith("found")
    bench.wait(lambda: any(curves.isVisible() for curves in bench.panel.findChildren(Curves)))
    window, curves = bench.window, bench.panel.findChild(Curves)
    window.resize(1024, 700)
    bench.wait_until_shown()
    assert (window.width(), window.height()) == (1024, 700)
    pose = bench.panel.session.pose
    assert pose is not None and pose.stage_two is not None
    for unit, factor in (("mm", 1e3), ("m", 1.0)):
        bench.state.change(length_unit=unit)
        bench.wait(lambda unit=unit: f" {unit}</span>" in curves.iterations[1].text)
        bench.wait(lambda: "rmse, " not in curves.iterations[1].text)
        fitness, rmse = (curve.curve.getOriginalDataset()[1] for curve in curves.iterations)
        assert fitness[-1] == pytest.approx(100.0 * pose.stage_two.fitness)
        assert rmse[-1] == pytest.approx(factor * pose.stage_two.history[-1, 1])
        for curve, largest in zip(curves.iterations, (100.0, rmse.max()), strict=True):
            low, high = curve.box.viewRange()[1]
            assert low <= 0.0 and low + high == pytest.approx(largest)  # the axis starts at 0
