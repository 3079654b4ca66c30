"""Parts of messages that several places share."""

from __future__ import annotations

import math
from pathlib import Path


def count_of(number: int, noun: str) -> str:
    """`1 file`, `2 files`: for nouns whose plural ends in s."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def decimals_of(half_width: float, most: int) -> int:
    """Decimals that show an uncertainty to two significant digits, or fewer: more say nothing.

    Less than 0 where tens or hundreds are already uncertain. Source: JCGM 100:2008 (GUM), 7.2.6.
    """
    if not half_width > 0.0:
        return most
    return min(most, 1 - math.floor(math.log10(half_width)))


def rounded(number: float, decimals: int) -> str:
    """The number as text, to decimals that may be below 0; never -0."""
    return f"{round(number, decimals) + 0.0:.{max(decimals, 0)}f}"


def how_to_install(extra: str) -> str:
    """Command that installs an optional part, from this checkout or from a package index."""
    checkout = Path(__file__).parents[1]
    if (checkout / "pyproject.toml").is_file():
        return f'pip install -e "{checkout}[{extra}]"'
    return f'pip install "bubbleviz[{extra}]"'


def encodable(text: str) -> str:
    r"""Text that can be written as UTF-8: of a file name that is none, `\udcff` as in JSON."""
    return text.encode(errors="backslashreplace").decode()
