"""OpenCV, which only optical flow needs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from bubbleviz.errors import InputError
from bubbleviz.wording import how_to_install


def opencv() -> Any:
    """The module `cv2`; InputError where it is not installed."""
    try:
        import cv2  # an optional extra
    except ImportError as error:
        raise InputError(
            f"optical flow: OpenCV is not installed; {how_to_install('colour')}"
        ) from error
    return cv2


@contextmanager
def one_thread() -> Iterator[None]:
    """OpenCV uses the calling thread alone: its pool would compete with what runs beside it."""
    cv2 = opencv()
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
