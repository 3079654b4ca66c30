"""Functions that format numbers and texts in messages."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path


def count_of(number: int, noun: str) -> str:
    """`1 file`, `2 files`: for nouns whose plural ends in s."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def counted(numbers: Mapping[str, int]) -> str:
    """Numbers by name as text: `3 ok, 1 no_contact`."""
    return ", ".join(f"{number} {name}" for name, number in numbers.items())


def minutes_and_seconds(seconds: float) -> str:
    """`12:05`: a duration without fractions of a second."""
    return "{:02d}:{:02d}".format(*divmod(int(seconds), 60))


def decimals_of(half_width: float, most: int) -> int:
    """Decimals that show an uncertainty to two significant digits, at most `most`.

    Negative where tens or hundreds are uncertain. Source: JCGM 100:2008 (GUM), 7.2.6.
    """
    if not half_width > 0.0:
        return most
    return min(most, 1 - math.floor(math.log10(half_width)))


def rounded(number: float, decimals: int) -> str:
    """The number as text, rounded to decimals that may be negative; never -0."""
    return f"{round(number, decimals) + 0.0:.{max(decimals, 0)}f}"


def plus_minus(value: float, half_width: float, most: int) -> str:
    """`0.804 ± 0.021`: rounded to two significant digits of the half width, or `most` decimals.

    The half width is shown as 0 only if it is exactly 0.
    """
    shown = max(half_width, 10.0**-most) if half_width > 0.0 else half_width
    decimals = decimals_of(shown, most)
    return f"{rounded(value, decimals)} ± {rounded(shown, decimals)}"


def reason_of(error: BaseException, most: int | None = None) -> str:
    """Message of an exception in one line of at most so many letters; its class if it has none."""
    return " ".join(str(error).split())[:most] or type(error).__name__


def width_by_height(shape: Sequence[int]) -> str:
    """`640×480` for the shape (480, 640, …) of an image."""
    return size_text(shape[1::-1])


def size_text(size: Sequence[int]) -> str:
    """`640×480` for a width and a height."""
    return f"{size[0]}×{size[1]}"


def how_to_install(extra: str) -> str:
    """Command that installs an optional extra, from this checkout or from a package index."""
    checkout = Path(__file__).parents[1]
    if (checkout / "pyproject.toml").is_file():
        return f'pip install -e "{checkout}[{extra}]"'
    return f'pip install "bubbleviz[{extra}]"'


def encodable(text: str) -> str:
    r"""Text that can be encoded in UTF-8; invalid characters of file names become `\udcff`."""
    return text.encode(errors="backslashreplace").decode()
