"""Images by mouse: the place under it in the image, in 3-D and in numbers; hidden ones not made."""

import math
from dataclasses import replace

import numpy as np
import pytest
from fakes import FRAMES, DentSource
from PySide6.QtCore import QEvent, QPoint, QPointF, Qt
from PySide6.QtWidgets import QApplication
from window_driver import (
    CONTACT,
    clipped_texts,
    graphics_view,
    hover,
    near,
    no_pending_timers,
    screen_point,
    view_texts,
)

from bubbleviz_ui.engine import sensor_client
from bubbleviz_ui.panels.images_panel import best_columns
from bubbleviz_ui.shell.theme import NODE

AWAY = QPoint(3, 3)
"""A place of the 3-D view where nothing is."""


def opened(driver, *images):
    driver.window.resize(1280, 800)
    driver.state.change(images=frozenset(images))
    driver.show("images")
    driver.wait(lambda: bool(driver.window.images.cells))
    of_depth = set(images) - {"patch", "colour", "flow"}
    driver.wait(lambda: set(driver.inspection.images) >= of_depth)
    QApplication.processEvents()
    driver.wait_until_shown()
    return driver.window.images


def place_of(panel, name, row, column):
    box = panel.cells[name].box
    scene = box.mapViewToScene(QPointF(column + 0.5, row + 0.5))
    return graphics_view(panel).mapFromScene(scene)


def pointed_at(driver, place):
    """Point at a place of the 3-D view until it is known what is there."""
    hover(driver.window.view, place)
    driver.wait(lambda: (driver.window.hover.place is None) == (place == AWAY))


def test_images_and_view_mark_the_same_probed_place_and_fit_a_small_window(drive):
    driver = drive(frame=CONTACT)
    # images fit a small window as a tab of plots: the view keeps its width, none is a thumbnail
    driver.resize(1016, 660)
    wide = driver.window.view.width()
    driver.trigger("View › Plots")
    driver.wait_until_shown()
    plots = graphics_view(driver.window.plots).viewport()
    assert plots.visibleRegion().boundingRect().height() == plots.height() > 200
    driver.trigger("View › Images")
    driver.wait_until_shown()
    assert driver.size == (1016, 660) and driver.window.view.width() == wide
    cells = [driver.window.images.cells[name] for name in driver.state.settings.images]
    assert len(cells) >= 3
    for cell in cells:
        assert cell.box.sceneBoundingRect().height() > 90
    # of the default plots two are side by side; further rows scroll
    driver.window.panels["plots"].raise_()
    for box in driver.window.plots.boxes.values():
        if not box.isChecked():
            box.trigger()
    driver.wait_until_shown()
    assert driver.size == (1016, 660)
    assert plots.height() >= 2 * plots.visibleRegion().boundingRect().height()
    for name in ("images", "plots"):
        driver.window.panels[name].hide()
    # both mark the same place
    driver.resize(1024, 700)
    driver.choose(layers=driver.state.settings.layers | {"cloud"})
    driver.wait(lambda: driver.result.cloud_residual_m is not None)
    driver.wait_until_shown()
    result, nodes, pipeline = driver.result, driver.nodes(), driver.pipeline
    pressure, moved = result.estimate.contact_pressure_pa, result.estimate.displacement_m
    node = int(pressure.argmax())
    assert "images" not in driver.state.settings.panels
    pointed_at(driver, screen_point(driver, nodes[node]))
    found = driver.window.hover.place
    assert np.linalg.norm(found.membrane_m - nodes[node]) < pipeline.mesh.edge_length
    row, column = found.pixel
    seen = result.cloud_pixels == row * result.frame.depth_m.shape[1] + column
    (residual,) = result.cloud_residual_m[seen]
    p_c, u = (found.interpolated(field) for field in (pressure, moved))
    shown = f" p_c {1e-3 * p_c:.2f} kPa \n u {1e3 * u:.2f} mm \n"
    shown += f" residual {1e3 * residual:.3f} mm \n node {found.node} \n in the patch "
    assert any(text.endswith(shown) for text in view_texts(driver))
    driver.wait_until_shown()
    assert not near(driver.pixels(), screen_point(driver, found.membrane_m), NODE)
    pointed_at(driver, AWAY)
    assert not any(text.endswith(shown) for text in view_texts(driver))

    panel = opened(driver, "depth")
    pointed_at(driver, screen_point(driver, nodes[node]))
    column, row = (float(c[0]) for c in panel.cells["depth"].pixel.getData())
    T = pipeline.camera.T_B_C
    u, v = pipeline.camera.intrinsics.project((nodes[node] - T[:3, 3]) @ T[:3, :3])
    assert math.hypot(column - 0.5 - u, row - 0.5 - v) < 3
    pointed_at(driver, AWAY)
    # a pixel lights up its point and its node
    panel, result = opened(driver, "depth", "change"), driver.result
    row, column = 24, 44
    before = driver.pixels()
    hover(graphics_view(panel).viewport(), place_of(panel, "change", row, column))
    found = driver.window.hover.place
    assert found is not None and found.pixel == (row, column)
    depth = float(result.frame.depth_m[row, column])
    camera = driver.window.controller.sensor.camera  # looks along +z, not turned
    x = (column - camera.cx) / camera.fx * depth
    y = (row - camera.cy) / camera.fy * depth
    expected = np.array([x, y, depth]) + camera.position_m
    np.testing.assert_allclose(found.point_m, expected, atol=1e-6)
    assert np.linalg.norm(found.membrane_m - expected) < 1e-3
    estimate, text = result.estimate, [label.text() for label in panel.lines]
    assert f"pixel ({column}, {row})" in text[0] and f"depth {1e3 * depth:.2f} mm" in text[0]
    assert text[1].startswith(f"x {1e3 * x:.2f}") and text[1].endswith("mm")
    fields = estimate.displacement_m, estimate.contact_pressure_pa
    u, p_c = (found.interpolated(field) for field in fields)
    where = "in" if found.in_patch else "outside"
    assert text[2] == f"u {1e3 * u:.2f} mm · p_c {p_c / 1e3:.2f} kPa · {where} the patch"
    place = screen_point(driver, found.membrane_m)
    driver.wait(lambda: near(driver.pixels(), place, NODE))
    assert not near(before, place, NODE)
    for name in ("depth", "change"):
        marks = panel.cells[name].pixel.getData()
        assert (marks[0][0], marks[1][0]) == (column + 0.5, row + 0.5)
    driver.seek(3)  # the numbers follow the frame
    assert panel.lines[2].text() != text[2] and "p_c 0.00 kPa" in panel.lines[2].text()
    QApplication.sendEvent(graphics_view(panel), QEvent(QEvent.Type.Leave))
    driver.wait_until_shown()
    assert driver.window.hover.place is None
    assert not near(driver.pixels(), place, NODE)
    # images show the press and leave out what is missing
    driver.seek(CONTACT)
    panel = opened(driver, *driver.window.images.boxes)
    images, result = driver.inspection.images, driver.result
    inside = result.patch.pixel_mask
    assert inside is not None and images["change"][inside].max() < -2e-3
    assert abs(np.nanmedian(images["change"][~inside])) < 1e-3
    sigma = driver.window.controller.sensor.camera.noise_relative * 0.15
    assert np.nanmedian(images["noise"]) == pytest.approx(sigma, rel=0.3)
    assert np.nanstd(images["residual"]) < 0.4 * np.nanstd(images["change"])
    missing = np.isnan(result.frame.depth_m)
    assert missing.any() and not images["used"][missing].any()
    cell = panel.cells["depth"]
    cell.picture.render()
    for where, alpha in ((missing, 0), (inside, 255)):
        row, column = map(int, np.argwhere(where)[0])
        assert cell.picture.qimage.pixelColor(column, row).alpha() == alpha
    assert cell.text.endswith("mm") and panel.cells["patch"].text.endswith("no")
    # no text is clipped
    hover(graphics_view(panel).viewport(), place_of(panel, "change", 25, 44))
    QApplication.processEvents()
    assert not clipped_texts(panel) and all(label.text() for label in panel.lines)
    for cell in panel.cells.values():
        assert cell.label.item.boundingRect().width() <= cell.item.size().width() + 6, cell.text
    assert driver.window.width() == 1280
    # residuals have the colours of the 3-D view in both themes
    cells = opened(driver, "residual", "change", "depth").cells
    cloud, middles = driver.window.scene.layers["cloud"].actor.mapper, set()
    for name in ("dark", "light"):
        driver.choose(theme=name)
        colours = cloud.lookup_table.values[:, :3]
        for picture in ("residual", "change"):
            np.testing.assert_array_equal(cells[picture].picture.lut[:, :3], colours)
        assert f"rgb({','.join(map(str, colours[0]))})" in cells["residual"].text
        middles.add(tuple(cells["residual"].picture.lut[128, :3]))
        assert not np.array_equal(cells["depth"].picture.lut[:, :3], colours)
    assert len(middles) == 2
    # the whole image stays in view when the panel becomes larger or smaller
    cell, dock = cells["depth"], driver.window.panels["images"]
    for height in (500, 10, 350):
        driver.window.resizeDocks([dock], [height], Qt.Orientation.Vertical)
        QApplication.processEvents()
        assert cell.box.viewRect().contains(cell.picture.boundingRect())
    # zooming out is limited
    box, width = cells["depth"].box, cells["depth"].image.shape[1]
    for _ in range(40):
        box.scaleBy((1.5, 1.5))
    (left, right), _ = box.viewRange()
    assert width <= right - left < 10 * width


def test_only_chosen_images_are_computed_and_less_often_during_playback(drive, monkeypatch):
    driver = drive(frame=CONTACT)
    counts = driver.pipeline.counts
    assert not any(name.startswith("diagnose") for name in counts)
    panel = opened(driver, "depth")
    panel.boxes["depth"].trigger()  # all may be hidden
    assert driver.state.settings.images == frozenset()
    panel.boxes["depth"].trigger()
    driver.wait_until_shown()
    assert driver.state.settings.images == {"depth"}
    panel.boxes["change"].trigger()
    driver.wait(lambda: counts["diagnose change"] > 0)
    assert counts["diagnose residual"] == 0 and counts["pixel_mask"] == 0
    panel.boxes["residual"].trigger()
    panel.boxes["patch"].trigger()
    driver.wait(lambda: counts["diagnose residual"] > 0 and counts["pixel_mask"] > 0)
    driver.window.panels["images"].hide()
    driver.wait(lambda: "images" not in driver.state.settings.panels)
    driver.seek(CONTACT + 2)  # behind it nothing that was asked for before is left to do
    before = counts["diagnose change"], counts["diagnose residual"], counts["pixel_mask"]
    driver.seek(CONTACT + 1)
    assert (counts["diagnose change"], counts["diagnose residual"], counts["pixel_mask"]) == before
    # nothing is picked while playing unless images are open
    driver.seek(CONTACT)
    nodes, found = driver.pipeline.mesh.nodes, driver.window.hover
    point = lambda: hover(driver.window.view, screen_point(driver, nodes[nodes[:, 2].argmax()]))  # noqa: E731
    point()
    driver.wait(lambda: found.place is not None)
    driver.state.set_playing(True)
    assert found.place is None
    point()
    assert found.place is None and no_pending_timers(driver.window.pointing)
    before = driver.window.view.size()
    driver.show("images")
    driver.wait(lambda: "images" in driver.state.settings.panels)
    driver.wait(lambda: driver.window.view.size() != before)
    # the view may change again: the mouse keeps moving
    driver.wait(lambda: point() or found.place is not None)
    driver.state.set_playing(False)
    # during playback not every frame gets images
    opened(driver, "depth", "change")
    controller = driver.window.controller
    monkeypatch.setattr(sensor_client, "IMAGES_EVERY_S", 3600.0)
    driver.wait_until_shown()
    driver.wait(lambda: not controller.worker.busy)  # earlier requests count, too
    before = counts["diagnose change"], counts["total"]
    driver.state.change(every_frame=True)
    driver.state.set_playing(True)
    driver.wait(lambda: counts["total"] > before[1] + 8)
    assert counts["diagnose change"] == before[0]
    monkeypatch.setattr(sensor_client, "IMAGES_EVERY_S", 0.0)
    driver.wait(lambda: counts["diagnose change"] > before[0] + 2)
    monkeypatch.setattr(sensor_client, "IMAGES_EVERY_S", 3600.0)
    driver.state.set_playing(False)
    driver.wait_until_shown()
    image = lambda: controller.inspection.images["depth"]  # noqa: E731
    driver.wait(lambda: np.array_equal(image(), driver.result.frame.depth_m, equal_nan=True))


@pytest.mark.parametrize(
    ("images", "width", "height", "columns"),
    # three images of 340×140 in a row would write over each other
    [(0, 310, 600, 1), (6, 310, 600, 2), (3, 310, 900, 1), (4, 900, 200, 4), (3, 340, 140, 2)],
)
def test_grid_with_the_largest_images(images, width, height, columns):
    assert best_columns(images, width, height) == columns


class BlankSource(DentSource):
    """The dent; its last frame has no return."""

    def __getitem__(self, index):
        frame = super().__getitem__(index)
        blank = np.full_like(frame.depth_m, np.nan)
        return replace(frame, depth_m=blank) if index == FRAMES - 1 else frame


def test_a_frame_without_returns_says_so_and_keeps_the_scales(drive):
    driver = drive(BlankSource)
    panel = opened(driver, "depth", "change")
    driver.seek(6)
    driver.wait_until_shown()
    cells = [panel.cells[name] for name in ("depth", "change")]
    before = [cell.text for cell in cells]
    assert all(" mm" in text for text in before)
    driver.seek(FRAMES - 1)
    said = lambda cell: "no returns" in cell.text.replace("<br>", " ")  # noqa: E731
    driver.wait(lambda: all(said(cell) for cell in cells))
    assert all(" mm" not in cell.text and cell.image is None for cell in cells)
    driver.seek(6)
    driver.wait(lambda: [cell.text for cell in cells] == before)
