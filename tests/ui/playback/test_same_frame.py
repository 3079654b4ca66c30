"""During playback, everything that shows the frame is painted for the same one."""

import re

from PySide6.QtCore import QEvent, QObject
from window_driver import CONTACT, graphics_view, view_texts


class Paints(QObject):
    """Texts with forces and frames, whenever one of their widgets is painted.

    That of the 3-D view is the one in its last picture.
    """

    def __init__(self, driver):
        super().__init__()
        self.headline = ""
        self.seen: list[tuple[tuple[str, ...], tuple[str, ...]]] = []
        window = driver.window
        status, readout = window.status.labels, window.playback.readout
        canvas = graphics_view(window.plots).viewport()
        self.widgets = [*window.status.numbers, readout, window.playback.timeline, canvas]
        self.forces = lambda: (
            self.headline,
            status["force"].text(),
            window.kappa.force.text(),
            re.sub("<.*?>", "", window.plots.plots["force"].text),
        )
        self.frames = lambda: (status["frame"].text(), readout.text())
        for widget in self.widgets:
            widget.installEventFilter(self)
        self.render_window = window.view.ren_win
        self.tag = self.render_window.AddObserver(
            "EndEvent", lambda *_: setattr(self, "headline", view_texts(driver)[0])
        )

    def eventFilter(self, _, event):
        if event.type() == QEvent.Type.Paint:
            self.seen.append((self.forces(), self.frames()))
        return False

    def end(self):
        self.render_window.RemoveObserver(self.tag)
        for widget in self.widgets:
            widget.removeEventFilter(self)
        del self.widgets, self.render_window, self.forces, self.frames


def test_picture_status_bar_plot_and_playback_are_painted_for_the_same_frame(drive):
    driver = drive(frame=CONTACT)
    driver.show("plots")
    driver.choose(plots=frozenset({"force"}), loop=True)
    driver.state.set_range((CONTACT, CONTACT + 20))  # all in contact
    driver.wait_until_shown()
    paints = Paints(driver)
    driver.state.set_playing(True)
    driver.wait(lambda: len({frames[0] for _, frames in paints.seen}) > 10)
    driver.state.set_playing(False)
    paints.end()
    assert paints.headline
    for forces, frames in paints.seen:
        assert len({*re.findall(r"\d+\.\d+ ± \d+\.\d+", " ".join(forces))}) == 1, forces
        assert len({*re.findall(r"frame \d+", " ".join(frames))}) == 1, frames
