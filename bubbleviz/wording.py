"""Parts of messages that several places share."""

from __future__ import annotations

from pathlib import Path


def count_of(number: int, noun: str) -> str:
    """`1 file`, `2 files`: for nouns whose plural ends in s."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def how_to_install(extra: str) -> str:
    """Command that installs an optional part, from this checkout or from a package index."""
    checkout = Path(__file__).parents[1]
    if (checkout / "pyproject.toml").is_file():
        return f'pip install -e "{checkout}[{extra}]"'
    return f'pip install "bubbleviz[{extra}]"'
