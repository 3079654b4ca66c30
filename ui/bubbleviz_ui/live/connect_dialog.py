"""Dialog that connects to a live source, with discovery of its topics."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from urllib.parse import quote

from PySide6.QtCore import Qt, QTimer
from PySide6.QtGui import QPalette
from PySide6.QtWidgets import (
    QComboBox,
    QDialog,
    QDialogButtonBox,
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QListWidget,
    QListWidgetItem,
    QVBoxLayout,
    QWidget,
)

from bubbleviz.errors import InputError
from bubbleviz.files import SYNTHETIC_SENSOR, preset_names, presets_folder
from bubbleviz.live import (
    DEPTH_TYPES,
    LiveSource,
    OfferedTopic,
    SessionOptions,
    SessionPreset,
    TopicNames,
    ZenohSource,
    is_used,
    load_session,
    open_stream,
    parse_uri,
)
from bubbleviz.recordings import AUTO
from bubbleviz.sensor import Sensor, load_sensor
from bubbleviz_ui.engine.worker import Worker
from bubbleviz_ui.live.connection import pair, single
from bubbleviz_ui.live.live_controller import LiveController
from bubbleviz_ui.shell.binding import options
from bubbleviz_ui.shell.dock import fill, push_button, resize_on_screen
from bubbleviz_ui.shell.file_dialogs import SENSOR_FILES, file_to_open, folder_to_open

UPDATE_MS = 250
NO_TOPIC = "\0"
"""Prefix of no topic, so that none is subscribed to during discovery."""


def _begin(text: str, sensor: Sensor) -> LiveSource:
    """Create the source, and start it if needed to discover topics."""
    uri = parse_uri(text)
    if uri.scheme != "zenoh":
        return open_stream(text, sensor, any_size=True).source
    topics = TopicNames(prefix=NO_TOPIC)
    source = ZenohSource(SessionOptions.of(uri), topics, uri.options.domain)
    source.start(lambda _: None)
    return source


ZENOH, REALSENSE, REPLAY, SYNTHETIC, PAIR = "zenoh", "realsense", "replay", "synthetic", ""
KINDS = {
    ZENOH: "ROS 2 over Zenoh",
    REALSENSE: "RealSense camera",
    REPLAY: "Recording, replayed live",
    SYNTHETIC: "Simulation",
    PAIR: "Two sensors",
}
PLACES = {
    ZENOH: "Address of the robot's router or bridge: tcp/HOST:7447; empty: this computer",
    REALSENSE: "Serial number, or a file of the RealSense viewer; empty: the first camera found",
    REPLAY: "A recording, file or folder",
    SYNTHETIC: "Object pressed into the membrane; empty: the built-in press",
    PAIR: "A session preset or file with two sensors",
}
AUTOMATIC = "automatic: the preset for images of the source's size"
TYPING_MS = 400
"""Delay after typing before the search starts."""
NAME = Qt.ItemDataRole.UserRole
SIZE = (620, 460)  # px


class ConnectDialog(QDialog):
    """Kind, address, topic and sensor; shows the equivalent argument of `--source`.

    It searches the topics of one source at a time.
    """

    def __init__(self, parent: QWidget, live: LiveController, sensor_name: str | None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Connect to a live source")
        resize_on_screen(self, *SIZE)
        self._live = live
        self._found: LiveSource | None = None  # Whose topics are listed
        self._worker = Worker("discovery")
        self._timer = QTimer(self, interval=UPDATE_MS)
        self.kind = options(QComboBox(), KINDS)
        self.place = QComboBox(editable=True)
        self.browse = push_button("Browse…", "Choose a file", self._browse)
        self.folder = push_button(
            "Folder…", "Choose the folder of a rosbag2 recording", self._browse_folder
        )
        self.topics = QListWidget()
        self.topics.setToolTip("Topics found with depth images or point clouds; choose one")
        self.kind.setToolTip("Type of live source")
        self.sensor = QComboBox()
        self.sensor.setToolTip("Sensor file of this camera and membrane")
        for name in _sensors(sensor_name):
            self.sensor.addItem(AUTOMATIC if name == AUTO else name, name)
        self.browse_sensor = push_button("Browse…", "Choose a sensor file", self._browse_sensor)
        for button in (self.browse, self.folder, self.browse_sensor):
            button.setAutoDefault(False)  # Enter connects
        self.second = QLineEdit()
        self.second.setPlaceholderText("Source of a second sensor, as below; empty: one sensor")
        self.second.setToolTip("Second sensor with the same sensor file, drawn beside the first")
        self.source = QLineEdit(readOnly=True, frame=False)  # to be copied, not edited
        self.source.setFocusPolicy(Qt.FocusPolicy.ClickFocus)
        colours = self.source.palette()
        colours.setColor(QPalette.ColorRole.Base, colours.color(QPalette.ColorRole.Window))
        self.source.setPalette(colours)
        self.source.setToolTip(
            "Equivalent argument of bubbleviz open --source (two sensors: --session)"
        )
        self.problem = QLabel(wordWrap=True)
        buttons = QDialogButtonBox.StandardButton
        self.buttons = QDialogButtonBox(buttons.Ok | buttons.Cancel)
        self.buttons.button(buttons.Ok).setText("Connect")
        self._typing_timer = QTimer(self, singleShot=True, interval=TYPING_MS)
        self._lay_out()
        self._connect()
        self._show_kind()

    @property
    def uri(self) -> str:
        """Argument of `--source`, or for two sensors of `--session`."""
        kind, place = self.kind.currentData(), self.place.currentText().strip()
        if kind == PAIR:
            return place
        topic = self._topic()
        option = f"{'&' if '?' in place else '?'}depth={quote(topic)}" if topic else ""
        return f"{kind}:{place}{option}"

    def accept(self) -> None:
        """Connect, if session and sensor file can be read."""
        try:
            preset = self._preset()
        except InputError as error:
            self.problem.setText(str(error))
            return
        self._live.connect_to(preset)
        super().accept()

    def done(self, result: int) -> None:
        """Stop the search."""
        self._stop()
        self._worker.close(0.0)
        super().done(result)

    # -- inside -------------------------------------------------------------------------------

    def _preset(self) -> SessionPreset:
        if self.kind.currentData() == PAIR:
            return load_session(self.place.currentText().strip())
        name = self.sensor.currentData()
        if name != AUTO:
            load_sensor(name)
        first, second = single(self.uri, name), self.second.text().strip()
        return pair(first, second) if second else first

    def _lay_out(self) -> None:
        where = fill(QHBoxLayout(), (self.place, 1), self.browse, self.folder)
        self._form = form = QFormLayout()
        form.setFieldGrowthPolicy(QFormLayout.FieldGrowthPolicy.AllNonFixedFieldsGrow)
        form.addRow("From", self.kind)
        form.addRow("Where", where)
        form.addRow("Depth images", self.topics)
        self._sensor_row = fill(QHBoxLayout(), (self.sensor, 1), self.browse_sensor)
        form.addRow("Sensor", self._sensor_row)
        form.addRow("Second source", self.second)
        form.addRow("Source", self.source)
        fill(QVBoxLayout(self), form, self.problem, self.buttons)

    def _connect(self) -> None:
        self.kind.currentIndexChanged.connect(lambda _: self._show_kind())
        self.place.editTextChanged.connect(lambda _: self._typing_timer.start())
        self.place.editTextChanged.connect(lambda _: self._show_source())
        self._typing_timer.timeout.connect(self._look)
        self.sensor.currentIndexChanged.connect(lambda _: self._look())
        self.topics.currentItemChanged.connect(lambda *_: self._show_source())
        self._timer.timeout.connect(self._show_found)
        self.buttons.accepted.connect(self.accept)
        self.buttons.rejected.connect(self.reject)

    def _show_kind(self) -> None:
        kind = self.kind.currentData()
        self.place.clear()
        self.place.addItems(_offered_places(kind))
        self.place.setToolTip(PLACES[kind])
        line = self.place.lineEdit()
        if line is not None:
            line.setPlaceholderText(PLACES[kind])
        self.browse.setVisible(kind in (REALSENSE, REPLAY, PAIR))
        self.folder.setVisible(kind == REPLAY)
        self._form.setRowVisible(self.topics, kind in (ZENOH, REPLAY))
        self._form.setRowVisible(self._sensor_row, kind != PAIR)
        self._form.setRowVisible(self.second, kind != PAIR)
        self._show_source()
        self._look()

    def _look(self) -> None:
        """Search the topics at the address."""
        self._stop()
        self._list(())
        self.problem.setText("")
        kind = self.kind.currentData()
        place = self.place.currentText().strip()
        if kind == PAIR or (kind == REPLAY and not place):
            return
        try:
            name = self.sensor.currentData()
            sensor = load_sensor(SYNTHETIC_SENSOR if name == AUTO else name)
        except InputError as error:
            self.problem.setText(str(error))
            return
        if kind == ZENOH:
            self.problem.setText("Looking for topics…")
        function = partial(_begin, f"{kind}:{place}", sensor)
        self._worker.submit(
            function,
            self._take,
            lambda failed: self._show_topics((), failed.message),
            discard=LiveSource.stop,
        )

    def _stop(self) -> None:
        self._typing_timer.stop()
        self._worker.cancel()
        self._timer.stop()
        source, self._found = self._found, None
        if source is not None:
            self._worker.submit(source.stop)

    def _take(self, source: LiveSource) -> None:
        self._found = source
        self._timer.start()
        self._show_found()

    def _show_found(self) -> None:
        if (source := self._found) is not None:
            problem = f"{source.problem} ({source.name})" if source.problem else ""
            self._show_topics(source.topics, problem)

    def _show_topics(self, topics: tuple[OfferedTopic, ...], problem: str) -> None:
        looking = self.kind.currentData() == ZENOH and not topics
        self.problem.setText(problem or ("No topics yet; looking…" if looking else ""))
        self._list(tuple(t for t in topics if t.type in DEPTH_TYPES and is_used(*t)))

    def _list(self, topics: tuple[OfferedTopic, ...]) -> None:
        """List topics, keeping the selection."""
        names = ["", *(topic.name for topic in topics)]
        if names == [self.topics.item(k).data(NAME) for k in range(self.topics.count())]:
            return
        chosen = self._topic()
        self.topics.clear()
        for name, kind in [("", ""), *topics]:
            text = f"{name}   {kind}" if name else "automatic: the first depth topic"
            item = QListWidgetItem(text)
            item.setData(NAME, name)
            self.topics.addItem(item)
        self.topics.setCurrentRow(names.index(chosen) if chosen in names else 0)
        self._show_source()

    def _topic(self) -> str:
        item = self.topics.currentItem()
        return str(item.data(NAME)) if item is not None else ""

    def _show_source(self) -> None:
        self.source.setText(self.uri)

    def _browse(self) -> None:
        kind = self.kind.currentData()
        of = "session" if kind == PAIR else "recording"
        self._use_path(file_to_open(self, KINDS[kind], of=of))

    def _browse_folder(self) -> None:
        self._use_path(folder_to_open(self, KINDS[REPLAY], of="recording"))

    def _use_path(self, path: Path | None) -> None:
        """Use a path chosen in a dialog; None: cancelled."""
        if path is not None:
            self.place.setEditText(str(path))
            self._look()

    def _browse_sensor(self) -> None:
        path = file_to_open(self, "Sensor file", SENSOR_FILES, of="sensor")
        if path is not None:
            if self.sensor.findData(str(path)) < 0:
                self.sensor.addItem(str(path), str(path))
            self.sensor.setCurrentIndex(self.sensor.findData(str(path)))


def _sensors(present: str | None) -> list[str]:
    """Sensor files offered, the current one first."""
    names = preset_names("sensors")
    return list(dict.fromkeys([*([present] if present else []), AUTO, *names]))


def _offered_places(kind: str) -> list[str]:
    if kind == SYNTHETIC:
        objects = sorted(path.stem for path in presets_folder("objects").glob("*.ply"))
        return ["", *objects, "nut-left", "nut-right"]
    if kind == PAIR:
        return preset_names("sessions")
    return [""]
