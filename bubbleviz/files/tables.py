"""Tables: on the terminal, as CSV and as JSON, written whole or not at all."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bubbleviz.errors import InputError
from bubbleviz.files.output_files import whole_file


def out_folder(path: Path) -> Path:
    """Folder for reports, made where it is missing."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be made a folder ({error}); choose another") from error
    return path


def write_json(path: Path, data: Any) -> None:
    """JSON file; numbers that are not finite become null."""
    with whole_file(path) as temporary:
        temporary.write_text(to_json(data) + "\n", encoding="utf-8")


def to_json(data: Any) -> str:
    """JSON text; numbers that are not finite become null."""
    return json.dumps(_finite(data), indent=1, allow_nan=False)


def write_csv(path: Path, rows: Sequence[Any]) -> None:
    """CSV file of dataclass rows of one kind."""
    with whole_file(path) as temporary:
        write_rows(temporary, [asdict(row) for row in rows])


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """CSV of rows by column, in UTF-8 with a header line; `nan` for NaN, nothing for None.

    Give the temporary path of `whole_file`.
    """
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]) if rows else [])
        writer.writeheader()
        writer.writerows(rows)


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Aligned columns for the terminal."""
    lines = [list(header), *map(list, rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(header))]
    first, *others = (
        "  ".join(
            cell.ljust(width) if k == 0 else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )
    return "\n".join([first, "-" * len(first), *others])


def _finite(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _finite(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_finite(value) for value in data]
    if isinstance(data, float) and not math.isfinite(data):
        return None
    return data
