"""Colour images are decoded by their encoding; invalid ones are refused in one sentence."""

from types import SimpleNamespace

import numpy as np
import pytest

from bubbleviz.camera import ColourImage, EncodedImage
from bubbleviz.errors import InputError
from tests.colour.colour_bag import encoded, picture

RGB = picture(3)
ALPHA = np.full((*RGB.shape[:2], 1), 77, np.uint8)
LAYOUTS = {
    "rgb8": RGB,
    "bgr8": RGB[..., ::-1],
    "rgba8": np.concatenate([RGB, ALPHA], axis=2),
    "bgra8": np.concatenate([RGB[..., ::-1], ALPHA], axis=2),
}


def raw(pixels, encoding, padding=0):
    """An Image message whose rows are longer than its pixels."""
    height, width = pixels.shape[:2]
    rows = pixels.reshape(height, -1)
    padded = np.pad(rows, ((0, 0), (0, padding)), constant_values=255)
    return SimpleNamespace(
        encoding=encoding, width=width, height=height, step=padded.shape[1], data=padded.ravel()
    )


def image(message):
    return ColourImage(lambda: EncodedImage.of(message))


@pytest.mark.parametrize("encoding", LAYOUTS)
def test_every_layout_gives_its_colours(encoding):
    found = image(raw(np.ascontiguousarray(LAYOUTS[encoding]), encoding, padding=5))
    np.testing.assert_array_equal(found.rgb(), RGB)
    brightness = RGB @ np.array([0.299, 0.587, 0.114])
    np.testing.assert_allclose(found.grey(), brightness, atol=1.0)
    assert found.grey().dtype == np.uint8


def test_grey_image_has_equal_channels():
    found = image(raw(RGB[..., 0], "mono8", padding=3))
    np.testing.assert_array_equal(found.grey(), RGB[..., 0])
    np.testing.assert_array_equal(found.rgb(), np.repeat(RGB[..., :1], 3, axis=2))


@pytest.mark.parametrize("said", ["jpeg", "jpg", "rgb8; jpeg compressed bgr8"])
def test_jpeg_is_decoded_approximately(said):
    data = np.frombuffer(encoded(RGB, "jpeg"), np.uint8)
    found = image(SimpleNamespace(format=said, data=data))
    np.testing.assert_allclose(found.rgb(), RGB.astype(float), atol=6.0)
    np.testing.assert_allclose(found.grey(), RGB @ np.array([0.299, 0.587, 0.114]), atol=3.0)


def test_png_is_decoded_exactly():
    data = np.frombuffer(encoded(RGB, "png"), np.uint8)
    found = image(SimpleNamespace(format="bgr8; png compressed bgr8", data=data))
    np.testing.assert_array_equal(found.rgb(), RGB)


def test_images_are_read_on_demand():
    def read():
        raise AssertionError("read")

    found = ColourImage(read)
    with pytest.raises(AssertionError, match="read"):
        found.grey()


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (raw(RGB, "rgb8").__dict__ | {"data": RGB.ravel()[:-9]}, "bytes with a row step of 96"),
        (raw(RGB, "rgb8").__dict__ | {"width": 10**7}, "a side"),
        ({"format": "jpeg", "data": np.frombuffer(b"garbage", np.uint8)}, "neither JPEG nor PNG"),
        ({"format": "jpeg", "data": np.frombuffer(encoded(RGB, "jpeg")[:-200], np.uint8)}, "trunc"),
        (
            {
                "format": "png",
                "data": np.frombuffer(encoded(RGB[..., 0].astype(np.uint16), "png"), np.uint8),
            },
            "more than 8 bits",
        ),
    ],
)
def test_undecodable_image_gives_a_reason(message, why):
    with pytest.raises(InputError, match=why):
        image(SimpleNamespace(**message)).rgb()


def test_compressed_depth_is_not_a_colour_image():
    message = SimpleNamespace(format="16UC1; compressedDepth png", data=np.zeros(4, np.uint8))
    with pytest.raises(ValueError, match="not one of rgb8"):
        EncodedImage.of(message)
