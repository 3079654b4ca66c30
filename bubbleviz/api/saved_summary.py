"""Base class of summaries that are saved as plot, table and numbers."""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from bubbleviz.api.summary import Summary
from bubbleviz.errors import InputError
from bubbleviz.files import refuse_existing, to_json, whole_file, write_rows
from bubbleviz.output import DPI

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PICTURES = (".png", ".svg", ".pdf")


class SavedSummary(Summary):
    """A summary with a plot and a table of the frames; `stem` names its files in a folder."""

    stem: ClassVar[str]

    @abstractmethod
    def rows(self) -> list[dict[str, float]]:
        """Numbers of each frame by column, units in the names."""

    @abstractmethod
    def plot(self) -> Figure:
        """Figure of the table."""

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
        if path.suffix == ".csv":
            write_rows(path, self.rows())
        elif path.suffix == ".json":
            path.write_text(to_json(self.facts()) + "\n", encoding="utf-8")
        else:
            self.plot().savefig(path, dpi=DPI)


def check_out(out: str | Path | None, *, overwrite: bool) -> None:
    """Raise InputError if a `SavedSummary` cannot be written there."""
    if out is None:
        return
    if Path(out).suffix not in ("", ".csv", ".json", *_PICTURES):
        raise InputError(
            f"{out}: not a name of a plot, a table or numbers; end it in .png, .svg, .pdf, .csv or "
            ".json, or give a folder without a dot in its name"
        )
    refuse_existing(Path(out), overwrite=overwrite)
