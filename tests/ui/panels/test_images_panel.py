"""Images by mouse: the place under it in the image, in 3-D and in numbers; hidden ones not made."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from PySide6.QtCore import QEvent, QPoint, QPointF
from PySide6.QtWidgets import QApplication
from window_driver import Driver, canvas, hover, idle, in_view, near, texts

from bubbleviz.diagnostics.probe import Probe
from bubbleviz_ui.engine import sensor_client
from bubbleviz_ui.panels.images_panel import ImagesPanel, best_columns
from bubbleviz_ui.shell.theme import NODE

Drive = Callable[..., Driver]
CONTACT = 75


def opened(driver: Driver, *images: str) -> ImagesPanel:
    driver.window.resize(1280, 800)
    driver.state.choose(images=frozenset(images))
    driver.window.panels["images"].show()
    driver.wait(lambda: bool(driver.window.images.cells))
    of_depth = set(images) - {"patch", "colour", "flow"}
    driver.wait(lambda: set(driver.window.controller.inspection.images) >= of_depth)
    QApplication.processEvents()
    driver.settle()
    return driver.window.images


def place_of(panel: ImagesPanel, name: str, row: int, column: int) -> QPoint:
    box = panel.cells[name].box
    scene = box.mapViewToScene(QPointF(column + 0.5, row + 0.5))
    return canvas(panel).mapFromScene(scene)


def test_a_pixel_lights_up_its_point_and_its_node(drive: Drive) -> None:
    driver = drive(frame=CONTACT)
    panel = opened(driver, "depth", "change")
    result = driver.window.controller.result
    row, column = 24, 44
    before = driver.window.view.pixels()
    hover(canvas(panel).viewport(), place_of(panel, "change", row, column))
    found = driver.window.hover.place
    assert found is not None and found.pixel == (row, column)
    depth = float(result.frame.depth_m[row, column])
    camera = driver.window.controller.sensor.camera  # looks along +z, not turned
    x = (column - camera.cx) / camera.fx * depth
    y = (row - camera.cy) / camera.fy * depth
    expected = np.array([x, y, depth]) + camera.position_m
    np.testing.assert_allclose(found.point_m, expected, atol=1e-6)
    nodes = driver.pipeline.mesh.deformed(result.estimate.displacement_m)
    assert found.node == np.linalg.norm(nodes - expected, axis=1).argmin()
    text = [label.text() for label in panel.lines]
    assert f"pixel ({column}, {row})" in text[0] and f"depth {1e3 * depth:.2f} mm" in text[0]
    assert text[1].startswith(f"x {1e3 * x:.2f}") and text[1].endswith("mm")
    u, p_c = (f[found.node] for f in (result.estimate.displacement_m,
                                      result.estimate.contact_pressure_pa))  # fmt: skip
    assert text[2] == f"u {1e3 * u:.2f} mm · p_c {p_c / 1e3:.2f} kPa"
    driver.settle()
    after = driver.window.view.pixels()
    place = in_view(driver, found.node_m)
    assert near(after, place, NODE) and not near(before, place, NODE)
    for name in ("depth", "change"):
        marks = panel.cells[name].pixel.getData()
        assert (marks[0][0], marks[1][0]) == (column + 0.5, row + 0.5)
    QApplication.sendEvent(canvas(panel), QEvent(QEvent.Type.Leave))
    driver.settle()
    assert driver.window.hover.place is None
    assert not near(driver.window.view.pixels(), place, NODE)


def test_a_place_in_3d_is_marked_in_the_images(drive: Drive) -> None:
    driver = drive(frame=CONTACT)
    panel = opened(driver, "depth")
    node = int(driver.window.controller.result.estimate.contact_pressure_pa.argmax())
    nodes = driver.pipeline.mesh.deformed(driver.window.controller.result.estimate.displacement_m)
    hover(driver.window.view, in_view(driver, nodes[node]))
    driver.wait(lambda: driver.window.hover.place is not None)
    found = driver.window.hover.place
    assert np.linalg.norm(found.node_m - nodes[node]) < driver.pipeline.mesh.edge_length
    column, row = (float(c[0]) for c in panel.cells["depth"].pixel.getData())
    T = driver.pipeline.camera.T_B_C
    u, v = driver.pipeline.camera.intrinsics.project((nodes[node] - T[:3, 3]) @ T[:3, :3])
    assert math.hypot(column - 0.5 - u, row - 0.5 - v) < 3
    hover(driver.window.view, QPoint(3, 3))
    driver.wait(lambda: driver.window.hover.place is None)


def test_nothing_is_picked_while_playing_unless_images_are_open(drive: Drive) -> None:
    driver = drive(frame=CONTACT)
    nodes = driver.pipeline.mesh.nodes
    point = lambda: hover(driver.window.view, in_view(driver, nodes[nodes[:, 2].argmax()]))  # noqa: E731
    point()
    driver.wait(lambda: driver.window.hover.place is not None)
    driver.state.set_playing(True)
    assert driver.window.hover.place is None
    point()
    assert driver.window.hover.place is None and idle(driver.window.pointing)
    before = driver.window.view.size()
    driver.window.panels["images"].show()
    driver.wait(lambda: "images" in driver.state.choices.panels)
    driver.wait(lambda: driver.window.view.size() != before)
    point()
    driver.wait(lambda: driver.window.hover.place is not None)
    driver.state.set_playing(False)


def test_pointing_at_the_membrane_shows_its_numbers_without_a_panel(drive: Drive) -> None:
    driver = drive(frame=CONTACT)
    assert "images" not in driver.state.choices.panels
    result = driver.window.controller.result
    pressure, moved = result.estimate.contact_pressure_pa, result.estimate.displacement_m
    nodes = driver.pipeline.mesh.deformed(moved)
    place = in_view(driver, nodes[int(pressure.argmax())])
    hover(driver.window.view, place)
    driver.wait(lambda: driver.window.hover.place is not None)
    found = driver.window.hover.place
    row, column = found.pixel
    seen = result.cloud_pixels == row * result.frame.depth_m.shape[1] + column
    (residual,) = result.cloud_residual_m[seen]
    shown = f" p_c {1e-3 * pressure[found.node]:.2f} kPa \n u {1e3 * moved[found.node]:.2f} mm \n"
    shown += f" residual {1e3 * residual:.3f} mm \n node {found.node} "
    assert shown in texts(driver)
    driver.settle()
    assert not near(driver.window.view.pixels(), in_view(driver, found.node_m), NODE)
    hover(driver.window.view, QPoint(3, 3))
    driver.wait(lambda: driver.window.hover.place is None)
    assert shown not in texts(driver)


def test_the_numbers_under_the_mouse_follow_the_frame(drive: Drive) -> None:
    driver = drive(frame=CONTACT)
    panel = opened(driver, "depth")
    hover(canvas(panel).viewport(), place_of(panel, "depth", 25, 44))
    before = panel.lines[2].text()
    driver.seek(3)
    assert panel.lines[2].text() != before and "p_c 0.00 kPa" in panel.lines[2].text()


def test_residuals_have_the_colours_of_the_3d_view_in_both_themes(drive: Drive) -> None:
    driver = drive(frame=CONTACT)
    panel = opened(driver, "residual", "change", "depth")
    cloud = driver.window.scene.layers["cloud"].actor.mapper
    middles = set()
    for name in ("dark", "light"):
        driver.state.choose(theme=name)
        driver.settle()
        colours = cloud.lookup_table.values[:, :3]
        for picture in ("residual", "change"):
            np.testing.assert_array_equal(panel.cells[picture].item.lut[:, :3], colours)
        lowest = ",".join(map(str, colours[0]))
        assert f"rgb({lowest})" in panel.cells["residual"].text
        middles.add(f"rgb({','.join(map(str, panel.cells['residual'].item.lut[128, :3]))})")
        assert not np.array_equal(panel.cells["depth"].item.lut[:, :3], colours)
    driver.state.choose(theme="system")
    assert len(middles) == 2


def test_only_chosen_images_are_computed(drive: Drive) -> None:
    driver = drive(frame=CONTACT)
    counts = driver.pipeline.counts
    assert not any(name.startswith("look") for name in counts)
    panel = opened(driver, "depth", "change")
    assert counts["look residual"] == 0 and counts["pixel_mask"] == 0
    panel.boxes["residual"].trigger()
    panel.boxes["patch"].trigger()
    driver.wait(lambda: counts["look residual"] > 0 and counts["pixel_mask"] > 0)
    driver.window.panels["images"].hide()
    driver.wait(lambda: "images" not in driver.state.choices.panels)
    driver.seek(CONTACT + 2)  # behind it nothing that was asked for before is left to do
    before = counts["look change"], counts["look residual"], counts["pixel_mask"]
    driver.seek(CONTACT + 1)
    assert (counts["look change"], counts["look residual"], counts["pixel_mask"]) == before


def test_while_playing_not_every_frame_is_looked_at_closer(
    drive: Drive, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver = drive()
    opened(driver, "depth", "change")
    counts, controller = driver.pipeline.counts, driver.window.controller
    monkeypatch.setattr(sensor_client, "LOOK_EVERY_S", 3600.0)
    before = counts["look change"], counts["total"]
    driver.state.choose(every_frame=True)
    driver.state.set_playing(True)
    driver.wait(lambda: counts["total"] > before[1] + 30)
    assert counts["look change"] == before[0]
    monkeypatch.setattr(sensor_client, "LOOK_EVERY_S", 0.0)
    driver.wait(lambda: counts["look change"] > before[0] + 2)
    monkeypatch.setattr(sensor_client, "LOOK_EVERY_S", 3600.0)
    driver.state.set_playing(False)
    driver.settle()
    image = lambda: controller.inspection.images["depth"]  # noqa: E731
    driver.wait(lambda: np.array_equal(image(), controller.result.frame.depth_m, equal_nan=True))


def test_images_show_the_press_and_leave_out_what_is_missing(drive: Drive) -> None:
    driver = drive(frame=CONTACT)
    panel = opened(driver, *driver.window.images.boxes)
    images = driver.window.controller.inspection.images
    result, truth = driver.window.controller.result, driver.window.controller.result.patch
    inside = truth.pixel_mask
    assert inside is not None and images["change"][inside].max() < -2e-3
    assert abs(np.nanmedian(images["change"][~inside])) < 1e-3
    sigma = driver.window.controller.sensor.camera.noise_relative * 0.15
    assert np.nanmedian(images["noise"]) == pytest.approx(sigma, rel=0.3)
    assert np.nanstd(images["residual"]) < 0.4 * np.nanstd(images["change"])
    missing = np.isnan(result.frame.depth_m)
    assert missing.any() and not images["used"][missing].any()
    cell = panel.cells["depth"]
    cell.item.render()
    row, column = np.argwhere(missing)[0]
    assert cell.item.qimage.pixelColor(int(column), int(row)).alpha() == 0
    row, column = np.argwhere(inside)[0]
    assert cell.item.qimage.pixelColor(int(column), int(row)).alpha() == 255
    assert cell.text.endswith("mm") and panel.cells["patch"].text.endswith("no")


def test_the_text_about_a_place_is_not_clipped(drive: Drive) -> None:
    driver = drive(frame=CONTACT)
    panel = opened(driver, *driver.window.images.boxes)
    hover(canvas(panel).viewport(), place_of(panel, "change", 25, 44))
    QApplication.processEvents()
    for label in panel.lines:
        assert label.fontMetrics().horizontalAdvance(label.text()) <= label.width(), label.text()
    for cell in panel.cells.values():
        assert cell.words.item.boundingRect().width() <= cell.frame.size().width() + 6, cell.text
    assert driver.window.width() == 1280


def test_a_pixel_without_a_return_has_the_node_its_ray_passes(drive: Drive) -> None:
    driver = drive(frame=CONTACT)
    result, pipeline = driver.window.controller.result, driver.pipeline
    depth = result.frame.depth_m
    depth = depth.copy()
    pixel = (30, 40)
    from dataclasses import replace

    probe = Probe(pipeline.camera, pipeline.mesh)
    seen = probe.at_pixel(pixel, result)
    depth[pixel] = np.nan
    blind = probe.at_pixel(pixel, replace(result, frame=replace(result.frame, depth_m=depth)))
    assert np.isnan(blind.depth_m) and np.isnan(blind.point_m).all()
    assert np.linalg.norm(blind.node_m - seen.node_m) < 1.5 * pipeline.mesh.edge_length
    assert probe.at_pixel((60, 0), result) is None and probe.at_pixel((0, -1), result) is None
    outside = probe.at_point(np.array([0.5, 0.0, 0.1]), result)
    assert outside.pixel is None and np.isnan(outside.depth_m)


def test_images_are_as_large_as_can_be() -> None:
    assert best_columns(0, 310, 600) == 1
    assert best_columns(6, 310, 600) == 2
    assert best_columns(3, 310, 900) == 1
    assert best_columns(4, 900, 200) == 4
    assert best_columns(3, 340, 140) == 2  # three would write over each other


def test_all_images_may_be_hidden(drive: Drive) -> None:
    driver = drive(frame=CONTACT)
    panel = opened(driver, "depth")
    panel.boxes["depth"].trigger()
    assert driver.state.choices.images == frozenset()
    panel.boxes["depth"].trigger()
    driver.settle()
    assert driver.state.choices.images == frozenset({"depth"})


def test_images_open_large_enough_beside_the_plots_of_a_small_window(drive: Drive) -> None:
    """As a tab of theirs: the view keeps its width, and each image is more than a thumbnail."""
    driver = drive(frame=5)
    window = driver.window
    window.resize(1016, 660)
    wide = window.view.width()
    for title in ("Plots", "Images"):
        window.shortcuts.actions[f"View › {title}"].trigger()
    driver.settle()
    assert (window.width(), window.height()) == (1016, 660) and window.view.width() == wide
    cells = [window.images.cells[name] for name in driver.state.choices.images]
    assert len(cells) >= 3
    for cell in cells:
        assert cell.box.sceneBoundingRect().height() > 90
