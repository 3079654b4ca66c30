"""What a command reports at its end."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class Summary(ABC):
    """Facts that `--json` prints."""

    def to_json(self) -> str:
        """JSON object with the attributes as keys, SI units but for ms."""
        return json.dumps(asdict(self), indent=2, allow_nan=False, ensure_ascii=False)

    @abstractmethod
    def to_text(self) -> str:
        """Text for the terminal, with units."""
