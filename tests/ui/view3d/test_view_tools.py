"""3-D tools by clicks: viewpoints, probe, distance, section, exaggeration, pictures."""

import numpy as np
import pytest
from PySide6.QtCore import QPoint, Qt
from PySide6.QtGui import QImage
from PySide6.QtWidgets import QApplication
from window_driver import (
    CONTACT,
    clipped_texts,
    drawn_points,
    hover,
    near,
    no_pending_timers,
    screen_point,
    view_texts,
)

from bubbleviz_ui.shell.theme import GREEN, NODE, ORANGE
from bubbleviz_ui.view3d.tools import picture_of


def opened(driver):
    driver.window.resize(1280, 800)
    driver.show("tools")
    driver.window.panels["tools"].raise_()
    driver.state.change(layers=frozenset({"membrane"}))
    QApplication.processEvents()
    driver.wait_until_shown()
    return driver.window.tools


def test_viewpoints_exaggeration_vectors_colour_maps_and_section(drive):
    driver = drive(frame=CONTACT)
    tools, camera = opened(driver), driver.window.view.camera
    for name, direction in {"top": (0, 0, -1), "side": (-1, 0, 0), "front": (0, 1, 0)}.items():
        driver.click(tools.views[name])
        np.testing.assert_allclose(camera.direction, direction, atol=1e-9)
    driver.click(tools.views["camera"])
    driver.wait_until_shown()
    view, depth_camera = driver.window.view, driver.pipeline.camera
    np.testing.assert_allclose(camera.position, depth_camera.center)
    # A pixel of the depth image is seen in the middle's distance that the intrinsics say.
    own = depth_camera.intrinsics
    point = depth_camera.center + 0.1 * np.array([0.2, -0.1, 1.0])
    seen = screen_point(driver, point)
    off = np.array([seen.x() - view.width() / 2, seen.y() - view.height() / 2])
    wide = own.width / own.fx * view.height() / view.width()
    tall = view.height() / max(own.height / own.fy, wide)
    np.testing.assert_allclose(off, tall * np.array([0.2, -0.1]), atol=2.0)
    driver.window.scene.reset_view()
    assert camera.view_angle == pytest.approx(30.0 / driver.state.settings.zoom)
    # exaggeration moves drawn points, not measured ones
    driver.wait_until_shown()
    estimate, mesh = driver.result.estimate, driver.pipeline.mesh
    solved = driver.pipeline.counts["estimate"]
    tools.exaggeration.setValue(3.0)
    driver.wait_until_shown()
    drawn = drawn_points(driver.window.scene.layers["membrane"])
    np.testing.assert_allclose(drawn, mesh.deformed(3.0 * estimate.displacement_m), atol=1e-7)
    k = int(np.argmin(estimate.displacement_m))
    driver.window.scene.look_from("top")
    driver.wait_until_shown()
    place, true = screen_point(driver, drawn[k]), mesh.deformed(estimate.displacement_m)[k]
    picked = driver.window.scene.pick(place.x(), place.y())
    np.testing.assert_allclose(picked, true, atol=2e-3)
    assert abs(drawn[k] - true).max() > 6e-3
    assert driver.pipeline.counts["estimate"] == solved
    assert not near(driver.pixels(), place, NODE)
    driver.state.include("panels", "images", True)  # which also marks the place
    driver.window.hover.point_at(true)
    driver.wait_until_shown()
    assert near(driver.pixels(), place, NODE)
    # vector lengths follow the pressure, and colour maps the colours
    tools.exaggeration.setValue(1.0)
    driver.wait_until_shown()
    assert len(driver.pressure_pixels()) > 100
    tools.colour_map.setFocus()
    driver.bot.keyClicks(tools.colour_map, "viridis")
    driver.wait_until_shown()
    assert driver.state.settings.colour_map == "viridis" and len(driver.pressure_pixels()) == 0
    driver.click(driver.window.layers.boxes["vectors"])
    driver.choose(layers=frozenset({"vectors"}))
    pressure = driver.result.estimate.contact_pressure_pa
    points = drawn_points(driver.window.scene.layers["vectors"])[: 2 * len(pressure)]
    length = np.linalg.norm(points[0::2] - points[1::2], axis=1)
    assert np.corrcoef(length, pressure)[0, 1] > 0.999 and length[pressure == 0.0].max() < 1e-9
    assert driver.count(ORANGE)[0] > 20
    # a section clips the scene
    driver.choose(layers=frozenset({"membrane"}))
    driver.state.include("panels", "images", False)
    driver.window.scene.look_from("top")
    driver.wait_until_shown()
    view = driver.window.view
    background = driver.pixels()[5, 5]
    left, right = (screen_point(driver, np.array([x, 0.0, 0.03])) for x in (-0.04, 0.04))

    def drawn(place):
        return bool(np.any(driver.pixels()[place.y(), place.x()] != background))

    assert drawn(left) and drawn(right)
    tools.section.setFocus()
    driver.bot.keyClick(tools.section, Qt.Key.Key_Down)
    assert driver.state.settings.section_axis == "x"
    driver.wait_until_shown()
    assert not drawn(left) and drawn(right)
    assert driver.count(ORANGE)[0] > 50
    driver.click(tools.flipped)
    driver.wait_until_shown()
    assert drawn(left) and not drawn(right)
    tools.section_at.setValue(tools.section_at.maximum())
    assert tools.section_text.text() == "at 75.00 mm"
    driver.wait_until_shown()
    assert drawn(left) and drawn(right)
    tools.section.setCurrentIndex(0)
    driver.wait_until_shown()
    assert driver.count(ORANGE)[0] == 0
    # clipped membrane and points are not picked
    driver.choose(section_flipped=False, section_at_m=0.0)
    tools.section.setCurrentIndex(tools.section.findText("cut ⊥ x"))
    view = driver.window.view
    for layers in ({"membrane"}, {"cloud"}, {"membrane", "cloud"}):
        driver.choose(layers=frozenset(layers))
        cloudy = "cloud" in layers
        driver.wait(lambda cloudy=cloudy: (driver.result.cloud_m is not None) == cloudy)
        cloud = driver.result.cloud_m
        points = driver.nodes() if cloud is None else cloud
        there = [point for point in points[::7] if abs(point[0]) > 0.01 and point[2] > 0.02]
        for point in there[:: len(there) // 6]:
            hover(view, screen_point(driver, point))
            driver.wait(lambda: no_pending_timers(driver.window.pointing))
            place = driver.window.hover.place
            assert (place is not None) == (point[0] > 0.0), (layers, point)
        assert len({point[0] > 0.0 for point in there[:: len(there) // 6]}) == 2


def hottest(driver):
    """The node with the highest pressure."""
    return driver.nodes()[int(np.argmax(driver.result.estimate.contact_pressure_pa))]


def test_probe_distance_and_profile_by_clicks(drive):
    driver = drive(frame=CONTACT)
    tools, view, middle = opened(driver), driver.window.view, driver.window.view.rect().center()
    driver.click(tools.tools["probe"])
    driver.drag(view, middle, middle + QPoint(40, 0))
    assert tools.picked.place is None  # dragging is not a click
    driver.window.scene.look_from("top")
    driver.wait_until_shown()
    node = hottest(driver)
    driver.click(view, screen_point(driver, node))
    found = tools.picked.place
    assert found is not None and np.linalg.norm(found.membrane_m - node) < 0.01
    assert "kPa" in tools.reading[2].text() and f"node {found.node}" in tools.reading[0].text()
    driver.wait_until_shown()
    assert near(driver.pixels(), screen_point(driver, found.membrane_m), NODE)
    before = tools.reading[2].text()
    # in the middle between a node in contact and one outside, as the picture shows it
    estimate, triangles = driver.result.estimate, driver.pipeline.mesh.triangles
    pressure = estimate.contact_pressure_pa
    (edge, *_) = np.flatnonzero((pressure[triangles] > 0.0).sum(axis=1) == 1)
    inner = triangles[edge][pressure[triangles[edge]].argmax()]
    outer = next(corner for corner in triangles[edge] if corner != inner)
    for larger in (1.0, 3.0):
        driver.choose(exaggeration=larger)
        drawn = driver.pipeline.mesh.deformed(larger * estimate.motion_m)
        driver.click(view, screen_point(driver, 0.5 * (drawn[inner] + drawn[outer])))
        read = tools.picked.place.pressure_pa
        assert read == pytest.approx(0.5 * pressure[inner], rel=0.2)
        assert f"p_c {1e-3 * read:.2f} kPa" in tools.reading[2].text()
    driver.choose(exaggeration=1.0)
    driver.seek(2)
    assert tools.reading[2].text() != before and tools.picked.place.pressure_pa == 0.0
    # without the panel both are shown in the view until Escape
    driver.click(tools.tools["rotate"])
    driver.seek(CONTACT)
    driver.window.panels["tools"].hide()
    driver.trigger("View › Probe a point")
    driver.click(view, screen_point(driver, hottest(driver)))
    found = driver.window.tools.picked.place

    def written():
        return [text for text in view_texts(driver) if f"node {found.node}" in text]

    assert found is not None and f"p_c {1e-3 * found.pressure_pa:.2f} kPa" in written()[0]
    driver.state.change(pressure_unit="Pa")
    assert f"p_c {found.pressure_pa:.0f} Pa" in written()[0]
    driver.key(Qt.Key.Key_Escape)
    assert driver.window.tools.picked.place is None and not written()

    driver.seek(3)
    driver.window.scene.look_from("top")
    driver.wait_until_shown()
    driver.trigger("View › Measure distance and profile")
    ends = [node for node in driver.nodes() if node[2] > 0.045][:2]
    true_m = float(np.linalg.norm(ends[1] - ends[0]))

    def measured(unit, true):
        """Whether the view shows the length, in addition to that of the scale bar."""
        found = [text.split() for text in view_texts(driver)]
        lengths = [float(words[0]) for words in found if words[1:] == [unit]]
        return any(length == pytest.approx(true, rel=0.05) for length in lengths)

    for end in ends:
        assert not measured("mm", 1e3 * true_m)
        driver.click(view, screen_point(driver, end))
    assert measured("mm", 1e3 * true_m)
    driver.state.change(length_unit="m")
    assert measured("m", true_m)
    driver.wait_until_shown()
    assert driver.count(GREEN)[0] > 50
    driver.key(Qt.Key.Key_Escape)
    assert not measured("m", true_m)
    driver.wait_until_shown()
    assert driver.count(GREEN)[0] == 0
    # a profile between two points, in the panel
    driver.choose(length_unit="mm", pressure_unit="kPa")
    opened(driver)
    driver.seek(CONTACT)
    driver.window.scene.look_from("top")
    driver.wait_until_shown()
    assert not tools.profile.isVisible()
    driver.click(tools.tools["distance"])
    nodes = driver.nodes()
    ends = [nodes[np.linalg.norm(nodes[:, :2] - (x, 0.0), axis=1).argmin()] for x in (-0.04, 0.04)]
    for end in ends:
        driver.click(driver.window.view, screen_point(driver, end))
        first, *numbers = tools.reading[0].text().split()
        assert (first == "Click") == (end is ends[0])  # on the other point
    assert (first, numbers[1]) == ("distance", "mm")
    assert float(numbers[0]) == pytest.approx(1e3 * np.linalg.norm(ends[1] - ends[0]), abs=1.0)
    plot = tools.profile
    driver.wait(lambda: plot.isVisible() and len(plot.measured.getData()[0]) > 10)
    along, height = plot.membrane.getData()
    length = 1e3 * np.linalg.norm(ends[1][:2] - ends[0][:2])
    assert along[0] == 0.0 and along[-1] == pytest.approx(length, abs=1.0)
    assert height[[0, -1]] == pytest.approx([1e3 * end[2] for end in ends], abs=1.0)
    pressed, peak = height.min(), plot.contact.getData()[1].max()
    assert 0.0 < peak <= 1e-3 * driver.result.estimate.contact_pressure_pa.max()
    driver.seek(0)
    assert plot.contact.getData()[1].max() == 0.0
    untouched = plot.membrane.getData()[1]
    np.testing.assert_allclose(untouched.max(), plot.rest.getData()[1].max(), atol=0.5)
    assert pressed < untouched.min() + 1.0
    driver.key(Qt.Key.Key_Escape)
    assert not plot.isVisible()


def test_saved_picture_turntable_and_layout_of_the_tools_panel(drive, tmp_path):
    driver = drive(frame=CONTACT)
    tools = opened(driver)
    before = driver.pixels()
    tools.width_box.setValue(1800)
    tools.height_box.setValue(700)
    tools.save_picture(tmp_path / "view.png")
    image = QImage(str(tmp_path / "view.png"))
    assert (image.width(), image.height()) == (1800, 700)
    driver.click(driver.window.notice.dismiss)
    height, width = before.shape[:2]
    same = picture_of(driver.window.view, width, height)
    assert np.abs(same.astype(int) - before).mean() < 1.0
    large = picture_of(driver.window.view, 1800, 700)
    red, green, blue = (large[:, :1500, k].astype(int) for k in range(3))
    assert np.count_nonzero((red > 130) & (red > 2 * blue) & (red > green + 30)) > 200
    driver.wait_until_shown()
    np.testing.assert_array_equal(driver.pixels(), before)
    tools.save_picture(tmp_path / "missing" / "view.png")
    assert "missing does not exist; create it" in driver.message_text
    # hover marks are hidden, marks of a click are kept
    driver.state.include("panels", "images", True)  # also marks the place
    view = driver.window.view
    driver.wait(lambda: bool(driver.inspection.images))
    driver.wait_until_shown()
    before, size = picture_of(view, 640, 400), view.size()
    hover(view, screen_point(driver, driver.nodes()[int(np.argmax(driver.nodes()[:, 2]))]))
    numbers = lambda: [text for text in view_texts(driver) if "node" in text]  # noqa: E731
    driver.wait(lambda: bool(numbers()))
    assert view.size() == size
    np.testing.assert_array_equal(picture_of(view, 640, 400), before)
    assert numbers()
    driver.window.tools.use_tool("probe")
    driver.click(view, view.rect().center())
    assert np.any(picture_of(view, 640, 400) != before)  # the marks of a click are kept
    # the turntable
    camera = driver.window.view.camera
    driver.state.include("panels", "images", False)
    driver.click(driver.window.message.dismiss)
    driver.wait_until_shown()
    start = np.array(camera.position)
    driver.click(tools.turn)
    driver.wait(lambda: np.linalg.norm(np.array(camera.position) - start) > 0.01)
    driver.click(tools.turn)
    height = camera.position[2]
    assert height == pytest.approx(start[2], abs=1e-6) and not tools.turntable.isActive()
    stopped = tuple(camera.position)
    driver.wait_until_shown()
    assert tuple(camera.position) == stopped
    # no text is clipped
    tools.use_tool("probe")
    tools.picked.point_at((24, 44))
    driver.state.change(length_unit="m", pressure_unit="psi", section_axis="x")
    QApplication.processEvents()
    assert driver.window.width() == 1280 and not clipped_texts(tools)
    for button in (*tools.views.values(), *tools.tools.values(), tools.turn, tools.save):
        assert button.width() >= button.sizeHint().width(), button.text()
        assert tools.rect().contains(button.geometry()), button.text()
