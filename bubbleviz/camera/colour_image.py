"""Encoded colour image, decoded on demand."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from PIL import Image, UnidentifiedImageError

from bubbleviz.camera.intrinsics import Intrinsics
from bubbleviz.errors import InputError
from bubbleviz.wording import reason_of

RAW_ENCODINGS = {"rgb8": "RGB", "bgr8": "BGR", "rgba8": "RGBX", "bgra8": "BGRX", "mono8": "L"}
"""Encodings of a `sensor_msgs/Image` in colour or grey, as Pillow calls their layout."""
COMPRESSED_ENCODINGS = ("jpeg", "png")  # of a `sensor_msgs/CompressedImage`

MAX_SIDE = 10_000  # pixels; no camera in a bubble has more


def check_rows(width: int, height: int, step: int, pixel_bytes: int, size: int) -> None:
    """Raise ValueError unless `size` bytes can be an image with rows of `step` bytes."""
    if not (0 < height <= MAX_SIDE and 0 < width <= MAX_SIDE):
        raise ValueError(f"{width}×{height} pixels, not 1 to {MAX_SIDE} a side")
    if step < width * pixel_bytes or height * step > size:
        raise ValueError(f"{size} bytes with a row step of {step} are not a {width}×{height} image")


@dataclass(frozen=True)
class EncodedImage:
    encoding: str  # one of `RAW_ENCODINGS` or of `COMPRESSED_ENCODINGS`
    data: bytes
    # width, height, step: pixels, pixels and bytes a row of a raw image; 0 for a compressed one
    width: int = 0
    height: int = 0
    step: int = 0

    @classmethod
    def of(cls, message: Any) -> EncodedImage:
        """Pixels of a `sensor_msgs/Image` or a `sensor_msgs/CompressedImage`.

        Raises ValueError: the encoding is not of a colour or grey image.
        """
        encoding = encoding_of(message)
        if encoding is None:
            given = str(getattr(message, "encoding", "") or message.format)[:40]
            known = ", ".join((*RAW_ENCODINGS, *COMPRESSED_ENCODINGS))
            raise ValueError(f"encoding is {given!r}, not one of {known}")
        data = np.asarray(message.data, np.uint8).tobytes()
        if encoding in COMPRESSED_ENCODINGS:
            return cls(encoding, data)
        return cls(encoding, data, int(message.width), int(message.height), int(message.step))

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, pixels; ValueError where there is no image."""
        if self.encoding in RAW_ENCODINGS:
            return self.width, self.height
        return self._compressed("L").size

    def pixels(self, mode: str) -> np.ndarray:
        """Pixels in a mode of Pillow: (H, W, 3) uint8 for `RGB`, (H, W) uint8 for `L`.

        Raises ValueError: encoding, size and data are inconsistent.
        """
        image = self._raw() if self.encoding in RAW_ENCODINGS else self._compressed(mode)
        return np.asarray(image if image.mode == mode else image.convert(mode))

    def _raw(self) -> Image.Image:
        width, height, step = self.width, self.height, self.step
        layout = RAW_ENCODINGS[self.encoding]
        check_rows(width, height, step, len(layout), len(self.data))
        mode = "L" if layout == "L" else "RGB"
        return Image.frombuffer(mode, (width, height), self.data, "raw", layout, step, 1)

    def _compressed(self, mode: str) -> Image.Image:
        try:
            image = Image.open(io.BytesIO(self.data), formats=("JPEG", "PNG"))
        except UnidentifiedImageError as error:
            raise ValueError("the data are neither JPEG nor PNG") from error
        if max(image.size) > MAX_SIDE:
            raise ValueError(f"{image.width}×{image.height} pixels are more than {MAX_SIDE} a side")
        if image.mode.startswith("I") or image.mode == "F":
            raise ValueError("it has more than 8 bits a channel, as compressed depth has")
        image.draft(mode, image.size)  # a JPEG stores brightness separately
        return image


def encoding_of(message: Any) -> str | None:
    """Encoding of a message for `EncodedImage`; None if it is not a colour or grey image."""
    if hasattr(message, "encoding"):
        return message.encoding if message.encoding in RAW_ENCODINGS else None
    text = str(message.format).lower().replace("jpg", "jpeg")  # `bgr8; jpeg compressed bgr8`
    if "compresseddepth" in text:
        return None
    return next((name for name in COMPRESSED_ENCODINGS if name in text), None)


@dataclass(frozen=True)
class ColourCamera:
    intrinsics: Intrinsics | None = None
    # (4, 4), pose of the colour camera in the depth camera, both in the optical convention
    T_D_C: np.ndarray = field(default_factory=lambda: np.eye(4))
    remark: str = ""  # assumptions about values that were not recorded; empty for none
    own: bool = True  # whether the intrinsics are its own, not the depth camera's
    placed: bool = True  # whether `T_D_C` is known, not assumed


@dataclass(frozen=True)
class ColourImage:
    """A colour image, read and decoded on demand."""

    # reads the message's image; InputError if it cannot be read
    read: Callable[[], EncodedImage]
    stamp_ns: int = 0  # the message's own time stamp
    time_s: float = 0.0  # on the clock of the frames, s
    camera: ColourCamera = field(default_factory=ColourCamera)

    def rgb(self) -> np.ndarray:
        """Red, green and blue, (H, W, 3) uint8; InputError where it cannot be decoded."""
        return self._pixels("RGB")

    def grey(self) -> np.ndarray:
        """Brightness (ITU-R 601), (H, W) uint8; InputError where it cannot be decoded."""
        return self._pixels("L")

    def _pixels(self, mode: str) -> np.ndarray:
        encoded = self.read()
        try:
            return encoded.pixels(mode)
        except (ValueError, OSError, SyntaxError) as error:  # Pillow raises all of them
            why = reason_of(error, 160)
            raise InputError(
                f"colour image at {self.time_s:.3f} s: cannot be decoded ({why}); record raw, JPEG "
                "or PNG images of 8 bits a channel"
            ) from error


def readable(images: Mapping[int, ColourImage]) -> dict[int, np.ndarray]:
    """Grey images (H, W) uint8 of those that can be decoded and have the commonest size."""
    greys: dict[int, np.ndarray] = {}
    for key, image in images.items():
        try:
            greys[key] = image.grey()
        except InputError:  # skip damaged images
            continue
    sizes = Counter(grey.shape for grey in greys.values()).most_common(1)
    return {key: grey for key, grey in greys.items() if grey.shape == sizes[0][0]}
