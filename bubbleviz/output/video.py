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
from bubbleviz.wording import width_by_height

_CRF = 15  # of 51, 0 being lossless: text stays legible


class Mp4Writer:
    """Encodes pictures one after the other; created by `open_mp4`.

    ffmpeg runs in its own process group, so that ^C does not reach it. imageio-ffmpeg is not used
    for that: it runs Python code after a fork, where SciPy's factorisations in other threads print
    a traceback (scipy#25404).
    """

    def __init__(
        self,
        path: Path,  # for error messages
        temporary: Path,  # output file
        fps: float,
        messages: IO[bytes],  # for the encoder's messages
    ) -> None:
        self._path, self._temporary, self._fps = path, temporary, fps
        self._messages = messages
        self._shape: tuple[int, ...] = ()
        self._encoder: subprocess.Popen[bytes] | None = None

    def add(self, picture: np.ndarray) -> None:
        """Append a picture, (H, W, 3) uint8, all of one size.

        The last line of an odd side is repeated: H.264 requires even sizes.
        """
        if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
            raise ValueError(f"a picture is (H, W, 3) uint8, not {picture.shape} {picture.dtype}")
        odd = [(0, side % 2) for side in picture.shape[:2]]
        even = np.ascontiguousarray(np.pad(picture, (*odd, (0, 0)), mode="edge"))
        if self._encoder is None:
            self._shape, self._encoder = picture.shape, self._started(even)
        elif picture.shape != self._shape:
            raise InputError(
                f"{self._path}: a picture is {width_by_height(picture.shape)} pixels, the first "
                f"{width_by_height(self._shape)}; keep the size of the view while the video is "
                "written"
            )
        assert self._encoder.stdin is not None
        try:
            self._encoder.stdin.write(even.data)
        except OSError as error:
            self._encoder.wait()
            raise self._failure(str(error)) from error

    def finish(self) -> None:
        """Wait until the encoder has written its last pictures."""
        if self._encoder is None:
            raise InputError(f"{self._path}: no frames for the video; choose at least one")
        try:
            self._encoder.communicate()
        except OSError as error:
            raise self._failure(str(error)) from error
        if self._encoder.returncode:
            raise self._failure(f"ended with code {self._encoder.returncode}")

    def abandon(self) -> None:
        """Kill the encoder; its output is invalid."""
        if self._encoder is not None:
            self._encoder.kill()
            self._encoder.communicate()

    def _started(self, picture: np.ndarray) -> subprocess.Popen[bytes]:
        from imageio_ffmpeg import get_ffmpeg_exe  # only where a video is written

        height, width, _ = picture.shape
        pictures = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}"]
        rate = ["-r", str(Fraction(self._fps).limit_denominator())]
        playable = ["-c:v", "libx264", "-crf", str(_CRF), "-pix_fmt", "yuv420p"]  # in browsers
        arguments = ["-v", "error", "-y", *pictures, *rate, "-i", "-", *playable]
        try:
            return subprocess.Popen(
                [get_ffmpeg_exe(), *arguments, str(self._temporary)],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=self._messages,
                process_group=0,
            )
        except (OSError, RuntimeError) as error:  # RuntimeError: there is no ffmpeg
            raise self._failure(str(error)) from error

    def _failure(self, default: str) -> InputError:
        """Error with the encoder's first message, without its prefix such as [libx264 @ 0x55…]."""
        self._messages.seek(0)
        first = self._messages.readline().decode(errors="replace")
        message = re.sub(r"\[[^\]]*\]", "", first).strip() or default
        reason = " ".join(message.split())[:200]
        return InputError(
            f"{self._path}: ffmpeg cannot write the video ({reason}); check free space, folder, "
            "picture size and the installation of imageio-ffmpeg"
        )


@contextmanager
def open_mp4(
    path: str | Path,  # must not exist
    fps: float,  # pictures a second
) -> Iterator[Mp4Writer]:
    """Writer of a video; the file appears only if the block ends without an error.

    Raises InputError: `path` exists, does not end in .mp4 or cannot be written, or no picture was
    added.
    """
    path = Path(path)
    if not 0.0 < fps <= 1000.0:
        raise InputError(f"{path}: {fps:g} pictures per second; choose above 0, up to 1000")
    with whole_file(path, ".mp4") as temporary, tempfile.TemporaryFile() as messages:
        writer = Mp4Writer(path, temporary, fps, messages)
        try:
            yield writer
        except BaseException:
            writer.abandon()
            raise
        writer.finish()
