"""Base class of summaries that are saved as plot, table and numbers."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np

from bubbleviz.api.summary import Summary
from bubbleviz.files import (
    PICTURES,
    refuse_existing,
    refuse_input,
    rows_of,
    whole_file,
    write_json,
    write_rows,
)
from bubbleviz.output import DPI

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, kw_only=True)
class SavedSummary(Summary):
    """A summary with a plot and a table of the frames; `stem` names its files in a folder."""

    stem: ClassVar[str]
    out: str | None = None  # file or folder written

    @abstractmethod
    def columns(self) -> dict[str, np.ndarray]:
        """Numbers of the frames by column, (F,) each, units in the names."""

    @abstractmethod
    def lines(self) -> list[str]:
        """Lines of `to_text`, without the file written."""

    def to_text(self) -> str:
        """Text for the terminal, with units."""
        return "\n".join([*self.lines(), *([f"wrote {self.out}"] if self.out else [])])

    @abstractmethod
    def plot(self) -> Figure:
        """Figure of the table."""

    def saved(self, out: str | Path | None, *, overwrite: bool) -> Self:
        """The summary after `save`; unchanged if `out` is None."""
        if out is None:
            return self
        named = replace(self, out=str(out))
        named.save(out, overwrite=overwrite)
        return named

    def save(self, out: str | Path, *, overwrite: bool = False) -> None:
        """Write a plot (.png, .svg, .pdf), a table (.csv), numbers (.json), or a folder of all.

        Raises
        ------
        InputError
            Another suffix, or the file exists.
        """
        out = Path(out)
        check_out(out, overwrite=overwrite)
        with whole_file(out, overwrite=overwrite) as temporary:
            if out.suffix:
                self._write(temporary)
                return
            temporary.mkdir()
            for suffix in (".png", ".csv", ".json"):
                self._write(temporary / f"{self.stem}{suffix}")

    def _write(self, path: Path) -> None:
        suffix = path.suffix.lower()
        if suffix == ".csv":
            write_rows(path, rows_of(self.columns()))
        elif suffix == ".json":
            write_json(path, self.facts())
        else:
            self.plot().savefig(path, dpi=DPI)


def axis_columns(**vectors: np.ndarray) -> dict[str, np.ndarray]:
    """Columns (F,) of the components of vectors (F, 3) in N: `NAME_x_n` and so on."""
    return {
        f"{name}_{axis}_n": vector[:, k]
        for name, vector in vectors.items()
        for k, axis in enumerate("xyz")
    }


def check_out(out: str | Path | None, *read: str | Path | None, overwrite: bool) -> None:
    """Raise InputError if a `SavedSummary` cannot be written there, or would replace what is read.

    Each of `read` may be None, for none.
    """
    if out is None:
        return
    refuse_existing(out, *PICTURES, ".csv", ".json", "", overwrite=overwrite)
    refuse_input(out, *read)
