"""Shear in the window: reference images, numbers, and no computation while hidden."""

from dataclasses import replace

import numpy as np
import pytest
from fakes import FIRST_CONTACT, DentSource, SpeckledSource, record, small_sensor
from PySide6.QtCore import Qt
from window_driver import clipboard_text, text_actors, view_texts

from bubbleviz.diagnostics import ShearNumbers
from bubbleviz.recordings import LAG, NO_COLOUR
from bubbleviz.result import FlowFit, Slip, Traction
from bubbleviz.shear import COLLECTED
from bubbleviz_ui.engine.shear_reference import NEEDS_RUBBER
from bubbleviz_ui.engine.source import Source
from bubbleviz_ui.model.demand import needed_products
from bubbleviz_ui.model.scene_presets import load_scene
from bubbleviz_ui.model.settings import Settings
from bubbleviz_ui.model.units import Unit, Units
from bubbleviz_ui.shear.shear_panel import ShearPlot, shear_report, shear_texts

NOTHING = Settings(layers=frozenset(), panels=frozenset())


@pytest.fixture(scope="module")
def rubber():
    """The small sensor with a prestretch, for the exact membrane."""
    return small_sensor(prestretch=1.2)


def opened(drive, sensor, **changed):
    source = SpeckledSource(sensor, **changed)
    return drive(open_source=lambda _: source, sensor=sensor), source


def shown(driver):
    driver.show("shear")
    driver.wait(lambda: "shear" in driver.state.settings.panels)
    driver.wait(lambda: bool(driver.inspection.reference))


def test_traction_is_requested_only_by_what_shows_it():
    layers = replace(NOTHING, layers=frozenset({"traction"}))
    assert "traction" in needed_products(layers) and "slip" not in needed_products(layers)
    panel = replace(NOTHING, panels=frozenset({"shear"}))
    assert needed_products(panel) == {"traction", "slip"}
    plots = replace(NOTHING, panels=frozenset({"plots"}), plots=frozenset({"slip"}))
    assert needed_products(plots) == {"slip"}
    assert not needed_products(Settings()) & {"flow", "traction", "slip", "texture"}


def test_hidden_panel_and_flow_image_compute_nothing_and_the_scene_opens_it(drive, rubber):
    driver, source = opened(drive, rubber)
    driver.seek(3)
    counts = driver.pipeline.counts
    assert source.decoded == 0
    assert not {"flow", "traction", "slip", "texture"} & set(counts)
    shown(driver)
    assert counts["traction"] > 0 and source.decoded > 0
    driver.window.panels["shear"].hide()
    driver.wait(lambda: "shear" not in driver.state.settings.panels)
    driver.seek(4)
    before = counts["traction"], counts["flow"], counts["slip"], source.decoded
    driver.seek(5)
    assert (counts["traction"], counts["flow"], counts["slip"], source.decoded) == before
    driver.window.use_scene(load_scene("shear"))
    driver.wait(lambda: driver.result.traction is not None)
    assert {"traction", "texture"} <= driver.state.settings.layers
    assert driver.window.shear.isVisible()
    driver.wait(lambda: driver.window.shear.copy.isEnabled())
    driver.click(driver.window.shear.copy)
    assert clipboard_text().startswith("frame 5, 0.167 s\nstatus: ")
    pytest.importorskip("cv2")
    # the same for the image of the flow
    driver.window.use_scene(load_scene("press"))
    source = SpeckledSource(rubber)
    driver.show_source(lambda _: source, rubber)
    driver.state.change(images=frozenset({"flow"}))
    driver.seek(1)
    assert source.decoded == 0 and not {"flow", "diagnose flow"} & set(driver.pipeline.counts)
    driver.show("images")
    driver.wait(lambda: "images" in driver.state.settings.panels)
    driver.wait(lambda: bool(driver.window.images.cells))
    cell = driver.window.images.cells["flow"]
    driver.wait(lambda: "images without contact: 1 of" in cell.text.replace("<br>", " "))
    driver.pass_by(range(2, COLLECTED + 2))
    driver.wait(lambda: cell.image is not None)
    driver.wait_until_shown()
    flow, width = driver.result.flow, rubber.camera.width
    assert cell.image.shape == (rubber.camera.height // 8, width // 8)
    assert np.isfinite(cell.image).sum() == len(flow.pixel) > 20
    row, column = np.divmod(flow.pixel[7], width)
    assert cell.image[row // 8, column // 8] == np.hypot(*flow.moved_px[7])
    assert cell.text.startswith("Optical flow") and cell.text.endswith(" px")
    assert driver.pipeline.counts["traction"] == 0  # not requested
    driver.window.panels["images"].hide()
    driver.wait(lambda: "images" not in driver.state.settings.panels)
    driver.seek(2)
    before = driver.pipeline.counts["flow"], source.decoded
    driver.seek(3)
    assert (driver.pipeline.counts["flow"], source.decoded) == before


def test_contact_free_live_frames_are_the_reference(drive, rubber):
    """An image of another size restarts the collection; later ones are solved by depth alone."""
    pytest.importorskip("cv2")
    odd = COLLECTED + 1
    driver, _ = opened(drive, rubber, halved=frozenset({0, odd}))
    shown(driver)
    panel, controller = driver.window.shear, driver.window.controller
    driver.wait(lambda: f"1 of {COLLECTED}" in panel.reference.text())
    driver.pass_by(range(1, odd))
    driver.wait(lambda: f"{COLLECTED - LAG} images without contact" in panel.reference.text())
    assert panel.reference.text().endswith("; colour camera: no pose")
    driver.seek(odd)
    result = controller.result
    assert result.frame.index == odd and result.estimate.status == "no_contact"
    assert not len(result.flow.pixel) and "40×30 pixels, the contact-free" in result.flow.problem
    driver.seek(odd + 1)
    flow = controller.result.flow
    assert len(flow.pixel) > 20
    assert np.sqrt(np.mean(flow.moved_px**2)) < 0.1  # nothing moved
    driver.wait(lambda: panel.values["force"].text() == "0.00 N")
    assert panel.state.text() == "no contact"
    assert panel.values["direction"].text() == "–"
    driver.click(panel.search_reference)
    driver.wait(lambda: f"1 of {COLLECTED}" in panel.reference.text())


def test_reason_for_shear_from_depth_alone_is_shown_else_arrows_and_intervals(
    drive, rubber, sensor, tmp_path
):
    pytest.importorskip("cv2")
    driver, _ = opened(drive, rubber, info=False)
    shown(driver)
    panel = driver.window.shear
    driver.pass_by(range(COLLECTED + 1))
    said = "Depth alone: colour camera: no intrinsics for colour images"
    driver.wait(lambda: panel.reference.text().startswith(said))
    assert driver.result.flow is None and panel.reference.isVisible()
    record(tmp_path / "dent.mcap", list(DentSource(rubber))[:6])
    driver.open("dent", Source.of_recording(tmp_path / "dent.mcap"), rubber, playing=False)
    driver.wait(lambda: panel.reference.text().startswith("Depth alone: no colour images"))
    driver.seek(4)  # in contact; one reason is shown once
    driver.wait(lambda: panel.state.text().startswith(f"depth alone: {NO_COLOUR}; "))
    assert not panel.reference.isVisible()
    # the texture's reason fits into a narrow view
    window = driver.window
    driver.state.change(layers=frozenset({"membrane", "texture"}))
    driver.resize_to_smallest()
    driver.wait_until_shown()
    (note,) = (text for text in text_actors(driver) if "colour images" in text.GetInput())
    note.GetBoundingBox(window.view.renderer, box := [0.0] * 4)
    assert box[1] - box[0] < window.view.width() < 430
    # without the exact membrane: the advice is shown, also in the image
    driver.state.change(images=frozenset({"flow"}))
    driver.show("images")
    driver.open("speckled", SpeckledSource, sensor, playing=False)
    driver.wait(lambda: panel.reference.text() == NEEDS_RUBBER)
    cell = lambda: driver.window.images.cells["flow"]  # noqa: E731
    driver.wait(lambda: cell().text.replace("<br>", " ") == f"Optical flow {NEEDS_RUBBER}")
    assert cell().image is None
    driver.seek(2)
    assert driver.result.estimate is not None
    assert driver.pipeline.counts["traction"] == 0 and not panel.copy.isEnabled()
    # arrows, and numbers with intervals
    driver.state.change(layers=frozenset({"membrane", "traction"}))
    driver.wait_until_shown()
    layer = driver.window.scene.layers["traction"]
    ways = []
    driver.window.scene.show(dragged(driver))
    for actor in layer.actors:
        points = np.asarray(actor.mapper.GetInput().points)
        assert len(np.unique(points, axis=0)) == 3 * 4 and actor.GetVisibility()
        ways.append(np.linalg.norm(points[1] - points[0]))
    assert ways[0] == pytest.approx(2.0 * ways[1])
    driver.window.scene.show(replace(dragged(driver), traction=None))
    assert not any(actor.GetVisibility() for actor in layer.actors)
    # numbers have intervals and remarks
    words = shear_texts(dragged(driver), Units())
    assert words["normal"] == "3.00 ± 0.20 N" and words["tangential"] == "1.50 ± 0.20 N"
    assert words["direction"] == "0 ± 7 °"
    assert words["state"].endswith("; force direction not verified on real sensors")
    assert words["slip"] == "40 ± 20 %"
    # in one line also in a narrow panel, that is with its unit
    window.show_only(frozenset({"shear"}))
    window.resizeDocks([window.panels["shear"]], [1], Qt.Orientation.Horizontal)
    for name, label in panel.values.items():
        label.setText(words[name])
    driver.wait_for_redraw()
    for name, label in panel.values.items():
        assert label.height() < 2 * label.fontMetrics().height(), name
    alone = shear_texts(dragged(driver, "depth_alone"), Units())
    assert alone["state"].startswith("depth alone: no texture; ") and alone["slip"] == "–"
    assert alone["tangential"] == words["tangential"] and alone["displacement"] == "–"
    text = shear_report(dragged(driver), Units())
    assert "Along normal: 3.00 ± 0.20 N" in text.splitlines()


class PressedSpeckles(SpeckledSource):
    """With contact in the last frame, at a place whose texture is seen."""

    def __init__(self, sensor):
        super().__init__(sensor, centre_m=(-0.01, 0.0))

    def __getitem__(self, index):
        frame = super().__getitem__(index)
        if index < len(self) - 1:
            return frame
        return replace(frame, depth_m=DentSource.__getitem__(self, FIRST_CONTACT + 5).depth_m)


def dragged(driver, status="ok"):
    """The result shown, with three nodes pressed by 1 N and dragged by 0.5 N each."""
    result = driver.result
    mesh = driver.pipeline.mesh
    top = np.argsort(np.linalg.norm(mesh.nodes[:, :2], axis=1))[:3]
    normal, along = np.zeros(mesh.nodes.shape), np.zeros(mesh.nodes.shape)
    normal[top, 2], along[top, 0] = -1.0, 0.5
    estimate = replace(
        result.estimate,
        status="ok",
        nodal_force_n=normal + along,
        friction_n=along,
        wrench_covariance=np.diag([0.01] * 3 + [1e-8] * 3),
        flow=FlowFit(0.1, 1.0, 1e-5) if status == "ok" else None,
    )
    patch = replace(
        result.patch, center_of_pressure_m=mesh.nodes[top[0]], torque_nm=np.array([0, 0, 0.02])
    )
    reason = "" if status == "ok" else "no texture"
    traction = Traction(status, 1e3 * normal, 1e3 * along, 1e-3 * along, reason)
    slip = Slip(np.zeros((9, 3)), np.zeros((9, 3)), np.zeros(9, bool), 0.4, 0.1)
    return replace(result, estimate=estimate, patch=patch, traction=traction, slip=slip)


def test_ellipse_is_drawn_in_the_unit_of_force(qtbot):
    plot = ShearPlot()
    qtbot.addWidget(plot)
    plot.show()
    outline = np.array([[0.1, 0.2], [0.3, 0.2], [0.1, 0.2]])
    plot.draw(ShearNumbers(across_n=np.array([0.2, 0.2]), outline_n=outline), Unit("mN", 1e3, 0))
    np.testing.assert_allclose(np.stack(plot.outline.getData(), axis=1), 1e3 * outline)
    np.testing.assert_allclose(np.stack(plot.force.getData()), [[0, 200], [0, 200]])
    plot.draw(ShearNumbers(), Unit("mN", 1e3, 0))
    assert plot.force.getData()[0] is None or not len(plot.force.getData()[0])


def test_a_frame_has_one_force_whatever_was_shown_before_and_says_if_of_colour(drive, rubber):
    pytest.importorskip("cv2")
    source = PressedSpeckles(rubber)
    driver = drive(open_source=lambda _: source, sensor=rubber, frame=len(source) - 1)
    window, last = driver.window, len(source) - 1
    label, panel = window.status.labels["force"], window.shear

    def force():
        return label.text(), driver.state.history.values["force_n"][last]

    by_depth = force()
    driver.show("shear")
    driver.pass_by(range(COLLECTED + 1))
    driver.seek(last)
    assert panel.state.text().startswith("depth and texture;") and panel.copy.isEnabled()
    by_colour = force()
    assert by_colour != by_depth
    window.panels["shear"].close()
    driver.wait(lambda: driver.result.traction is None)
    # numbers by depth and colour do not stay beside those by depth alone
    assert np.isnan(driver.state.history.values["force_n"][:last]).all()
    driver.wait_until_shown()
    assert force()[0] == by_depth[0]
    assert force()[1] == pytest.approx(by_depth[1], rel=1e-6)
    # a number that depends on the frames before looks so, and is not copied
    driver.show("shear")
    driver.state.set_playing(True)
    driver.wait(lambda: panel.values["force"].text().startswith("≈"))
    assert not panel.copy.isEnabled()
    # use of colour is said beside the force and in Compare
    driver.state.set_playing(False)
    window.panels["shear"].close()
    driver.show_source(lambda _: PressedSpeckles(rubber), rubber)
    panel, layers = driver.window.compare, driver.state.settings.layers
    driver.state.change(layers=layers | {"traction"})
    driver.pass_by(range(COLLECTED + 1))
    driver.seek(len(source) - 1)
    details = lambda: next(t for t in view_texts(driver) if t.startswith("peak"))  # noqa: E731
    assert "by depth and colour" in details()
    driver.show("compare")
    driver.wait(lambda: panel.a.values["status"].text() == "ok")
    assert panel.hint.text().startswith("This panel solves by depth alone")
    driver.choose(layers=layers)
    driver.seek(0)
    driver.seek(len(source) - 1)
    assert "colour" not in details()
    driver.wait(lambda: "colour" not in panel.hint.text())
