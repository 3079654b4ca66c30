"""Make the pictures of the window on the pages.

Run as `.venv/bin/python docs/window_pictures.py ../shared/data/punyo_press_a docs`.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from PIL import Image
from PySide6.QtWidgets import QWidget

from bubbleviz.files import SYNTHETIC_SENSOR
from bubbleviz.live import load_session
from bubbleviz.recordings import checked_sensor
from bubbleviz.sensor import load_sensor
from bubbleviz_ui.app import screen_for_pictures
from bubbleviz_ui.export.export_dialog import ExportDialog
from bubbleviz_ui.importing.import_dialog import RATE, ImportDialog
from bubbleviz_ui.model.registry import IMAGES, PANELS, PLOTS
from bubbleviz_ui.model.scene_presets import load_scene
from bubbleviz_ui.model.settings import ComparedSetting, Settings
from bubbleviz_ui.panels.status_bar import PerformancePopup
from bubbleviz_ui.shell.command_palette import CommandPalette
from bubbleviz_ui.shell.shortcuts import ShortcutsDialog
from bubbleviz_ui.window_session import Startup, WindowSession, window_session

FRAME = 80  # of the real press: held
MARKED = 75
LOOPED = (60, 85)
SYNTHETIC_FRAME = 76
SMALL, LARGE = (960, 600), (1280, 800)
SIZES = {
    "1920x1080": (1920, 1080, 1.0), "1280x800": (1280, 800, 1.0), "1024x700": (1024, 700, 1.0),
    "1024x700-150": (683, 467, 1.5),
}  # fmt: skip
"""Width and height in Qt's pixels, and how many of the screen each has along a side."""
SHOWN = ("kappa", "threshold", "compare", "tools", "pose", "calibration", "plots", "images")
ALWAYS = ("playback", "status")
COMPUTED_S = 5.0  # until a panel has what it computes by itself
FIRM_M2 = 400e-6  # area of the patch
AREAS = 8  # of one colour, in a picture
GAMMA0 = 3  # step of the calibration panel
SECTION = {
    "section_axis": "y", "exaggeration": 2.0, "colour_map": "viridis",
    "view_from": (0.05, -1.0, 0.1), "layers": frozenset({"membrane", "contour", "rim"}),
}  # fmt: skip


def rest(session: WindowSession) -> None:
    """Let the window go on for a while."""
    end = time.monotonic() + COMPUTED_S
    session.wait_for(lambda: time.monotonic() > end, "the panel")


def wait_for_frame(session: WindowSession) -> None:
    """Wait until the frame is solved and drawn."""
    state, controller = session.state, session.controller
    session.wait_for(
        lambda: (
            controller.result is not None
            and controller.result.frame.index == state.frame
            and controller.cold_solved
        ),
        "the frame",
    )
    session.wait_until_drawn()


def picture(session: WindowSession, out: Path, size: tuple[int, int]) -> None:
    """Write the whole window."""
    for _ in range(2):  # the docks' place, on which the least size depends, follows the size
        session.window.resize(*size)
        wait_for_frame(session)
    rest(session)
    session.wait_until_drawn()
    session.save(out)
    in_few_colours(out)


def in_few_colours(out: Path) -> None:
    """Make a file half as large, which nobody sees; large areas keep their colour undithered."""
    image = Image.open(out).convert("RGB")
    found, counts = np.unique(np.asarray(image).reshape(-1, 3), axis=0, return_counts=True)
    areas = found[np.argsort(-counts)[:AREAS]]
    shades = image.quantize(256 - AREAS, Image.Quantize.FASTOCTREE).getpalette() or []
    colours = Image.new("P", (1, 1))
    colours.putpalette(areas.ravel().tolist() + shades[: 3 * (256 - AREAS)])
    image.quantize(palette=colours, dither=Image.Dither.FLOYDSTEINBERG).save(out, optimize=True)
    print(f"wrote {out}")


def pop_up(session: WindowSession, kind: type[QWidget], out: Path) -> None:
    """Write a dialog that has just been opened, and close it."""
    session.wait_until_drawn()
    (dialog,) = (each for each in session.window.findChildren(kind) if each.isVisible())
    dialog.grab().save(str(out))
    dialog.close()
    in_few_colours(out)


def open_panel(session: WindowSession, name: str, **settings: Any) -> None:
    """Show a panel beside the press, where settings are as at first but for some."""
    scene = load_scene("press")
    beside = ALWAYS if PANELS[name].side == "right" else ("kappa", *ALWAYS)
    measured: list[object] = []
    comparing = session.controller.compared.connect(lambda *found: measured.append(found))
    panels = frozenset({name, *beside})
    session.window.use_scene(replace(scene, settings={**scene.settings, "panels": panels}))
    session.window.panels[name].raise_()
    session.state.change(**{"images": Settings().images, "plots": Settings().plots, **settings})
    session.window.scene.reset_view()
    session.window.hover.leave()
    if name == "compare":
        session.wait_for(lambda: bool(measured), "comparing")
    session.controller.compared.disconnect(comparing)
    if name == "images":
        result = session.controller.result
        assert result is not None and result.patch is not None
        session.window.hover.at_point(result.patch.center_of_pressure_m)


def analyse(session: WindowSession) -> None:
    """Compute what the plots show of all frames."""
    analysed: list[tuple[int, int]] = []
    session.controller.analysis.progressed.connect(lambda *done: analysed.append(done))
    session.controller.analysis.start()
    session.wait_for(lambda: bool(analysed) and analysed[-1][0] == analysed[-1][1], "all frames")


def panels(session: WindowSession, folder: Path, theme: str) -> None:
    """Every panel, and what pops up."""
    for name in SHOWN:
        open_panel(session, name)
        picture(session, folder / f"{name}-{theme}.png", SMALL)
    window = session.window
    for show, kind, name in (
        (window.menus.show_performance, PerformancePopup, "costs"),
        (window.menus.show_export, ExportDialog, "export"),
        (window.menus.show_import, ImportDialog, "import"),
        (window.shortcuts.actions["Help › Command palette"].trigger, CommandPalette, "palette"),
        (window.menus.show_shortcuts, ShortcutsDialog, "shortcuts"),
    ):
        show()
        pop_up(session, kind, folder / f"{name}-{theme}.png")


def workbench(session: WindowSession, folder: Path, theme: str) -> None:
    """What a recording is gone through with."""
    end = "" if theme == "dark" else f"-{theme}"
    session.state.set_range(LOOPED)
    open_panel(session, "plots", plots=frozenset(PLOTS))
    picture(session, folder / f"review{end}.png", LARGE)
    session.state.set_range(None)
    open_panel(session, "images", images=frozenset(IMAGES))
    picture(session, folder / f"images{end}.png", LARGE)
    before = {name: getattr(session.state.settings, name) for name in SECTION}
    open_panel(session, "tools", **SECTION)
    picture(session, folder / f"tools{end}.png", LARGE)
    session.state.change(**before)


def import_images(session: WindowSession) -> None:
    """Have the dialog import a folder of depth images."""
    with TemporaryDirectory() as folder, chdir(folder):
        images = Path("press-01")
        images.mkdir()
        for k in range(3):
            np.save(images / f"{k}.npy", np.full((24, 32), 0.1))
        session.window.menus.show_import()
        (dialog,) = session.window.findChildren(ImportDialog)
        dialog.source.line.setText(str(images))
        dialog.images.timing.setCurrentText(RATE)
        dialog.begin.click()
        session.wait_for(lambda: bool(dialog.made.text()), "importing")
        dialog.close()


def sized(recording: Path, out: Path, width: int, height: int, scale: float) -> None:
    """The press with its plots in a window of another size; for a process of its own."""
    os.environ["QT_SCALE_FACTOR"] = str(scale)
    _, sensor = checked_sensor(recording, "auto")
    with (
        screen_for_pictures(round(scale * width), round(scale * height)),
        opened(sensor, recording, FRAME, load_scene("press")) as session,
    ):
        session.state.change(theme="dark")
        picture(session, out, (width, height))


def gamma0(session: WindowSession, out: Path) -> None:
    """The calibration panel's γ0 of the frames without contact."""
    panel = session.window.calibration
    session.window.use_scene(load_scene("calibrate"))
    for button in (panel.next, panel.all):
        button.click()
        session.wait_for(lambda: not panel.calibration.busy, "identifying")
    panel.go_to(GAMMA0)
    picture(session, out, LARGE)


def live_pair(session: WindowSession, out: Path) -> None:
    """Two live sensors, both firmly in contact, frozen."""
    clients = session.controller.clients

    def both_touch() -> bool:
        patches = [client.result.trusted_patch for client in clients]
        return len(patches) == 2 and all(
            each is not None and each.area_m2 > FIRM_M2 for each in patches
        )

    session.wait_for(both_touch, "contact of both")
    session.save_still(out)
    in_few_colours(out)


@contextmanager
def opened(*arguments: Any, **named: Any) -> Iterator[WindowSession]:
    """A window in sight, with everything of its source drawn."""
    with window_session(Startup(*arguments, **named)) as session:
        session.window.resize(*LARGE)
        session.window.show()
        session.wait_until_drawn()
        yield session


def main() -> None:
    """Make all of them."""
    recording, docs = map(Path, sys.argv[1:])
    for name, size in SIZES.items():
        out = docs / "sizes" / f"{name}.png"
        process = get_context("spawn").Process(target=sized, args=(recording, out, *size))
        process.start()
        process.join()
    _, sensor = checked_sensor(recording, "auto")
    synthetic = load_sensor(SYNTHETIC_SENSOR)
    with screen_for_pictures(*LARGE):
        with opened(sensor, recording, FRAME, load_scene("press")) as session:
            analyse(session)
            import_images(session)
            session.state.toggle_marker(MARKED)
            for theme in ("dark", "light"):
                session.state.change(theme=theme)
                panels(session, docs / "panels", theme)
                workbench(session, docs / "workbench", theme)
            session.state.change(theme="dark")
            open_panel(session, "threshold", least_area_m2=20e-6)
            picture(session, docs / "workbench" / "threshold.png", LARGE)
        with opened(synthetic, None, SYNTHETIC_FRAME, load_scene("press")) as session:
            session.state.change(
                theme="dark", compared=(ComparedSetting(), ComparedSetting(nodes=400, kappa=8.0))
            )
            open_panel(session, "compare")
            picture(session, docs / "workbench" / "compare.png", LARGE)
        with opened(sensor, recording, 0) as session:
            session.state.change(theme="dark")
            gamma0(session, docs / "gamma0.png")
        with opened(
            synthetic, None, None, load_scene("dual_nut"), live=load_session("dual_nut")
        ) as session:
            session.state.change(theme="dark")
            live_pair(session, docs / "live.png")


if __name__ == "__main__":
    main()
