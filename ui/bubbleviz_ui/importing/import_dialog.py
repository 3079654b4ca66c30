"""Import dialog: converts a folder of depth images or another recording to MCAP."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from PySide6.QtCore import Signal
from PySide6.QtWidgets import (
    QComboBox,
    QDialog,
    QDoubleSpinBox,
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QVBoxLayout,
    QWidget,
)

from bubbleviz.api.converting import convert
from bubbleviz.api.frames import RecordingInfo
from bubbleviz.files import free_name
from bubbleviz.progress import Progress
from bubbleviz.recordings import is_image_folder
from bubbleviz.wording import count_of
from bubbleviz_ui.engine.worker import Failed, Worker
from bubbleviz_ui.live.recording_control import make_folder
from bubbleviz_ui.model.messages import Messages
from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.binding import options
from bubbleviz_ui.shell.dock import fill, push_button
from bubbleviz_ui.shell.file_dialogs import file_to_open, folder_to_open, remember
from bubbleviz_ui.shell.message_bars import JobProgress

# File name with a button for the file dialog.


class FileField(QWidget):
    """Box for the name of an existing file, with a button for the file dialog.

    `title, kinds`: Title and filters of the file dialog.
    `placeholder`: Default, shown while the box is empty.
    """

    changed = Signal()

    def __init__(self, title: str, kinds: str, placeholder: str = "") -> None:
        super().__init__()
        self._title, self._kinds = title, kinds
        self.line = QLineEdit(placeholderText=placeholder)
        self.browse = push_button("Browse…", title, self._browse)
        self.browse.setAutoDefault(False)
        fill(QHBoxLayout(self), (self.line, 1), self.browse, margins=(0, 0, 0, 0))
        self.setFocusProxy(self.line)
        self.line.textChanged.connect(lambda _: self.changed.emit())

    @property
    def path(self) -> Path | None:
        """The file; None if empty."""
        name = self.line.text().strip()
        return Path(name) if name else None

    def _browse(self) -> None:
        path = file_to_open(self, self._title, self._kinds, of="import")
        if path is not None:
            self.line.setText(str(path))


# Options of a folder of depth images: camera, times, unit, other measurements.

UNITS = {
    None: "integers mm, floats m",
    1.0: "m",
    1e-3: "mm",
    2.5e-4: "0.25 mm",
    1e-4: "0.1 mm",
    1e-6: "µm",
}
"""Metres per unit of a pixel value; None: by its data type."""
BY_FOLDER, RATE, TABLE = (
    "times.csv in the folder, else times in the file names",
    "a fixed rate",
    "a table (CSV)",
)
TABLES = "Tables (*.csv);;All files (*)"


class ImageFields:
    """Options of `bubbleviz convert` for a folder of images.

    `form`: Layout to which the rows are added.
    `changed`: Called when an option changes.
    """

    def __init__(self, form: QFormLayout, changed: Callable[[], None]) -> None:
        self.intrinsics = FileField(
            "Intrinsics: a TOML or JSON file, or a sensor file",
            "Intrinsics (*.toml *.json);;All files (*)",
            "intrinsics.toml or .json in the folder, else of the sensor file used later",
        )
        self.unit = options(QComboBox(), UNITS)
        self.unit.setToolTip("Depth of a pixel value of 1")
        self.timing = QComboBox()
        self.timing.addItems([BY_FOLDER, RATE, TABLE])
        self.timing.setToolTip("Where the times of the images come from")
        self.rate = QDoubleSpinBox(minimum=0.01, maximum=1e4, value=30.0, suffix=" Hz")
        self.rate.setToolTip("Images per second")
        self.times = FileField("CSV with the time of each image in s", TABLES)
        self.gas_pressure = FileField(
            "Gas pressure, CSV with columns time in s as of the images, absolute pressure in Pa",
            TABLES,
            "not measured",
        )
        self.wrench = FileField(
            "Wrench, CSV with columns time in s as of the images, forces x y z in N, torques x y z "
            "in N·m",
            TABLES,
            "not measured",
        )
        self._form, self._shown = form, False
        self._rows: dict[str, FileField | QComboBox | QDoubleSpinBox] = {
            "Intrinsics": self.intrinsics,
            "Unit": self.unit,
            "Times": self.timing,
            "Rate": self.rate,
            "Table of times": self.times,
            "Gas pressure": self.gas_pressure,
            "Wrench": self.wrench,
        }
        for title, field in self._rows.items():
            form.addRow(title, field)
        self.timing.currentIndexChanged.connect(lambda _: self.show(self._shown))
        for field in self._rows.values():
            if isinstance(field, FileField):
                field.changed.connect(changed)
            elif isinstance(field, QComboBox):
                field.currentIndexChanged.connect(lambda _: changed())
            else:
                field.valueChanged.connect(lambda _: changed())

    @property
    def options(self) -> dict[str, Any]:
        """The options as arguments of `bubbleviz.convert`."""
        timing = self.timing.currentText()
        return {
            "intrinsics": self.intrinsics.path,
            "times": self.times.path if timing == TABLE else None,
            "gas_pressure": self.gas_pressure.path,
            "wrench": self.wrench.path,
            "rate_hz": self.rate.value() if timing == RATE else None,
            "metres_per_unit": self.unit.currentData(),
        }

    def show(self, shown: bool, *, enabled: bool = True) -> None:
        """Show the rows that apply, or none."""
        self._shown, timing = shown, self.timing.currentText()
        for field in self._rows.values():
            apart = (field is self.rate and timing != RATE) or (
                field is self.times and timing != TABLE
            )
            self._form.setRowVisible(field, shown and not apart)
            field.setEnabled(enabled)


SUFFIX = ".mcap"
SUFFIXES = (".bag", ".db3", SUFFIX, ".yaml")
OTHERS = f"Recordings (*{' *'.join(SUFFIXES)});;All files (*)"
TOPIC = "import"
"""Topic of messages."""
WIDTH = 560  # px
ABOUT = (
    "Choose a folder of depth images (.npy, 16-bit .png, .tif) or a recording (.bag of ROS 1 or of "
    "the RealSense library, .db3 of ROS 2)."
)


class ImportDialog(QDialog):
    """Non-modal dialog for imports."""

    def __init__(
        self,
        parent: QWidget,
        worker: Worker,
        messages: Messages,
        open_recording: Callable[[Path], None],
        folder: Callable[[], Path],  # Returns the folder of recordings
    ) -> None:
        super().__init__(parent)
        self.setWindowTitle("Import")
        self.setMinimumWidth(WIDTH)
        self._worker, self._messages = worker, messages
        self._open_recording, self._folder = open_recording, folder
        self._proposed = ""
        self.source = FileField("A recording", OTHERS)
        self.source.browse.setText("Recording…")
        self.folder = push_button("Folder…", "A folder of depth images", self._choose_folder)
        self.out = QLineEdit()
        self.out.setToolTip("The new recording, .mcap; an existing file is never replaced")
        self.about = theme.dim(QLabel(ABOUT, wordWrap=True))
        self.problem, self.made = QLabel(wordWrap=True), QLabel(wordWrap=True)
        theme.doubtful(self.problem)
        self.progress = JobProgress()
        self.cancel = push_button("Cancel", "Stop and remove the unfinished file", self._cancel)
        self.open_made = push_button("Open", "Open the new recording in the window", self._open)
        self.begin = push_button("Import", "Convert to a recording", self._begin)
        self._made: RecordingInfo | None = None
        form = QFormLayout()
        form.addRow("From", fill(QHBoxLayout(), (self.source, 1), self.folder))
        self.images = ImageFields(form, self._on_field)
        form.addRow("To", self.out)
        buttons = fill(
            QHBoxLayout(), (self.progress, 1), 0, self.cancel, self.open_made, self.begin
        )
        fill(QVBoxLayout(self), form, self.about, self.problem, self.made, 1, buttons)
        self.source.changed.connect(self._on_source)
        self.out.textChanged.connect(lambda _: self._on_field())
        self._worker.progressed.connect(self.progress.show_step)
        self._show()

    @property
    def out_path(self) -> Path:
        """The recording to write."""
        name = self.out.text().strip()
        return Path(name if name.lower().endswith(SUFFIX) else name + SUFFIX)

    # -- inside -------------------------------------------------------------------------------

    def _choose_folder(self) -> None:
        path = folder_to_open(self, "A folder of depth images", of="import")
        if path is not None:
            self.source.line.setText(str(path))

    def _on_source(self) -> None:
        """Propose an output name, unless one was typed."""
        path = self.source.path
        if path is not None and self.out.text() in ("", self._proposed):
            name = path.stem if path.suffix.lower() in SUFFIXES else path.name
            self._proposed = str(free_name(self._folder() / f"{name}{SUFFIX}"))
            self.out.setText(self._proposed)
        self._on_field()

    def _on_field(self) -> None:
        """Clear the error of the previous options."""
        self.problem.clear()
        self._show()

    def _show(self) -> None:
        """Update the visible options and enabled buttons."""
        path, busy = self.source.path, self._worker.busy
        self.images.show(path is not None and is_image_folder(path), enabled=not busy)
        self.about.setVisible(path is None)
        for widget in (self.source, self.folder, self.out):
            widget.setEnabled(not busy)
        self.begin.setEnabled(not busy and path is not None and bool(self.out.text().strip()))
        self.progress.setVisible(busy)
        self.cancel.setVisible(busy)
        self.open_made.setVisible(not busy and self._made is not None)
        for label in (self.problem, self.made):
            label.setVisible(bool(label.text()))

    def _begin(self) -> None:
        path = self.source.path
        if path is None:
            return
        self._show_outcome(None, "")
        options = self.images.options if is_image_folder(path) else {}
        function = partial(_imported, path, self.out_path, options, self._worker.progress)
        self._worker.submit(function, self._on_done, self._on_failed, discard=_discard)
        self.progress.show_step("opening", 0.0)
        self._show()

    def _cancel(self) -> None:
        self._worker.cancel()
        self._show()

    def _on_failed(self, failed: Failed) -> None:
        self._show_outcome(None, failed.message)
        self._show()
        if failed.details or not self.isVisible():  # else only the dialog shows it
            self._messages.add("error", failed.message, failed.details, topic=TOPIC)

    def _on_done(self, made: RecordingInfo) -> None:
        self._show_outcome(made, "")
        self._show()
        out = Path(made.path)
        remember("recording", out)
        self._messages.add("notice", self.made.text(), file=out, topic=TOPIC)

    def _show_outcome(self, made: RecordingInfo | None, problem: str) -> None:
        self._made = made
        count = "" if made is None else count_of(made.frames, "frame")
        self.made.setText("" if made is None else f"wrote {made.path}: {count}")
        self.problem.setText(problem)

    def _open(self) -> None:
        if self._made is not None:
            self._open_recording(Path(self._made.path))
            self.accept()


def _imported(path: Path, out: Path, options: dict[str, Any], progress: Progress) -> RecordingInfo:
    make_folder(out)
    return convert(path, out, progress=progress, **options)


def _discard(made: RecordingInfo) -> None:
    """Remove a file that was completed just before cancelling."""
    Path(made.path).unlink(missing_ok=True)
