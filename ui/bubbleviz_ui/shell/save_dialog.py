"""Asking where to save: the suffix is there before it is asked whether a file may be replaced."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtGui import QImageWriter
from PySide6.QtWidgets import QFileDialog, QWidget

from bubbleviz_ui.model.messages import UserMessage


def file_to_save(
    parent: QWidget, title: str, proposed: str, kinds: str = "", *, replaces: bool = True
) -> Path | None:
    """File to write, with the suffix of the proposed name where it is given none; None to cancel.

    Parameters
    ----------
    parent : QWidget
    title, proposed : str
    kinds : str
        Filters of file names, as Qt writes them.
    replaces : bool
        A file that is there may be replaced; else the writer refuses it, and nothing is asked.
    """
    dialog = QFileDialog(parent, title, "", kinds)
    dialog.setAcceptMode(QFileDialog.AcceptMode.AcceptSave)
    dialog.setOption(QFileDialog.Option.DontConfirmOverwrite, not replaces)
    dialog.setDefaultSuffix(Path(proposed).suffix)
    dialog.selectFile(proposed)
    chosen = dialog.selectedFiles() if dialog.exec() else []
    dialog.deleteLater()
    return Path(chosen[0]) if chosen else None


def picture_saved(path: Path, *, written: bool) -> UserMessage:
    """What to tell of a picture that was written, or could not be."""
    if written:
        return UserMessage("notice", f"Saved {path}", file=path)
    return UserMessage("error", f"{path}: cannot be written; choose another place")


def picture_format(path: Path) -> str:
    """Format of a picture by the suffix of its file; PNG where that names none."""
    known = {bytes(name.data()).decode() for name in QImageWriter.supportedImageFormats()}
    suffix = path.suffix.removeprefix(".").lower()
    return suffix if suffix in known else "png"
