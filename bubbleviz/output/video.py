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
    """Takes pictures one after the other; made by `open_mp4`.

    ffmpeg has a process group of its own, so that ^C does not reach it. By hand because
    imageio-ffmpeg, and imageio with it, does this with Python code after a fork, where SciPy's
    factorisations of other threads print a traceback (scipy#25404).
    """

    def __init__(
        self,
        path: Path,  # as messages name it
        temporary: Path,  # where to write
        fps: float,
        messages: IO[bytes],  # for the encoder's messages
    ) -> None:
        self._path, self._temporary, self._fps = path, temporary, fps
        self._messages = messages
        self._shape: tuple[int, ...] = ()
        self._encoder: subprocess.Popen[bytes] | None = None

    def add(self, picture: np.ndarray) -> None:
        """Append a picture, (H, W, 3) uint8, all of one size.

        An odd side grows by a copy of its last line: H.264 wants even ones.
        """
        if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
            raise ValueError(f"a picture is (H, W, 3) uint8, not {picture.shape} {picture.dtype}")
        even = np.ascontiguousarray(_even(picture))
        if self._encoder is None:
            self._shape, self._encoder = picture.shape, self._started(even)
        elif picture.shape != self._shape:
            raise InputError(
                f"{self._path}: a picture is {_by(picture.shape)} pixels, the first "
                f"{_by(self._shape)}; keep the size of the view while the video is written"
            )
        assert self._encoder.stdin is not None
        try:
            self._encoder.stdin.write(even.data)
        except OSError as error:
            self._encoder.wait()
            raise self._refused(str(error)) from error

    def finish(self) -> None:
        """Let the encoder write its last pictures."""
        if self._encoder is None:
            raise InputError(f"{self._path}: no frames to make a video of; choose some")
        try:
            self._encoder.communicate()
        except OSError as error:
            raise self._refused(str(error)) from error
        if self._encoder.returncode:
            raise self._refused(f"it ended with code {self._encoder.returncode}")

    def abandon(self) -> None:
        """End the encoder; what it wrote is of no use."""
        if self._encoder is not None:
            self._encoder.kill()
            self._encoder.communicate()

    def _started(self, picture: np.ndarray) -> subprocess.Popen[bytes]:
        from imageio_ffmpeg import get_ffmpeg_exe  # only where a video is written

        height, width, _ = picture.shape
        pictures = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}"]
        rate = ["-r", str(Fraction(self._fps).limit_denominator())]
        playable = ["-c:v", "libx264", "-crf", str(_CRF), "-pix_fmt", "yuv420p"]  # in browsers
        words = ["-v", "error", "-y", *pictures, *rate, "-i", "-", *playable, str(self._temporary)]
        try:
            return subprocess.Popen(
                [get_ffmpeg_exe(), *words],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=self._messages,
                process_group=0,
            )
        except (OSError, RuntimeError) as error:  # RuntimeError: there is no ffmpeg
            raise self._refused(str(error)) from error

    def _refused(self, otherwise: str) -> InputError:
        """The encoder's first message, without the part of it that says it: [libx264 @ 0x55…]."""
        self._messages.seek(0)
        first = self._messages.readline().decode(errors="replace")
        said = re.sub(r"\[[^\]]*\]", "", first).strip() or otherwise
        reason = " ".join(said.split())[:200]
        return InputError(f"{self._path}: ffmpeg cannot write it ({reason}); choose another place")


@contextmanager
def open_mp4(
    path: str | Path,  # must not exist
    fps: float,  # pictures a second
) -> Iterator[Mp4Writer]:
    """Writer of a video that is kept only if the block ends without an error.

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


def _by(shape: tuple[int, ...]) -> str:
    return f"{shape[1]}×{shape[0]}"
