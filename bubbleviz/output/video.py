"""MP4 from pictures, such as the window's view frame by frame."""

from __future__ import annotations

import re
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import IO

import numpy as np

from bubbleviz.errors import InputError
from bubbleviz.files import whole_file

_CRF = 15  # of 51, 0 being lossless: text stays legible


class Mp4Writer:
    """Takes pictures one after the other; made by `open_mp4`."""

    def __init__(
        self,
        path: Path,  # as messages name it
        temporary: Path,  # where to write
        fps: float,
        messages: IO[bytes],  # for the encoder's messages
    ) -> None:
        self._path, self._temporary, self._fps = path, temporary, fps
        self._messages = messages
        self._shape: tuple[int, ...] | None = None
        self._encoder: _Encoder | None = None

    def add(self, picture: np.ndarray) -> None:
        """Append a picture, (H, W, 3) uint8, all of one size.

        An odd side grows by a copy of its last line: H.264 wants even ones.
        """
        if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
            raise ValueError(f"a picture is (H, W, 3) uint8, not {picture.shape} {picture.dtype}")
        even = np.ascontiguousarray(_even(picture))
        with self._refusals():
            if self._encoder is None:
                self._shape = picture.shape
                size = even.shape[1::-1]
                self._encoder = _Encoder(self._temporary, size, self._fps, self._messages)
            elif picture.shape != self._shape:
                raise InputError(
                    f"{self._path}: a picture is {_by(picture.shape)} pixels, the first "
                    f"{_by(self._shape)}; keep the size of the view while the video is written"
                )
            self._encoder.add(even)

    def finish(self) -> None:
        """Let the encoder write its last pictures."""
        if self._encoder is None:
            raise InputError(f"{self._path}: no picture to make a video of; choose some frames")
        with self._refusals():
            self._encoder.finish()

    def abandon(self) -> None:
        """End the encoder; what it wrote is of no use."""
        if self._encoder is not None:
            self._encoder.kill()

    @contextmanager
    def _refusals(self) -> Iterator[None]:
        try:
            yield
        except (OSError, RuntimeError) as error:  # RuntimeError: there is no ffmpeg
            reason = " ".join(str(error).split())[:200]
            raise InputError(
                f"{self._path}: ffmpeg cannot write it ({reason}); choose another place"
            ) from error


class _Encoder:
    """A process of ffmpeg; OSError with its first message where it fails.

    It has a process group of its own, so that ^C does not reach it. By hand because imageio-ffmpeg,
    and imageio with it, does this with Python code after a fork, where SciPy's factorisations of
    other threads print a traceback (scipy#25404).
    """

    def __init__(self, path: Path, size: tuple[int, ...], fps: float, messages: IO[bytes]) -> None:
        from imageio_ffmpeg import get_ffmpeg_exe  # only where a video is written

        width, height = size
        pictures = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}"]
        rate = ["-r", str(Fraction(fps).limit_denominator())]
        playable = ["-c:v", "libx264", "-crf", str(_CRF), "-pix_fmt", "yuv420p"]  # in browsers
        self._messages = messages
        self._process = subprocess.Popen(
            [get_ffmpeg_exe(), "-v", "error", "-y", *pictures, *rate, "-i", "-", *playable, path],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=messages,
            process_group=0,
        )

    def add(self, picture: np.ndarray) -> None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(picture.data)
        except OSError as error:
            self._process.wait()
            raise OSError(self._first_message() or str(error)) from error

    def finish(self) -> None:
        self._process.communicate()
        code = self._process.returncode
        if code:
            raise OSError(self._first_message() or f"it ended with code {code}")

    def kill(self) -> None:
        self._process.kill()
        self._process.communicate()

    def _first_message(self) -> str:
        """Without the part of ffmpeg that says it: [libx264 @ 0x55…]."""
        self._messages.seek(0)
        first = self._messages.readline().decode(errors="replace")
        return re.sub(r"\[[^\]]*\]", "", first).strip()


@contextmanager
def open_mp4(
    path: str | Path,  # must not exist
    fps: float,  # pictures a second
) -> Iterator[Mp4Writer]:
    """Writer of a video that is there when the block ends without an error, and else is not.

    Raises InputError: `path` exists, does not end in .mp4 or cannot be written, or no picture came.
    """
    path = Path(path)
    if path.suffix.lower() != ".mp4":
        raise InputError(f"{path}: a video ends in .mp4; rename it")
    if not 0.0 < fps <= 1000.0:
        raise InputError(f"{path}: {fps:g} pictures a second; choose from 1 to 1000")
    with whole_file(path) as temporary, tempfile.TemporaryFile() as messages:
        writer = Mp4Writer(path, temporary, fps, messages)
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
