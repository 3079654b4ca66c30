"""Colour image in the images panel and on the membrane; not decoded while hidden."""

import numpy as np
from fakes import FIRST_CONTACT, FRAMES, ColouredSource
from PySide6.QtWidgets import QApplication
from window_driver import screen_point, view_texts

DENTED = FIRST_CONTACT + 4


def opened(drive, sensor, frame=2):
    source = ColouredSource(sensor)
    driver = drive(open_source=lambda _: source, frame=frame)
    driver.choose(layers=frozenset({"membrane"}))
    return driver, source


def colour_at(driver, node):
    """Red, green and blue of the view at a node."""
    result = driver.result
    at = screen_point(driver, driver.pipeline.mesh.deformed(result.estimate.motion_m)[node])
    return driver.pixels()[at.y(), at.x()].astype(int)


def is_red(rgb):
    return bool(rgb[0] > 60 and rgb[0] > 3 * rgb[1])


def is_green(rgb):
    return bool(rgb[1] > 60 and rgb[1] > 3 * rgb[0])


def node_at(driver, x, y):
    nodes = driver.pipeline.mesh.nodes
    return int(np.linalg.norm(nodes[:, :2] - (x, y), axis=1).argmin())


def test_colour_image_on_the_membrane_and_in_the_images_panel(drive, sensor):
    driver, source = opened(drive, sensor)
    driver.state.change(images=frozenset({"depth", "colour"}))
    driver.seek(3)
    assert source.decoded == 0 and driver.pipeline.counts["diagnose colour"] == 0
    driver.state.change(layers=frozenset({"membrane", "texture"}))
    driver.wait(lambda: driver.result.texture is not None)
    driver.wait_until_shown()
    assert source.decoded > 0
    driver.state.change(layers=frozenset({"membrane"}))
    driver.seek(4)
    before = source.decoded, driver.pipeline.counts["texture"]
    driver.seek(5)
    assert (source.decoded, driver.pipeline.counts["texture"]) == before
    # the membrane has the colours of the image where the camera sees them
    driver.seek(2)
    left, right = node_at(driver, -0.02, -0.01), node_at(driver, 0.02, -0.01)
    assert not is_red(colour_at(driver, left))
    driver.state.change(layers=frozenset({"membrane", "texture"}))
    driver.wait(lambda: driver.result.texture is not None)
    driver.wait_until_shown()
    assert is_red(colour_at(driver, left)) and is_green(colour_at(driver, right))
    driver.choose(layers=frozenset({"texture"}))
    assert is_red(colour_at(driver, left)) and is_green(colour_at(driver, right))
    driver.choose(layers=frozenset({"membrane"}))
    assert not is_red(colour_at(driver, left))
    # contact has the colours of pressure
    driver.seek(DENTED)
    pressed = int(driver.result.estimate.contact_pressure_pa.argmax())
    alone = colour_at(driver, pressed)
    driver.state.change(layers=frozenset({"membrane", "texture"}))
    driver.wait(lambda: driver.result.texture is not None)
    driver.wait_until_shown()
    np.testing.assert_allclose(colour_at(driver, pressed), alone, atol=12)
    driver.choose(layers=frozenset({"texture"}))
    assert is_green(colour_at(driver, pressed))
    # the image is unchanged
    driver.seek(2)
    driver.state.change(images=frozenset({"colour", "depth"}))
    driver.show("images")
    driver.wait(lambda: driver.inspection.colour is not None)
    QApplication.processEvents()
    driver.wait_until_shown()
    cell = driver.window.images.cells["colour"]
    cell.picture.render()
    shown = [cell.picture.qimage.pixelColor(column, 30).getRgb() for column in (10, 70)]
    assert shown == [(220, 0, 0, 255), (0, 220, 0, 255)]
    driver.window.hover.point_at((30, 40))
    assert cell.pixel.getData()[0][0] == 40.5  # aligned cameras: the same pixel
    # a missing colour image is reported
    driver.seek(0)
    driver.state.change(layers=frozenset({"texture"}), images=frozenset({"colour"}))
    driver.show("images")
    driver.wait(lambda: driver.inspection.colour is not None)
    driver.wait_until_shown()
    cell = driver.window.images.cells["colour"]
    assert "no colour image at this time" in view_texts(driver)
    assert cell.text.replace("<br>", " ") == "Colour no colour image at this time"
    driver.seek(1)
    assert "no colour image at this time" not in view_texts(driver) and cell.text == "Colour"
    driver.seek(FRAMES - 1)
    assert "the colour image cannot be read or decoded" in view_texts(driver)
