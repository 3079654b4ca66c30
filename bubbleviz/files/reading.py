"""Reading untrusted files: all errors become InputError, sizes are bounded."""

from __future__ import annotations

import hashlib
import math
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np

from bubbleviz.errors import InputError
from bubbleviz.wording import reason_of

MAX_ARRAY_BYTES = 1 << 30  # of one file, decompressed: 870 images of 640×480 pixels


@contextmanager
def as_input_error(
    path: str | Path,
    what: str,
    remedy: str = "",  # empty: that for a recording
) -> Iterator[None]:
    """Convert any exception that a damaged file causes in a reader to InputError."""
    try:
        yield
    except InputError:
        raise
    except ModuleNotFoundError:
        raise  # the command line says how to install it
    except Exception as error:
        reason = reason_of(error, 200).partition(": (")[0].rstrip(".")  # rosbags adds a tuple
        if isinstance(error, AssertionError | UnicodeError):
            text = remedy and isinstance(error, UnicodeError)
            reason = "it is not UTF-8 text" if text else "some of its bytes are damaged"
        if isinstance(error, MemoryError):  # libraries allocate whatever size they read
            reason = "a size in it is damaged, or too little memory is free"
        if isinstance(error, KeyError):
            reason = f"no entry {reason}"
        if isinstance(error, RecursionError):
            reason = "it is nested too deeply"
        if isinstance(error, PermissionError):
            remedy = "allow reading it"
        if isinstance(error, IsADirectoryError):
            reason, remedy = "it is a folder", "give a file"
        remedy = remedy or "copy the recording again, or record again without that problem"
        raise InputError(f"{path}: {what} cannot be read ({reason}); {remedy}") from error


def exists(path: Path) -> bool:
    """Whether a file exists; False for invalid names."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


def read_npy(file: IO[bytes], size: int) -> np.ndarray:
    """Array of a `.npy` file of a given size.

    Raises ValueError: the array is larger than the file, or not of numbers or texts.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of headers written by Python 2
        version = np.lib.format.read_magic(file)
        if version not in ((1, 0), (2, 0)):
            raise ValueError(f"its .npy version is {version[0]}.{version[1]}, not 1.0 or 2.0")
        header = "read_array_header_1_0" if version == (1, 0) else "read_array_header_2_0"
        shape, _, dtype = getattr(np.lib.format, header)(file)
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize > min(size, MAX_ARRAY_BYTES):
        most = f"{MAX_ARRAY_BYTES >> 20} MiB"
        raise ValueError(f"an array of shape {shape} is larger than the file or than {most}")
    if dtype.kind not in "biufUS":
        raise ValueError(f"values of {dtype} are neither numbers nor texts")
    file.seek(0)
    return np.asarray(np.lib.format.read_array(file, allow_pickle=False))


def read_npz(path: str | Path) -> dict[str, np.ndarray]:
    """Arrays of an `.npz` file by name; checks the size before decompression.

    Raises ValueError and exceptions of `zipfile`; use it in `as_input_error`.
    """
    with zipfile.ZipFile(path) as archive:
        members = [each for each in archive.infolist() if each.filename.endswith(".npy")]
        if sum(each.file_size for each in members) > MAX_ARRAY_BYTES:
            raise ValueError(f"its arrays together exceed the limit of {MAX_ARRAY_BYTES >> 20} MiB")
        return {each.filename.removesuffix(".npy"): _member(archive, each) for each in members}


def _member(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> np.ndarray:
    with archive.open(info) as file:
        return read_npy(file, info.file_size)


def plain_numbers(array: Any) -> np.ndarray:
    """An array of real numbers as float64 in native byte order. Raises ValueError: other types."""
    array = np.asarray(array)
    if array.dtype.kind not in "biuf":
        raise ValueError(f"values of {array.dtype} are not numbers")
    return array.astype(np.float64)


def file_hash(path: str | Path) -> str:
    """SHA-256 of a file, or of the concatenated files in a folder, sorted by name."""
    path = Path(path)
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    digest = hashlib.sha256()
    for each in files:
        with each.open("rb") as stream:
            while chunk := stream.read(1 << 20):
                digest.update(chunk)
    return digest.hexdigest()
