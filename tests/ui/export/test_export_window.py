"""Exports from the window by clicks, read back from the files."""

import csv
import re
from threading import Event

import imageio_ffmpeg
import numpy as np
import pytest
from fakes import FIRST_CONTACT, FRAMES, DentSource, small_sensor
from live_bench import connected_bench
from PySide6.QtCore import Qt
from PySide6.QtGui import QImage
from window_driver import CTRL, Driver, clipped_texts, pressure_coloured, view_texts

import bubbleviz as bv
from bubbleviz.pipeline import Pipeline
from bubbleviz.sensor import load_sensor
from bubbleviz.simulation import LoopedSource, default_press
from bubbleviz_ui.engine.source import Source
from bubbleviz_ui.engine.worker import wait_until_ended
from bubbleviz_ui.export import export_dialog, exporting as video_export
from bubbleviz_ui.export.export_dialog import ExportDialog
from bubbleviz_ui.export.exporting import TOPIC
from bubbleviz_ui.view3d.tools import picture_of
from tests.shear.texture_bag import HELD, write_texture_press
from tests.small_press import write_press, write_small_sensor


class Bench(Driver):
    """The window with its export dialog open, driven by clicks and keys."""

    def __init__(self, driver, monkeypatch):
        super().__init__(driver.bot, driver.window)
        self._patch = monkeypatch
        self.trigger("File › Export")
        assert self.dialog.isVisible()

    @property
    def dialog(self):
        dialog = self.window.findChild(ExportDialog)
        assert isinstance(dialog, ExportDialog)
        return dialog

    def begin(self, title, out, chosen=""):
        self.pick(self.dialog.kind, title)
        self._patch.setattr(export_dialog, "new_file", lambda *_, **__: (out, chosen))
        assert self.dialog.export.isEnabled()
        self.click(self.dialog.export)
        # A short export may be over before what it says has arrived.
        self.wait(lambda: self.window.exporting.busy or bool(self.dialog.message.text()))

    def export(self, title, out, chosen=""):
        """Export, wait until it is over; what is said then."""
        self.begin(title, out, chosen)
        self.wait(lambda: not self.window.exporting.busy)
        self.wait(lambda: bool(self.dialog.message.text()))
        assert self.window.messages.all[-1].text == self.dialog.message.text()
        return self.dialog.message.text()


@pytest.fixture(scope="session")
def sensor():
    """A coarse one: every export solves its frames anew."""
    return small_sensor(nodes=80)


@pytest.fixture
def bench(drive, monkeypatch):
    made = Bench(drive(DentSource, frame=6), monkeypatch)
    yield made
    made.release()


@pytest.mark.long  # in short: in tests/ui/shear, below without colour
def test_table_has_the_forces_of_the_window_also_with_colour(drive, monkeypatch, tmp_path):
    pytest.importorskip("cv2")
    press, sensor = write_texture_press(tmp_path, {})
    source = Source.of_recording(press)
    bench = Bench(drive(source, sensor=load_sensor(sensor), frame=HELD), monkeypatch)
    bench.state.set_range((HELD, HELD + 1))

    def exported(name):
        """Message, and force of the first frame."""
        message = bench.export("Table", tmp_path / name)
        with (tmp_path / name).open() as file:
            row, _ = csv.DictReader(file)
        return message, float(row["force_magnitude_n"])

    def shown():
        return np.linalg.norm(bench.result.estimate.force_n)

    by_depth = shown()
    message, force = exported("depth.csv")
    assert "forces by" not in message
    bench.show("shear")
    bench.wait(lambda: bench.result.traction is not None)
    bench.wait_until_shown()
    changed = abs(shown() - by_depth)
    assert changed > 5e-3 * by_depth
    assert force == pytest.approx(by_depth, rel=3e-3)
    assert abs(force - by_depth) < abs(force - shown())
    message, force = exported("colour.csv")
    assert force == pytest.approx(shown(), rel=3e-3) and "by depth and colour" in message
    assert abs(force - shown()) < abs(force - by_depth)
    bench.release()


def test_table_equals_that_of_the_command(drive, monkeypatch, tmp_path):
    """Although the zeros are those that the window has found."""
    file = write_small_sensor(tmp_path / "small.toml")
    path = write_press(tmp_path / "press.mcap", file, [0.060] * 18 + [0.046, 0.044, 0.042, 0.060])
    bench = Bench(drive(Source.of_recording(path), sensor=load_sensor(file), frame=19), monkeypatch)
    bench.state.set_range((17, 20))
    bench.export("Table", tmp_path / "window.csv")
    bv.export(bv.open(path)[17:21], tmp_path / "command.csv", file)
    tables = []
    for name in ("window.csv", "command.csv"):
        with (tmp_path / name).open() as text:
            rows = list(csv.DictReader(text))
        tables.append([{k: row[k] for k in row if not k.endswith("_ms")} for row in rows])
    assert len(tables[0]) == 4 and tables[0] == tables[1]
    bench.release()


SERIES = {
    "ParaView series": ".vtp",
    "Membrane series": ".ply",
    "Patch clouds": ".ply",
    "Depth pictures": ".png",
    "Pressure pictures": ".png",
}


@pytest.mark.long  # in short: tests/export
def test_export_series_and_plots_and_cancelled_exports_leave_nothing(bench, tmp_path):
    first, last = 3, 6
    bench.state.set_range((first, last))
    for title, suffix in SERIES.items():
        out = tmp_path / title
        bench.export(title, out)
        files = sorted(out.glob(f"*{suffix}"))
        if title == "Patch clouds":  # of frames with a patch
            assert last - FIRST_CONTACT <= len(files) <= last - first + 1
            assert int(re.search(rb"element vertex (\d+)", files[-1].read_bytes())[1]) > 3
        else:
            assert len(files) == last - first + 1, title
        said = bench.export(title, tmp_path / f"other{suffix}")
        assert "a series of files needs a folder" in said or "holds" in said, title
    for suffix in ("png", "svg", "pdf"):
        bench.export("Plots", tmp_path / "plots", f"{suffix.upper()} (*.{suffix})")
        assert (tmp_path / f"plots.{suffix}").stat().st_size > 10_000
    assert not QImage(str(tmp_path / "plots.png")).isNull()
    # one that is cancelled leaves nothing
    dialog, cancelled = bench.dialog, tmp_path / "cancelled"
    cancelled.mkdir()
    bench.state.change(picture_size=(1600, 1200))
    for title, out in (
        ("Video of the view", cancelled / "a.mp4"),
        ("Membrane series", cancelled / "b"),
    ):
        bench.begin(title, out)
        assert dialog.cancel.isVisible() and not dialog.export.isEnabled()
        bench.click(dialog.cancel)
        assert not dialog.cancel.isVisible() and dialog.export.isEnabled()
    bench.seek(9)
    bench.window.exporting.close()
    wait_until_ended()
    assert not list(cancelled.iterdir()) and bench.state.frame == 9


def pictures(path):
    reader = imageio_ffmpeg.read_frames(str(path))
    width, height = next(reader)["size"]
    return [np.frombuffer(p, np.uint8).reshape(height, width, 3) for p in reader]


def test_video_contains_each_readable_frame_of_the_range_with_its_caption(
    bench, sensor, tmp_path, monkeypatch
):
    driver = bench
    driver.state.change(picture_size=(480, 360), speed=0.5)
    driver.state.set_range((2, 10))
    driver.seek(6)
    out = tmp_path / "press.mp4"
    assert "9 frames" in bench.export("Video of the view", out)
    assert driver.state.frame == 6 and not driver.state.playing
    shown = pictures(out)
    assert len(shown) == 9 and shown[0].shape == (360, 480, 3)
    _, seconds = imageio_ffmpeg.count_frames_and_secs(str(out))
    assert seconds == pytest.approx(9 / 15.0, rel=0.2)  # half of 30 Hz
    assert (
        len(pressure_coloured(shown[0])) < 20 < len(pressure_coloured(shown[-1]))
    )  # the dent comes with frame 4
    driver.wait_until_shown()
    assert driver.result.frame.index == 6
    # each says which frame it shows, unless told not to
    drawn = []

    def watched(*args):
        drawn.append([text for text in view_texts(driver) if text.startswith("frame")])
        return picture_of(*args)

    monkeypatch.setattr(video_export, "picture_of", watched)
    driver.state.change(picture_size=(320, 240))
    driver.state.set_range((2, 3))
    bench.export("Video of the view", tmp_path / "said.mp4")
    assert drawn == [["frame 2 · 0.067 s"], ["frame 3 · 0.100 s"]]
    assert not [text for text in view_texts(driver) if text.startswith("frame")]
    driver.click(bench.dialog.captioned)
    bench.export("Video of the view", tmp_path / "silent.mp4")
    assert drawn[2:] == [[], []]
    said, silent = (pictures(tmp_path / f"{name}.mp4")[0] for name in ("said", "silent"))
    assert np.abs(said.astype(int) - silent)[-24:, 100:-100].max() > 60
    bench.dialog.kind.setCurrentIndex(0)
    assert not bench.dialog.captioned.isVisible()
    # an unreadable frame ends an export with a message
    broken, empty = lambda sensor: DentSource(sensor, broken_from=3), tmp_path / "empty"
    empty.mkdir()
    bench.show_source(broken, sensor)
    assert "frame 3 cannot be read" in bench.export("Table", empty / "a.csv")
    bench.begin("Video of the view", empty / "a.mp4")
    bench.wait(lambda: not bench.window.exporting.busy)
    assert "frame 3 cannot be read" in bench.message_text
    bench.window.exporting.close()
    wait_until_ended()
    assert not list(empty.iterdir())


@pytest.mark.long  # in short: in test_cold_solves.py
def test_video_shows_the_same_as_the_paused_window(drive, monkeypatch, tmp_path):
    """Each frame as a pipeline finds it that has seen no other."""
    drawn, sensor = list[tuple[int, float]](), small_sensor()
    source = default_press(sensor)
    looped = LoopedSource(source, source.camera)
    bench = Bench(drive(lambda _: looped, sensor=sensor, frame=110), monkeypatch)
    driver = bench

    def watched(*args):
        result = driver.result
        drawn.append((result.frame.index, result.patch.area_m2))
        return picture_of(*args)

    monkeypatch.setattr(video_export, "picture_of", watched)
    driver.state.change(picture_size=(320, 240))
    driver.state.set_range((73, 76))
    driver.state.set_playing(True)
    bench.export("Video of the view", tmp_path / "final.mp4")
    pipeline = Pipeline.of(sensor)
    options = driver.window.controller.client.demand.options
    assert [frame for frame, _ in drawn] == [73, 74, 75, 76]
    for frame, area_m2 in drawn:
        pipeline.restart()
        alone = pipeline.process(source[frame], frozenset({"patch"}), options)
        assert area_m2 == pytest.approx(alone.patch.area_m2, rel=1e-3)


class SlowSource(DentSource):
    """Says when a frame is being read, which takes long."""

    def __init__(self, sensor):
        super().__init__(sensor, slow_s=0.2)
        self.reading = Event()

    def __getitem__(self, index):
        self.reading.set()
        return super().__getitem__(index)


def test_window_closed_while_the_scale_of_a_video_is_computed_is_released(drive, sensor, tmp_path):
    """The window, its controller and view, as `no_leaks` checks."""
    source = SlowSource(sensor)
    driver = drive(lambda _: source)
    (video,) = (kind for kind in video_export.KINDS if kind.is_video)
    source.reading.clear()
    driver.window.exporting.start(video, range(FRAMES), tmp_path / "press.mp4")
    driver.wait(source.reading.is_set)
    driver.window.close_without_asking()
    driver.release()
    assert not list(tmp_path.iterdir())


def test_live_source_must_be_recorded_before_export(open_bench, monkeypatch):
    bench = Bench(connected_bench(open_bench), monkeypatch)
    assert "record them (Ctrl+R)" in bench.dialog.about.text()
    assert not bench.dialog.export.isEnabled()


def test_tables_their_names_and_messages(bench, sensor, tmp_path, monkeypatch):
    window, state = bench.window, bench.state
    (tmp_path / "there.csv").write_text("precious")
    state.set_range((3, 4))
    bench.dialog.step.setValue(2)
    assert bench.dialog.about.text().endswith(" 1 frame.")
    assert "exists already" in bench.export("Table", tmp_path / "there.csv")
    assert window.message.isVisible() and (tmp_path / "there.csv").read_text() == "precious"
    assert "Exported 1 frame to" in bench.export("Table", tmp_path / "new.csv")
    assert not window.message.isVisible()
    assert "Exported 1 frame to" in bench.export("Video of the view", tmp_path / "one.mp4")
    assert [message.kind for message in window.messages.all][-3:] == ["error", "notice", "notice"]
    # a long message squeezes nothing
    dialog = bench.dialog
    long = "/a/folder/of/some/length/v.mp4: cannot be written; choose another place. " * 4
    window.messages.add("error", long, topic=TOPIC)
    bench.wait(lambda: dialog.message.text() == long)
    controls = (dialog.kind, dialog.frames, dialog.step, dialog.captioned, dialog.export)
    bench.wait(lambda: all(c.height() >= c.minimumSizeHint().height() for c in controls))
    labels = (dialog.about, dialog.message)
    bench.wait(lambda: all(at.height() >= at.heightForWidth(at.width()) for at in labels))
    # a table of the chosen range, with poses
    bench.dialog.step.setValue(1)
    state.set_range((3, 8))
    state.change(kappa=2.0)
    bench.bot.keyClick(bench.dialog.step, Qt.Key.Key_Up)
    assert bench.dialog.step.text() == "one of 2 frames"
    out = tmp_path / "mine.csv"
    assert "3 frames" in bench.export("Table", out)
    with out.open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["frame"]) for row in rows] == [3, 5, 7]
    bench.pick(bench.dialog.kind, "Plots")
    assert not bench.dialog.message.text()  # that was of the table
    assert float(rows[0]["patch_area_m2"]) == 0.0 < float(rows[2]["patch_area_m2"])
    bench.seek(7)
    patch = bench.result.patch
    assert float(rows[2]["threshold_pa"]) == pytest.approx(patch.threshold_pa, rel=0.2)
    assert "is no" not in bench.export("Table", tmp_path / "table", "Parquet (*.parquet)")
    import pyarrow.parquet

    assert pyarrow.parquet.read_table(tmp_path / "table.parquet").num_rows == 3
    bench.dialog.frames.setCurrentIndex(1)
    bench.dialog.step.setValue(1)
    bench.export("Table", tmp_path / "all.csv")
    assert len((tmp_path / "all.csv").read_text().splitlines()) == FRAMES + 1
    # poses that were found are in it
    window = bench.window
    window.pose.session.choose("cylinder")
    bench.wait(lambda: window.pose.session.obj is not None)
    window.pose.session.track(True)
    bench.seek(8)
    bench.wait(lambda: 8 in window.pose.session.rows)
    bench.export("Table", tmp_path / "poses.csv")
    with (tmp_path / "poses.csv").open() as file:
        rows = list(csv.DictReader(file))
    row = window.pose.session.rows[8]
    assert rows[8]["pose_status"] == row["status"] and not rows[0]["pose_status"]
    assert np.isclose(float(rows[8]["pose_x_m"]), row["x_m"], equal_nan=True)
    # proposed names have that of the recording
    source = DentSource(sensor)
    source.name = "left hand.mcap"
    bench.open("recording", lambda _: source, sensor, playing=False)
    bench.wait(lambda: bench.state.facts.title == source.name)
    asked = []
    answer = lambda *given, **_: asked.append(given[2]) or (None, "")  # noqa: E731
    monkeypatch.setattr(export_dialog, "new_file", answer)
    for title in ("Table", "Membrane series"):
        bench.pick(bench.dialog.kind, title)
        bench.click(bench.dialog.export)
    assert asked == ["left_hand_table.csv", "left_hand_membrane_series"]
    # nothing is exported while nothing is open
    bench.state.set_range((3, 8))
    assert not clipped_texts(dialog)
    box = dialog.frames
    assert box.fontMetrics().horizontalAdvance(box.currentText()) + 24 <= box.width()
    bench.key(Qt.Key.Key_W, CTRL)
    bench.wait(lambda: bench.state.facts.is_empty)
    assert "No recording is open" in dialog.about.text() and not dialog.export.isEnabled()
    assert dialog.frames.currentText() == "all 0 frames"
