"""One bad file name or image spoils nothing else of its folder or recording."""

import shutil
import time

import numpy as np

import bubbleviz as bv
from tests.program import facts_of, output_of, rows_of, run
from tests.recordings.bagmaker import PERIOD, START, BagMaker


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
    words = ("--sensor", "pico_flexx_75mm", "--out", tmp_path / "r.npz")
    told = facts_of("estimate", bag.write(tmp_path), *words)
    assert told["status"] == {"no_contact": 1, "implausible": 1}
    assert time.process_time() - begun < 4.0  # the solver's start included
