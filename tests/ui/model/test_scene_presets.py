"""Scene presets: hidden products are not computed, invalid presets are refused."""

from dataclasses import replace

import pytest
from click.testing import CliRunner
from fakes import DentSource

from bubbleviz.cli.command_line import main
from bubbleviz.errors import InputError
from bubbleviz.files import preset_names, presets_folder, read_toml
from bubbleviz_ui.model.demand import needed_products
from bubbleviz_ui.model.scene_presets import load_scene
from bubbleviz_ui.model.settings import Settings

RUNS = {
    "calibrate": {"estimate", "fine_contact", "patch", "cloud", "residual"},
    "press": {"estimate", "fine_contact", "patch"},
    "pose": {"estimate", "fine_contact", "patch"},
    "cloud": {"cloud"},
    "dual_nut": {"estimate", "fine_contact", "patch"},
    "residual": {"estimate", "fine_contact", "patch", "cloud", "residual"},
    "review": {"estimate", "fine_contact", "patch"},
    # the linear membrane has no traction
    "shear": {"estimate", "fine_contact", "patch", "texture"},
}
"""Stages each scene runs."""


def test_every_shipped_scene_is_covered_by_these_tests():
    assert preset_names("scenes") == sorted(RUNS)
    said = " ".join(CliRunner().invoke(main, ["open", "--help"]).stdout.split())
    assert f"Scene preset: {', '.join(sorted(RUNS))}." in said


def test_scene_files_have_a_title_and_fields_of_the_settings():
    """A misspelt one would have no effect."""
    for name in RUNS:
        read = read_toml(presets_folder("scenes") / f"{name}.toml")
        assert "title" in read and read.keys() - {"title"} <= Settings.group("scene"), name


def test_scenes_show_their_panels_and_layers_and_run_no_other_stages(drive):
    assert replace(Settings(), **load_scene("press").settings) == Settings()
    driver = drive(DentSource, frame=6)
    assert driver.pipeline.counts["cloud"] == 0
    boxes = driver.window.layers.boxes
    for name in sorted(RUNS):
        preset = load_scene(name)
        driver.window.use_scene(preset)
        driver.wait_until_shown()
        shown = {panel for panel, w in driver.window.panels.items() if w.isVisible()}
        assert shown == preset.settings["panels"], name
        checked = {layer for layer, box in boxes.items() if box.isChecked()}
        assert checked == preset.settings["layers"], name
        assert driver.window.layers.cloud_points.currentIndex() >= 0, name
        assert preset.settings["cloud_points"] in Settings.info("cloud_points").titles, name
        driver.seek(7)
        before = driver.pipeline.counts.copy()
        driver.seek(8)
        ran = set((driver.pipeline.counts - before).elements()) - {"total"}
        assert ran == RUNS[name], name
    before = tuple(driver.window.view.camera.position)
    driver.window.use_scene(load_scene("cloud"))
    assert tuple(driver.window.view.camera.position) != pytest.approx(before)
    assert not {"kappa", "speed", "loop"} & load_scene("press").settings.keys()
    assert needed_products(Settings(**load_scene("cloud").settings)) == {"cloud"}


def test_an_unknown_scene_is_refused_by_name():
    with pytest.raises(InputError, match=r'"nope".*cloud, dual_nut, pose, press, residual'):
        load_scene("nope")
