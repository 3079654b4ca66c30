"""What a command reports at its end."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class Summary:
    """Facts that `--json` prints."""

    def to_json(self) -> str:
        """JSON object with the attributes as keys, SI units but for ms."""
        return json.dumps(asdict(self), indent=2, allow_nan=False, ensure_ascii=False)
