"""The colour image in Images and on the membrane, by pixels; hidden it is not decoded."""

import numpy as np
from fakes import FIRST_CONTACT, FRAMES, ColouredSource
from PySide6.QtWidgets import QApplication
from window_driver import in_view, texts

DENTED = FIRST_CONTACT + 4


def opened(drive, sensor, frame=2):
    source = ColouredSource(sensor)
    driver = drive(open_source=lambda _: source, frame=frame)
    driver.choose(layers=frozenset({"membrane"}))
    return driver, source


def colour_at(driver, node):
    """Red, green and blue of the view at a node."""
    result = driver.result
    at = in_view(driver, driver.pipeline.mesh.deformed(result.estimate.motion_m)[node])
    return driver.pixels()[at.y(), at.x()].astype(int)


def is_red(rgb):
    return bool(rgb[0] > 60 and rgb[0] > 3 * rgb[1])


def is_green(rgb):
    return bool(rgb[1] > 60 and rgb[1] > 3 * rgb[0])


def node_at(driver, x, y):
    nodes = driver.pipeline.mesh.nodes
    return int(np.linalg.norm(nodes[:, :2] - (x, y), axis=1).argmin())


def test_the_membrane_has_the_colours_of_the_image_where_the_camera_sees_them(drive, sensor):
    driver, _ = opened(drive, sensor)
    left, right = node_at(driver, -0.02, -0.01), node_at(driver, 0.02, -0.01)
    assert not is_red(colour_at(driver, left))
    driver.state.choose(layers=frozenset({"membrane", "texture"}))
    driver.wait(lambda: driver.result.texture is not None)
    driver.settle()
    assert is_red(colour_at(driver, left)) and is_green(colour_at(driver, right))
    driver.choose(layers=frozenset({"texture"}))
    assert is_red(colour_at(driver, left)) and is_green(colour_at(driver, right))
    driver.choose(layers=frozenset({"membrane"}))
    assert not is_red(colour_at(driver, left))


def test_pressure_has_its_own_colours_where_something_touches(drive, sensor):
    driver, _ = opened(drive, sensor, DENTED)
    pressed = int(driver.result.estimate.contact_pressure_pa.argmax())
    alone = colour_at(driver, pressed)
    driver.state.choose(layers=frozenset({"membrane", "texture"}))
    driver.wait(lambda: driver.result.texture is not None)
    driver.settle()
    np.testing.assert_allclose(colour_at(driver, pressed), alone, atol=12)
    driver.choose(layers=frozenset({"texture"}))
    assert is_green(colour_at(driver, pressed))


def test_a_frame_without_a_colour_image_says_so(drive, sensor):
    driver, _ = opened(drive, sensor, 0)
    driver.state.choose(layers=frozenset({"texture"}), images=frozenset({"colour"}))
    driver.show("images")
    driver.wait(lambda: driver.inspection.colour is not None)
    driver.settle()
    cell = driver.window.images.cells["colour"]
    assert "no colour image at this time" in texts(driver)
    assert cell.text.replace("<br>", " ") == "Colour no colour image at this time"
    driver.seek(1)
    assert "no colour image at this time" not in texts(driver) and cell.text == "Colour"
    driver.seek(FRAMES - 1)
    assert "the colour image cannot be decoded" in texts(driver)


def test_the_image_is_shown_as_it_is(drive, sensor):
    driver, _ = opened(drive, sensor)
    driver.state.choose(images=frozenset({"colour", "depth"}))
    driver.show("images")
    driver.wait(lambda: driver.inspection.colour is not None)
    QApplication.processEvents()
    driver.settle()
    cell = driver.window.images.cells["colour"]
    cell.item.render()
    shown = [cell.item.qimage.pixelColor(column, 30).getRgb() for column in (10, 70)]
    assert shown == [(220, 0, 0, 255), (0, 220, 0, 255)]
    driver.window.hover.at_pixel(30, 40)
    assert cell.pixel.getData()[0][0] == 40.5  # one camera: a place of depth is one of colour


def test_hidden_it_is_not_decoded(drive, sensor):
    driver, source = opened(drive, sensor)
    driver.state.choose(images=frozenset({"depth", "colour"}))
    driver.seek(3)
    assert source.decoded == 0 and driver.pipeline.counts["look colour"] == 0
    driver.state.choose(layers=frozenset({"membrane", "texture"}))
    driver.wait(lambda: driver.result.texture is not None)
    driver.settle()
    assert source.decoded > 0
    driver.state.choose(layers=frozenset({"membrane"}))
    driver.seek(4)
    before = source.decoded, driver.pipeline.counts["texture"]
    driver.seek(5)
    assert (source.decoded, driver.pipeline.counts["texture"]) == before
