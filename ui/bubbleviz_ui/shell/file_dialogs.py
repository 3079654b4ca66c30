"""Asking for files: dialogs come back to the folder of the last file of the same kind.

When saving, the suffix is there before it is asked whether a file may be replaced.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from PySide6.QtCore import QSettings
from PySide6.QtGui import QImageWriter
from PySide6.QtWidgets import QFileDialog, QMessageBox, QWidget

from bubbleviz.files import free_name
from bubbleviz_ui.model.messages import UserMessage

Answer = Literal["save", "discard", "cancel"]
SENSOR_FILES = "Sensor files (*.toml);;All files (*)"


def file_to_open(
    parent: QWidget, title: str, kinds: str = "", *, of: str, by_default: Path | None = None
) -> Path | None:
    """File to read; None to cancel.

    `kinds`: Filters of file names, as Qt writes them.
    `of`: Kind of the file, whose last folder the dialog shows.
    `by_default`: Folder to show before there is one.
    """
    name, _ = QFileDialog.getOpenFileName(parent, title, _folder(of, by_default), kinds)
    return _remembered(of, name)


def folder_to_open(parent: QWidget, title: str, *, of: str) -> Path | None:
    """Folder to read; None to cancel."""
    return _remembered(of, QFileDialog.getExistingDirectory(parent, title, _folder(of)))


def unsaved(parent: QWidget, title: str, text: str) -> Answer:
    """Ask what becomes of something unsaved that would be lost."""
    kind = QMessageBox.StandardButton
    question = QMessageBox(parent)
    question.setWindowTitle(title)
    question.setText(text)
    question.setIcon(QMessageBox.Icon.Question)
    question.setStandardButtons(kind.Save | kind.Discard | kind.Cancel)
    question.setDefaultButton(kind.Save)
    question.button(kind.Save).setText("&Save…")
    answers: dict[int, Answer] = {kind.Save: "save", kind.Discard: "discard"}
    return answers.get(question.exec(), "cancel")


def agreed(parent: QWidget, title: str, text: str) -> bool:
    """Ask whether to do something; no is the answer that Enter gives."""
    kind = QMessageBox.StandardButton
    answer = QMessageBox.question(parent, title, text, kind.Yes | kind.No, kind.No)
    return bool(answer == kind.Yes)


def file_to_save(
    parent: QWidget, title: str, proposed: str, kinds: str = "", *, of: str
) -> Path | None:
    """File to write, with the suffix of the proposed name where it is given none; None to cancel.

    One that is there may be replaced.
    """
    dialog = QFileDialog(parent, title, _folder(of), kinds)
    dialog.setDefaultSuffix(Path(proposed).suffix)
    return _remembered(of, _saved_as(dialog, proposed)[0])


def new_file(
    parent: QWidget, title: str, proposed: str, kinds: str = "", *, of: str
) -> tuple[Path | None, str]:
    """Name of a file or folder to make, None to cancel, and the filter that was chosen.

    A file of one kind gets its suffix where it is given none. The proposed name has a number behind
    it where it is taken. Nothing is asked about one that is there: whoever writes it refuses to
    replace it.
    """
    free = free_name(Path(_folder(of)) / proposed)
    dialog = QFileDialog(parent, title, str(free.parent), kinds)
    dialog.setOption(QFileDialog.Option.DontConfirmOverwrite)
    if ";;" not in kinds:  # else it is that of the filter
        dialog.setDefaultSuffix(free.suffix)
    name, chosen = _saved_as(dialog, free.name)
    return _remembered(of, name), chosen


def _saved_as(dialog: QFileDialog, proposed: str) -> tuple[str, str]:
    """Name, empty to cancel, and filter that a dialog is answered with."""
    dialog.setAcceptMode(QFileDialog.AcceptMode.AcceptSave)
    dialog.selectFile(proposed)
    name = dialog.selectedFiles()[0] if dialog.exec() else ""
    dialog.deleteLater()
    return name, dialog.selectedNameFilter()


def _folder(of: str, by_default: Path | None = None) -> str:
    """Where the last file of a kind was; empty for nowhere, or where that is gone."""
    folder = str(_folders().value(of, by_default or ""))
    return folder if folder and Path(folder).is_dir() else ""


def remember(of: str, path: Path) -> None:
    """Have the next dialog for a kind of file begin where this one is."""
    _folders().setValue(of, str(path.absolute().parent))


def _remembered(of: str, name: str) -> Path | None:
    if not name:
        return None
    remember(of, Path(name))
    return Path(name)


def _folders() -> QSettings:
    return QSettings("bubbleviz", "folders")


def picture_saved(path: Path, *, written: bool) -> UserMessage:
    """What to tell of a picture that was written, or could not be."""
    if written:
        return UserMessage("notice", f"Saved {path}", file=path, topic="picture")
    problem = f"{path}: cannot be written; choose another place"
    return UserMessage("error", problem, topic="picture")


def picture_format(path: Path) -> str:
    """Format of a picture by the suffix of its file; PNG where that names none."""
    known = {bytes(name.data()).decode() for name in QImageWriter.supportedImageFormats()}
    suffix = path.suffix.removeprefix(".").lower()
    return suffix if suffix in known else "png"
