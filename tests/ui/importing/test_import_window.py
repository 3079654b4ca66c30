"""Imports from the window by clicks and keys, read back from the recording."""

import json
import threading

import numpy as np
import pytest
from PIL import Image
from PySide6.QtWidgets import QFileDialog
from window_driver import Driver

from bubbleviz.recordings import ImageFolder, Recording
from bubbleviz_ui.importing.import_dialog import RATE, TABLE, ImportDialog
from tests.recordings.bagmaker import BagMaker, fill

SMALL = (1024, 700)


class Bench(Driver):
    """The window with its import dialog open, driven by clicks and keys."""

    def __init__(self, driver, monkeypatch):
        super().__init__(driver.bot, driver.window)
        self._patch = monkeypatch
        self.trigger("File › Import")
        assert self.dialog.isVisible()

    @property
    def dialog(self):
        dialog = self.window.findChild(ImportDialog)
        assert isinstance(dialog, ImportDialog)
        return dialog

    def choose_folder(self, path):
        self._patch.setattr(QFileDialog, "getExistingDirectory", lambda *_, **__: str(path))
        self.click(self.dialog.folder)

    def choose_file(self, field, path):
        self._patch.setattr(QFileDialog, "getOpenFileName", lambda *_, **__: (str(path), ""))
        self.click(field.browse)

    def choose_times(self, title):
        self.pick(self.dialog.images.timing, title)

    def begin(self):
        self.click(self.dialog.begin)

    def run(self):
        """Import and wait; returns the message of the dialog."""
        self.begin()
        self.wait(lambda: self.dialog.begin.isEnabled())
        window = self.window
        problem, made = self.dialog.problem.text(), self.dialog.made.text()
        assert not window.message.isVisible()  # shown only in the dialog
        assert problem or made == window.notice.label.toolTip()
        return problem or made


@pytest.fixture
def bench(drive, monkeypatch, tmp_path):
    made = Bench(drive(frame=3), monkeypatch)
    made.state.change(record_folder=str(tmp_path))  # where recordings go
    yield made
    made.release()


@pytest.fixture
def images(press, tmp_path):
    """The press as a folder of 16-bit images of 0.1 mm, with its camera."""
    folder = tmp_path / "images"
    folder.mkdir()
    for k in range(3):
        depth = np.rint(1e4 * np.nan_to_num(press[k].depth_m)).astype(np.uint16)
        Image.fromarray(depth).save(folder / f"{k}.png")
    camera = press[0].intrinsics
    assert camera is not None
    names = ("width", "height", "fx", "fy", "cx", "cy")
    (folder / "intrinsics.json").write_text(
        json.dumps({name: getattr(camera, name) for name in names})
    )
    return folder


def test_folder_of_images_is_imported_and_opens(bench, images, press):
    dialog, driver = bench.dialog, bench
    bench.choose_folder(images)
    (images.parent / "gas.csv").write_text("time_s,pa\n0,103000\n1,104000\n")
    (images.parent / "wrench.csv").write_text("0,1,2,3,4,5,6\n1,1,2,3,4,5,6\n")
    bench.choose_file(dialog.images.gas_pressure, images.parent / "gas.csv")
    bench.choose_file(dialog.images.wrench, images.parent / "wrench.csv")
    bench.choose_times(RATE)
    dialog.images.rate.selectAll()
    driver.bot.keyClicks(dialog.images.rate, "10")
    dialog.images.unit.setCurrentText("0.1 mm")
    assert "3 frames" in bench.run()
    out = images.parent / "images.mcap"
    with Recording(out) as recording:
        assert recording.times_s == pytest.approx([0.0, 0.1, 0.2], abs=1e-6)
        np.testing.assert_allclose(recording[2].depth_m, press[2].depth_m, atol=6e-5)
        assert recording[1].gas_pressure_pa == pytest.approx(103_100.0, abs=1.0)
        assert recording[1].wrench == pytest.approx([1, 2, 3, 4, 5, 6], abs=1e-3)
    driver.click(dialog.open_made)
    driver.wait(lambda: driver.state.facts.title == "images.mcap")
    assert not dialog.isVisible()


def test_only_applicable_options_are_shown(bench, images, tmp_path):
    dialog = bench.dialog
    fields = dialog.images
    assert not fields.unit.isVisible() and not dialog.begin.isEnabled()
    bench.choose_folder(images)
    assert fields.unit.isVisible() and not fields.rate.isVisible()
    bench.choose_times(TABLE)
    assert fields.times.isVisible() and not fields.rate.isVisible()
    bench.choose_times(RATE)
    assert fields.rate.isVisible() and not fields.times.isVisible()
    assert dialog.sizeHint().width() <= SMALL[0] and dialog.sizeHint().height() <= SMALL[1]
    bag = fill(BagMaker("bag lz4")).write(tmp_path)
    bench.choose_file(dialog.source, bag)
    assert not any(w.isVisible() for w in (fields.unit, fields.rate, fields.times, fields.wrench))
    assert dialog.out.text() == str(bag.with_suffix(".mcap"))
    assert "6 frames" in bench.run()
    with Recording(bag) as before, Recording(bag.with_suffix(".mcap")) as after:
        np.testing.assert_array_equal(after[5].depth_m, before[5].depth_m)


def test_errors_are_shown_in_the_dialog_and_nothing_is_written(bench, images, tmp_path):
    before = sorted(images.parent.rglob("*"))
    bench.choose_folder(images)
    assert "give the rate of the images" in bench.run()
    bench.choose_times(RATE)
    assert not bench.dialog.problem.text() and not bench.dialog.problem.isVisible()
    bench.choose_file(bench.dialog.images.wrench, images / "intrinsics.json")
    assert "intrinsics.json: no rows, or a row without 7 finite numbers" in bench.run()
    assert not bench.dialog.open_made.isVisible()
    assert sorted(images.parent.rglob("*")) == before
    bench.dialog.images.wrench.line.clear()
    assert not bench.dialog.problem.text()
    assert "3 frames" in bench.run()
    assert not bench.window.message.isVisible()
    assert "exists already" in bench.run()
    # a typed name that does not exist
    bench.dialog.source.line.clear()
    bench.bot.keyClicks(bench.dialog.source.line, "/no/such.bag")
    assert bench.dialog.out.text() == str(tmp_path / "such.mcap")
    assert "/no/such.bag" in bench.run()
    bench.dialog.out.setText("/no/such.mcap")
    assert "folder /no does not exist" in bench.run()


def test_cancelled_import_leaves_no_file(bench, images, monkeypatch):
    reading, go_on = threading.Event(), threading.Event()
    read = ImageFolder.__getitem__

    def slow(folder, index):
        reading.set()
        go_on.wait()
        return read(folder, index)

    monkeypatch.setattr(ImageFolder, "__getitem__", slow)
    dialog, before = bench.dialog, sorted(images.parent.rglob("*"))
    bench.choose_folder(images)
    bench.choose_times(RATE)
    bench.begin()
    bench.wait(reading.is_set)
    assert dialog.cancel.isVisible() and not dialog.images.unit.isEnabled()
    bench.click(dialog.cancel)
    assert not dialog.cancel.isVisible() and dialog.begin.isEnabled()
    go_on.set()
    bench.window.menus.importing.close()
    assert sorted(images.parent.rglob("*")) == before
    assert not dialog.made.text() and not dialog.problem.text()
