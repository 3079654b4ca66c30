"""The colour image on the membrane, against rays of the cameras."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from bubbleviz.camera import ColourCamera, ColourImage, DepthCamera, EncodedImage, Intrinsics
from bubbleviz.files import SYNTHETIC_SENSOR
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import FrameColour, Texture
from bubbleviz.sensor import load_sensor
from bubbleviz.simulation import default_press

DEPTH = Intrinsics(64, 48, 50.0, 52.0, 30.0, 25.0, "inverse_brown_conrady", (-0.05, 0.06, 1e-3))
T_B_C = np.array([[0.0, -1, 0, 0.01], [1, 0, 0, -0.02], [0, 0, 1, -0.1], [0, 0, 0, 1]])
RGB = np.arange(48 * 64 * 3, dtype=np.uint32).reshape(48, 64, 3).astype(np.uint8)


def colour_image(lag_s=0.0, rgb=RGB, camera=None, data=None):
    height, width = rgb.shape[:2]
    encoded = EncodedImage("rgb8", rgb.tobytes(), width, height, 3 * width)
    encoded = EncodedImage("jpeg", data) if data is not None else encoded
    return ColourImage(lambda: encoded, camera=camera or ColourCamera(DEPTH))


def test_point_projects_to_the_pixel_of_its_ray():
    camera = DepthCamera(DEPTH, T_B_C)
    pixels = np.array([0, 70, 1500, 3071])
    points = camera.points(np.full((48, 64), 0.09, np.float32), pixels)
    texture = Texture.of(FrameColour(RGB, ColourCamera(DEPTH)), points, camera)
    rows, columns = np.divmod(pixels, 64)
    np.testing.assert_allclose(texture.place[:, 0], (columns + 0.5) / 64, atol=1e-6)
    np.testing.assert_allclose(texture.place[:, 1], (rows + 0.5) / 48, atol=1e-6)
    assert texture.seen.all() and not texture.reason


def test_second_camera_projects_from_its_own_pose():
    """Beside the depth camera by 15 mm and turned by 90° about its axis, a pinhole."""
    own = Intrinsics(80, 60, 70.0, 70.0, 40.0, 30.0)
    T_D_C = np.array([[0.0, -1, 0, 0.015], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    camera = DepthCamera(DEPTH, np.eye(4))
    points = np.array([[0.02, 0.01, 0.1], [0.015, 0.0, 0.08], [0.5, 0, 0.1], [0, 0, -0.1]])
    colour = FrameColour(np.zeros((60, 80, 3), np.uint8), ColourCamera(own, T_D_C))
    texture = Texture.of(colour, points, camera)
    # its x is the depth camera's y, its y is minus x
    expected = [[(40 + 7 + 0.5) / 80, (30 - 3.5 + 0.5) / 60], [40.5 / 80, 30.5 / 60]]
    np.testing.assert_allclose(texture.place[:2], expected, atol=1e-12)
    assert texture.seen.tolist() == [True, True, False, False]
    assert not colour.aligned(camera) and FrameColour(RGB, ColourCamera(DEPTH)).aligned(camera)


@pytest.mark.parametrize(
    ("find", "words"),
    [
        (None, "no colour images of this sensor in a known encoding"),
        (lambda lag_s: None, "no colour image at this time"),
        (partial(colour_image, data=b"nothing"), "the colour image cannot be read or decoded"),
        (
            partial(colour_image, camera=ColourCamera()),
            "the intrinsics of the colour camera are not known",
        ),
    ],
)
def test_missing_data_are_reported(find, words):
    frame = default_press(load_sensor(SYNTHETIC_SENSOR))[0]
    seen = FrameColour.of(replace(frame, find_colour=find))
    texture = Texture.of(seen, np.zeros((3, 3)), DepthCamera(DEPTH, T_B_C))
    assert texture.reason == words and not texture.seen.any()


def test_the_pipeline_decodes_only_when_the_texture_is_asked_for():
    press = default_press(load_sensor(SYNTHETIC_SENSOR))
    pipeline, found = Pipeline.of(press.sensor), []

    def find(lag_s):
        found.append(1)
        return colour_image(camera=ColourCamera(pipeline.camera.intrinsics))

    frame = replace(press[0], find_colour=find)
    assert pipeline.process(frame, frozenset({"patch"})).texture is None and not found
    result = pipeline.process(frame, frozenset({"texture"}))
    assert len(found) == 1 and pipeline.counts["texture"] == 1
    np.testing.assert_array_equal(result.texture.colour.rgb, RGB)
    outside = np.any(np.abs(result.texture.place - 0.5) > 0.5, axis=1)
    np.testing.assert_array_equal(result.texture.seen, ~outside)
