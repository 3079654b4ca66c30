"""Base class of the results of API functions, with text and JSON output."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import asdict
from typing import Any

from bubbleviz.files import to_json


class Summary(ABC):
    """Results with text and JSON output; a frozen dataclass, unless `facts` is overridden.

    Some have a `warning` about missing data and mismatches that did not stop the computation.
    """

    def facts(self) -> dict[str, Any]:
        """Content of `to_json`: SI units, run times in ms, None for unknown values."""
        return asdict(self)  # type: ignore[call-overload]

    def to_json(self) -> str:
        """The facts as a JSON object."""
        return to_json(self.facts())

    @abstractmethod
    def to_text(self) -> str:
        """Text for the terminal, with units."""
