"""Colour images in files: those of a folder, by the numbers in their names."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from bubbleviz.camera.intrinsics import Intrinsics
from bubbleviz.colour.colour_image import ColourImage, EncodedImage
from bubbleviz.colour.colour_topics import colour_camera
from bubbleviz.errors import InputError

FOLDERS = ("color", "colour", "rgb")
"""What a folder of them beside depth images is called."""
_ENCODINGS = {".jpg": "jpeg", ".jpeg": "jpeg", ".png": "png"}


class ColourFolder:
    """The JPEG and PNG files of a folder.

    Parameters
    ----------
    folder : Path
    number_of : callable
        Number of an image by the stem of its name, or None.
    intrinsics : Intrinsics or None
        Of their camera.

    Attributes
    ----------
    path : Path
    numbers : set
        Those there are.
    """

    def __init__(
        self,
        folder: Path,
        number_of: Callable[[str], float | None],
        intrinsics: Intrinsics | None,
    ) -> None:
        self.path = folder
        self._files: dict[float, Path] = {}
        for path in sorted(folder.iterdir()):
            number = number_of(path.stem)
            if path.suffix.lower() not in _ENCODINGS or number is None:
                continue
            if number in self._files:
                raise InputError(f"{path}: has the number of {self._files[number].name}; leave one")
            self._files[number] = path
        self.numbers = set(self._files)
        self._camera = colour_camera(intrinsics, None, own=intrinsics is not None)

    def image(self, number: float | None, time_s: float) -> ColourImage | None:
        """The image with a number, taken at a time, s; None where there is none."""
        path = None if number is None else self._files.get(number)
        if path is None:
            return None
        return ColourImage(lambda: _read(path), round(1e9 * time_s), time_s, self._camera)


def _read(path: Path) -> EncodedImage:
    try:
        return EncodedImage(_ENCODINGS[path.suffix.lower()], path.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
