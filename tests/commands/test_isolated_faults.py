"""One bad message, file name or image spoils nothing else of its recording or folder."""

import shutil
import time

import numpy as np
import pytest

import bubbleviz as bv
from tests.program import facts_of, output_of, rows_of, run
from tests.recordings.bagmaker import PERIOD, START, BagMaker
from tests.recordings.mcap_copy import copied


def estimated(recording, sensor, folder, *more):
    """Rows of a recording's table by frame."""
    table = folder / f"{recording.stem}{len(more)}.csv"
    words = ("--sensor", sensor, "--out", table.with_suffix(".npz"), "--csv", table, *more)
    output_of("estimate", recording, *words)
    return {int(row["frame"]): row for row in rows_of(table)}


@pytest.mark.parametrize("bad", [0, 2])
def test_an_empty_message_is_one_bad_frame(tmp_path, press, sensor, bad):
    """Which `info` lists, and `--frames` may leave out."""

    def emptied(topic, data, k):
        return b"" if k == bad and topic.endswith("image_raw") else data

    damaged = copied(press, tmp_path / "rec.mcap", emptied)
    told = output_of("info", damaged).splitlines()
    (line,) = (line for line in told if line.startswith("bad frames"))
    assert line.split()[2] == "1" and line.split()[-1] == str(bad)
    rows, whole = estimated(damaged, sensor, tmp_path), estimated(press, sensor, tmp_path)
    assert rows[bad]["status"] == "no_data"
    assert {k: row["status"] for k, row in rows.items() if k != bad} == {
        k: row["status"] for k, row in whole.items() if k != bad
    }
    assert estimated(damaged, sensor, tmp_path, "--frames", "3:4")[3]["status"] == "ok"


def test_names_that_are_a_formula_or_not_utf8(tmp_path, press, sensor):
    shown = {"=1+1.mcap": "'=1+1.mcap", "b\udcff.mcap": r"b\udcff.mcap"}
    (tmp_path / "in").mkdir()
    for name in shown:
        shutil.copy(press, tmp_path / "in" / name)
    words = ("batch", tmp_path / "in", "--sensor", sensor, "--out", tmp_path / "out", "--jobs", "1")
    done = run(*words)
    assert (done.exit_code, done.stderr) == (0, "")
    rows = rows_of(tmp_path / "out" / "summary.csv")
    assert [row["recording"] for row in rows] == list(shown.values())
    rows = facts_of(*words, "--resume")["rows"]
    assert [(row["recording"], row["outcome"]) for row in rows] == [(k, "kept") for k in shown]


def test_implausible_frame_takes_no_seconds(tmp_path):
    """The membrane at rest, a tenth nearer to the camera; processor time counts."""
    words = ("--sensor", "pico_flexx_75mm", "--object", "sphere", "--pose", "0 0 0.07 0 0 0 1")
    output_of("simulate", *words, "--out", tmp_path / "rest.mcap")
    with bv.open(tmp_path / "rest.mcap") as recording:
        rest = recording[0].depth_m
    bag = BagMaker("mcap file")
    for k, scale in enumerate((1.0, 0.9)):
        bag.image(START + k * PERIOD, rest * np.float32(scale))
    begun = time.process_time()
    rows = estimated(bag.write(tmp_path), "pico_flexx_75mm", tmp_path)
    assert [row["status"] for row in rows.values()] == ["no_contact", "implausible"]
    assert time.process_time() - begun < 4.0  # the solver's start included
