"""MP4 from pictures, such as the window's view frame by frame."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from bubbleviz.errors import InputError
from bubbleviz.files.output_files import whole_file

_QUALITY = 7.0  # of 10: text stays legible


class Mp4Writer:
    """Takes pictures one after the other; made by `open_mp4`.

    Parameters
    ----------
    path : Path
        As messages name it.
    temporary : Path
        Where to write.
    fps : float
    """

    def __init__(self, path: Path, temporary: Path, fps: float) -> None:
        self._path, self._temporary, self._fps = path, temporary, fps
        self._shape: tuple[int, ...] | None = None
        self._encoder: Generator[None, Any, None] | None = None

    def add(self, picture: np.ndarray) -> None:
        """Append a picture, (H, W, 3) uint8, all of one size.

        An odd side grows by a copy of its last line: H.264 wants even ones.
        """
        if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
            raise ValueError(f"a picture is (H, W, 3) uint8, not {picture.shape} {picture.dtype}")
        if self._encoder is None:
            self._shape, self._encoder = picture.shape, self._started(picture)
        elif picture.shape != self._shape:
            raise InputError(
                f"{self._path}: a picture is {_by(picture.shape)} pixels, the first "
                f"{_by(self._shape)}; keep the size of the view while the video is written"
            )
        with self._refusals():
            self._encoder.send(np.ascontiguousarray(_even(picture)))

    def finish(self) -> None:
        """Let the encoder write its last pictures."""
        if self._encoder is None:
            raise InputError(f"{self._path}: no picture to make a video of; choose some frames")
        with self._refusals():
            self._encoder.close()
        if not self._temporary.is_file() or not self._temporary.stat().st_size:
            raise InputError(f"{self._path}: the encoder wrote nothing; choose another place")

    def abandon(self) -> None:
        """End the encoder; what it wrote is of no use."""
        if self._encoder is not None:
            self._encoder.close()

    def _started(self, picture: np.ndarray) -> Generator[None, Any, None]:
        import imageio_ffmpeg  # only where a video is written

        height, width = _even(picture).shape[:2]
        with self._refusals():
            encoder = imageio_ffmpeg.write_frames(
                str(self._temporary),
                (width, height),
                fps=self._fps,
                quality=_QUALITY,
                macro_block_size=2,
                codec="libx264",
                pix_fmt_out="yuv420p",  # what browsers and slides play
                ffmpeg_log_level="error",
            )
            encoder.send(None)
        return encoder

    @contextmanager
    def _refusals(self) -> Iterator[None]:
        try:
            yield
        except (OSError, RuntimeError) as error:
            reason = " ".join(str(error).split())[:200]
            raise InputError(
                f"{self._path}: ffmpeg cannot write it ({reason}); choose another place"
            ) from error


@contextmanager
def open_mp4(path: str | Path, fps: float) -> Iterator[Mp4Writer]:
    """Writer of a video that is there when the block ends without an error, and else is not.

    Parameters
    ----------
    path : path
        Must not exist.
    fps : float
        Pictures a second.

    Raises
    ------
    InputError
        `path` exists, does not end in .mp4 or cannot be written, or no picture came.
    """
    path = Path(path)
    if path.suffix.lower() != ".mp4":
        raise InputError(f"{path}: a video ends in .mp4; rename it")
    if not 0.0 < fps <= 1000.0:
        raise InputError(f"{path}: {fps:g} pictures a second; choose from 1 to 1000")
    with whole_file(path) as temporary:
        writer = Mp4Writer(path, temporary, fps)
        try:
            yield writer
        except BaseException:
            writer.abandon()
            raise
        writer.finish()


def _even(picture: np.ndarray) -> np.ndarray:
    height, width = picture.shape[:2]
    return np.pad(picture, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")


def _by(shape: tuple[int, ...] | None) -> str:
    return "unknown" if shape is None else f"{shape[1]}×{shape[0]}"
