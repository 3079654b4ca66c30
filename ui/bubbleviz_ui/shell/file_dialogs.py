"""File dialogs, which start in the folder of the last file of the same kind, else of any kind.

When saving, the suffix is added before the question whether a file may be replaced.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

from PySide6.QtCore import QBuffer, QSettings
from PySide6.QtGui import QImageWriter, QPixmap
from PySide6.QtWidgets import QFileDialog, QMessageBox, QWidget

from bubbleviz.files import free_name, whole_file

Answer = Literal["save", "discard", "cancel"]
SENSOR_FILES = "Sensor files (*.toml);;All files (*)"
ANY = "any"  # kind of file


def name_of_output(title: str, what: str) -> str:
    """Proposed name of a file made of a source with this title; `what`: as `table.csv`."""
    stem = re.sub(r"[^\w-]+", "_", Path(title).stem).strip("_")
    return f"{stem}_{what}" if stem else what


def file_to_open(
    parent: QWidget, title: str, kinds: str = "", *, of: str, proposed: Path | None = None
) -> Path | None:
    """Ask for a file to read; None: cancelled.

    `kinds`: File filters in Qt's syntax.
    `of`: Kind of file, whose last folder the dialog shows.
    `proposed`: File selected at first.
    """
    start = _folder(of) if proposed is None else str(proposed)
    name, _ = QFileDialog.getOpenFileName(parent, title, start, kinds)
    return _remembered(of, name)


def files_to_open(parent: QWidget, title: str, kinds: str, *, of: str) -> list[Path]:
    """Ask for one or more files to read; empty: cancelled. Arguments as of `file_to_open`."""
    names, _ = QFileDialog.getOpenFileNames(parent, title, _folder(of), kinds)
    return [path for name in names if (path := _remembered(of, name)) is not None]


def folder_to_open(parent: QWidget, title: str, *, of: str) -> Path | None:
    """Ask for a folder to read; None: cancelled."""
    return _remembered(of, QFileDialog.getExistingDirectory(parent, title, _folder(of)))


def ask_to_save(parent: QWidget, title: str, text: str) -> Answer:
    """Ask whether to save or discard unsaved work."""
    kind = QMessageBox.StandardButton
    buttons = kind.Save | kind.Discard | kind.Cancel
    question = QMessageBox(QMessageBox.Icon.Question, title, text, buttons, parent)
    question.setDefaultButton(kind.Save)
    question.button(kind.Save).setText("&Save…")
    answers: dict[int, Answer] = {kind.Save: "save", kind.Discard: "discard"}
    answer = answers.get(question.exec(), "cancel")
    question.deleteLater()
    return answer


def ask_yes_no(parent: QWidget, title: str, text: str) -> bool:
    """Ask a yes-no question; No is the default button."""
    kind = QMessageBox.StandardButton
    answer = QMessageBox.question(parent, title, text, kind.Yes | kind.No, kind.No)
    return bool(answer == kind.Yes)


def file_to_save(
    parent: QWidget, title: str, proposed: str, kinds: str = "", *, of: str
) -> Path | None:
    """Ask for a file to write, by default with the suffix of `proposed`; None: cancelled.

    An existing file may be replaced, after a question.
    """
    dialog = QFileDialog(parent, title, _folder(of), kinds)
    dialog.setDefaultSuffix(Path(proposed).suffix)
    return _remembered(of, _saved_as(dialog, proposed)[0])


def new_file(
    parent: QWidget, title: str, proposed: str, kinds: str = "", *, of: str
) -> tuple[Path | None, str]:
    """Ask for a new file or folder; returns its path (None: cancelled) and the selected filter.

    With a single filter, a missing suffix is added. The proposed name gets a number if it exists.
    There is no question about replacing a file, as the writers never replace one.
    """
    free = free_name(Path(_folder(of)) / proposed)
    dialog = QFileDialog(parent, title, str(free.parent), kinds)
    dialog.setOption(QFileDialog.Option.DontConfirmOverwrite)
    if ";;" not in kinds:  # else it depends on the filter
        dialog.setDefaultSuffix(free.suffix)
    name, chosen = _saved_as(dialog, free.name)
    return _remembered(of, name), chosen


def _saved_as(dialog: QFileDialog, proposed: str) -> tuple[str, str]:
    """Show the dialog; returns the name (empty: cancelled) and the selected filter."""
    dialog.setAcceptMode(QFileDialog.AcceptMode.AcceptSave)
    dialog.selectFile(proposed)
    name = dialog.selectedFiles()[0] if dialog.exec() else ""
    dialog.deleteLater()
    return name, dialog.selectedNameFilter()


def _folder(of: str) -> str:
    """Folder of the last file of a kind, else of any kind; empty if there is none any more."""
    known = QSettings("bubbleviz", "folders")
    folder = str(known.value(of, known.value(ANY, "")))
    return folder if folder and Path(folder).is_dir() else ""


def remember(of: str, path: Path) -> None:
    """Store the folder of a file for the next dialog of its kind, or of one not used yet."""
    folders = QSettings("bubbleviz", "folders")
    for kind in (of, ANY):
        folders.setValue(kind, str(path.absolute().parent))


def remember_sensor(path: Path, size: tuple[int, int]) -> None:
    """Store a sensor file as the last one for images of a size."""
    _sensors().setValue(f"{size[0]}x{size[1]}", str(path.absolute()))


def last_sensor(size: tuple[int, int]) -> Path | None:
    """The last sensor file for images of a size, if it still exists."""
    path = Path(str(_sensors().value(f"{size[0]}x{size[1]}", "")))
    return path if path.is_file() else None


def _sensors() -> QSettings:
    return QSettings("bubbleviz", "sensors")


def _remembered(of: str, name: str) -> Path | None:
    if not name:
        return None
    remember(of, Path(name))
    return Path(name)


def write_picture(path: Path, picture: QPixmap) -> None:
    """Write or replace a picture atomically, as PNG unless the suffix is of another known format.

    Raises InputError: It cannot be written.
    """
    known = {bytes(name.data()).decode() for name in QImageWriter.supportedImageFormats()}
    suffix = path.suffix.removeprefix(".").lower()
    buffer = QBuffer()
    picture.save(buffer, suffix if suffix in known else "png")
    with whole_file(path, overwrite=True) as temporary:
        temporary.write_bytes(buffer.data().data())
