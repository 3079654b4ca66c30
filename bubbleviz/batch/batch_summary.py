"""Summary of a batch: text table, JSON and CSV."""

from __future__ import annotations

import json
import math
import os
import secrets
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from bubbleviz.batch.summary_row import Row
from bubbleviz.errors import InputError, SolveError
from bubbleviz.files.output_files import cannot_write
from bubbleviz.files.tables import table, write_rows
from bubbleviz.result import TRUSTED

_HEADER = (
    "recording",
    "frames",
    "contact",
    "max N",
    "mean N",
    "wrench N",
    "residual mm",
    "ms/frame",
    "look at frame",
    "outcome",
)


@dataclass(frozen=True)
class BatchSummary:
    """Summary of a batch.

    Attributes
    ----------
    table : str
        Path of the CSV file.
    rows : list of Row
        In the order of the recordings' paths.
    """

    table: str
    rows: list[Row]

    def to_json(self) -> str:
        """JSON object with the attributes as keys, SI units but for ms; null for NaN."""
        rows = [json.loads(row.to_json()) for row in self.rows]
        return json.dumps({"table": self.table, "rows": rows}, indent=1, ensure_ascii=False)

    def to_text(self) -> str:
        """Aligned table with units, what went wrong, and where the table is."""
        kept = sum(row.outcome == "kept" for row in self.rows)
        have = sum(row.has_result for row in self.rows)
        was = f", {kept} of them kept from before" if kept else ""
        return "\n".join(
            [
                table(_HEADER, [_cells(row) for row in self.rows]),
                *(row.error for row in self.rows if not row.has_result),
                *(f"{row.recording}: {row.note}" for row in self.rows if row.note),
                f"wrote {self.table}: {have} of {len(self.rows)} recordings have a result{was}",
            ]
        )

    def raise_failures(self) -> None:
        """Raise when a recording has no result.

        Raises
        ------
        InputError
            The recordings that failed are bad input.
        SolveError
            One of them failed for another reason.
        """
        failed = [row for row in self.rows if not row.has_result]
        if not failed:
            return
        others = [row for row in failed if row.outcome == "failed"]
        first = (others or failed)[0]
        count = f"{len(failed)} of {len(self.rows)} recordings have no result, see {self.table}"
        raise (SolveError if others else InputError)(f"{count}: {first.error}")


def write_summary(path: Path, rows: Sequence[Row]) -> None:
    """Write a CSV line a recording, SI units; takes the place of that of an earlier run."""
    temporary = path.with_name(f".{path.stem}.{secrets.token_hex(4)}{path.suffix}")
    try:
        write_rows(temporary, [asdict(row) for row in rows])
        os.replace(temporary, path)  # noqa: PTH105 - whole_file would refuse
    except OSError as error:
        raise cannot_write(path, error) from error
    finally:
        temporary.unlink(missing_ok=True)


def _cells(row: Row) -> list[str]:
    if not row.has_result:
        return [row.recording, *["–"] * (len(_HEADER) - 2), row.outcome]
    trust = row.worst_status in TRUSTED
    why = _number(1e3 * row.worst_residual_rms_m, " mm") if trust else row.worst_status
    return [
        row.recording,
        str(row.frames),
        str(row.contact_frames),
        _number(row.max_force_n),
        _number(row.mean_contact_force_n),
        _number(row.mean_contact_measured_force_n),
        _number(1e3 * row.median_residual_rms_m),
        _number(row.median_ms),
        f"{row.worst_frame} ({why})",
        row.outcome,
    ]


def _number(value: float, unit: str = "") -> str:
    return f"{value:.3g}{unit}" if math.isfinite(value) else "–"
