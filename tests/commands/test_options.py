"""Options that commands share: former names, and overwriting."""

from functools import partial

import click
import numpy as np
import pytest

import bubbleviz as bv
from bubbleviz.cli.command_line import VERBS, main
from tests.program import output_of, refusal


def command(name):
    return main.get_command(click.Context(main), name)


@pytest.mark.parametrize(
    ("name", "needed", "former", "present"),
    [
        ("estimate", "R --out o", "--no-zero", "--no-zero-gas"),
        ("watch", "--source s", "--no-zero", "--no-zero-gas"),
        ("watch", "--source s", "--zero", "--zero-gas"),
        ("watch", "--source s", "--publish p", "--listen p"),
        ("watch", "--source s", "--publish-to p", "--connect p"),
        ("identify", "R --sensor s --out o", "--no-press", "--no-held-press"),
        ("convert", "a b", "--pressure p", "--gas-pressure p"),
    ],
)
def test_former_option_names_work_and_are_hidden(name, needed, former, present):
    def params(option):
        parent = click.Context(main, **main.context_settings)
        words = [*needed.split(), *option.split()]
        return command(name).make_context(name, words, parent=parent).params

    assert params(former) == params(present)
    assert "zero" in former or params(former) != params("")
    shown = output_of(name, "--help")
    assert present.split()[0] in shown and f"{former.split()[0]} " not in shown


@pytest.mark.parametrize("name", VERBS)
def test_every_option_has_a_text(name):
    """From the docstrings of the functions."""
    options = [each for each in command(name).params if isinstance(each, click.Option)]
    assert not [each.name for each in options if not (each.help or each.hidden)]


def test_pose_command_has_the_name_of_the_api_function_as_alias():
    assert command("track") is command("pose")


@pytest.mark.parametrize(
    ("words", "out"),
    [
        ("simulate --sensor S --object sphere --pose POSE", "new.mcap"),
        ("estimate REC --sensor S --csv CSV", "new.npz"),
        ("pose REC --sensor S --object cylinder --init POSE", "new.csv"),
        ("export REC --sensor S", "new.csv"),
        ("export REC --sensor S --what ply,depth", "folder"),
        ("export REC --sensor S --what lerobot", "folder"),
        ("record --source replay:REC?speed=100", "new.mcap"),
        ("record --source replay:REC?speed=100", "bag"),
        ("watch --source replay:REC?speed=100 --sensor S", "new.mcap"),
        ("convert REC OUT", "new.mcap"),
        ("convert REC OUT", "bag"),
        ("batch FOLDER --sensor S --jobs 1", "results"),
    ],
)
def test_existing_output_is_replaced_only_on_request(words, out, press, sensor, tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.mcap").write_bytes(press.read_bytes())
    given = {"REC": press, "S": sensor, "CSV": tmp_path / "more.csv", "FOLDER": tmp_path / "in"}
    given |= {"POSE": "0 0 0.045 0 0 0 1", "OUT": tmp_path / out}
    line = [str(given.get(word, word)).replace("REC", str(press)) for word in words.split()]
    line += [] if "OUT" in words else ["--out", str(tmp_path / out)]
    output_of(*line)
    names = sorted(path.name for path in tmp_path.rglob("*"))
    assert "exists already" in refusal(*line)
    output_of(*line, "--overwrite")
    assert sorted(path.name for path in tmp_path.rglob("*")) == names


def test_failure_keeps_the_existing_output(sensor, tmp_path):
    for name in ("rec.mcap", "new.npz", "mine.toml"):
        (tmp_path / name).write_text("precious")
    for words in (
        ("record", "--source", "replay:nowhere", "--out", tmp_path / "rec.mcap"),
        ("estimate", "nowhere", "--sensor", sensor, "--out", tmp_path / "new.npz"),
        ("identify", "nowhere", "--sensor", sensor, "--out", tmp_path / "mine.toml"),
    ):
        refusal(*words, "--overwrite")
    assert {path.read_text() for path in tmp_path.iterdir()} == {"precious"}


def test_folder_with_foreign_files_is_not_replaced(press, sensor, tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    words = ("--sensor", sensor, "--what", "ply", "--out", tmp_path, "--overwrite")
    assert "thesis.tex" in refusal("export", press, *words)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_api_replaces_existing_output_on_request(press, sensor, tmp_path):
    run_of = bv.estimate(bv.open(press), sensor)
    for overwrite in (False, True):
        bv.save_sensor(bv.load_sensor(sensor), tmp_path / "mine.toml", overwrite=overwrite)
        run_of.save(tmp_path / "r.npz", tmp_path / "r.csv", overwrite=overwrite)
    with np.load(tmp_path / "r.npz") as file:
        assert file["patch_mask"][1].any()
        np.testing.assert_array_equal(file["force_n"], run_of.force_n)


def test_unused_output_options_are_refused(press, sensor, tmp_path):
    with pytest.raises(bv.InputError, match=r"r\.csv: .* set out as well"):
        bv.estimate(bv.open(press), sensor, csv=tmp_path / "r.csv")
    with bv.connect(f"replay:{press}", sensor) as stream:
        for verb in (bv.estimate, partial(bv.track, object="sphere")):
            with pytest.raises(bv.InputError, match="write no files for a live stream; record it"):
                verb(stream, out=tmp_path / "r.npz")
