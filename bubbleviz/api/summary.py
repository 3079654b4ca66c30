"""Base class of what an API function reports: text and JSON."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import asdict
from typing import Any

from bubbleviz.files import to_json


class Summary(ABC):
    """Facts of what was done; a frozen dataclass, unless `facts` is overridden.

    One that can warn has a `warning`: what is missing or does not fit together, but was used all
    the same.
    """

    def facts(self) -> dict[str, Any]:
        """What `to_json` has: SI units but for ms, None for numbers that are not known."""
        return asdict(self)  # type: ignore[call-overload]

    def to_json(self) -> str:
        """The facts as a JSON object."""
        return to_json(self.facts())

    @abstractmethod
    def to_text(self) -> str:
        """Text for the terminal, with units."""


def counted(status: dict[str, int]) -> str:
    """Numbers by name, in words: `3 ok, 1 no_contact`."""
    return ", ".join(f"{count} {name}" for name, count in status.items())
