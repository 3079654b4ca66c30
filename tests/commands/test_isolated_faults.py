"""One bad message, file name or image spoils nothing else of its recording or folder."""

import csv
import json
import shutil
import time

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

import bubbleviz as bv
from tests.program import output_of, run
from tests.recordings.bagmaker import PERIOD, START, BagMaker


def copied(source, path, change):
    """Copy an MCAP file; `change(data, k)` replaces the k-th depth message."""
    counts, channels = {}, {}
    with source.open("rb") as file, path.open("wb") as out:
        writer = Writer(out)
        writer.start("ros2", "copy")
        for schema, channel, message in make_reader(file).iter_messages():
            k = counts[channel.topic] = counts.get(channel.topic, -1) + 1
            if not k:
                known = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, "cdr", known)
            is_depth = channel.topic.endswith("image_raw")
            data = change(message.data, k) if is_depth else message.data
            log_ns = message.log_time
            writer.add_message(channels[channel.topic], log_ns, data, log_ns, message.sequence)
        writer.finish()
    return path


def estimated(recording, sensor, folder, *more):
    """Rows of a recording's table by frame."""
    table = folder / f"{recording.stem}{len(more)}.csv"
    words = ("--sensor", sensor, "--out", table.with_suffix(".npz"), "--csv", table, *more)
    output_of("estimate", recording, *words)
    with table.open() as file:
        return {int(row["frame"]): row for row in csv.DictReader(file)}


@pytest.mark.parametrize("bad", [0, 2])
def test_an_empty_message_is_one_bad_frame(tmp_path, press, sensor, bad):
    """Which `info` lists, and `--frames` may leave out."""
    damaged = copied(press, tmp_path / "rec.mcap", lambda data, k: b"" if k == bad else data)
    told = output_of("info", damaged).splitlines()
    (line,) = (line for line in told if line.startswith("bad frames"))
    assert line.split()[2] == "1" and line.split()[-1] == str(bad)
    rows, whole = estimated(damaged, sensor, tmp_path), estimated(press, sensor, tmp_path)
    assert rows[bad]["status"] == "no_data"
    assert {k: row["status"] for k, row in rows.items() if k != bad} == {
        k: row["status"] for k, row in whole.items() if k != bad
    }
    assert estimated(damaged, sensor, tmp_path, "--frames", "3:4")[3]["status"] == "ok"


@pytest.mark.parametrize(
    ("name", "shown"), [("=1+1.mcap", "'=1+1.mcap"), ("b\udcff.mcap", r"b\udcff.mcap")]
)
def test_name_that_is_a_formula_or_not_utf8(tmp_path, press, sensor, name, shown):
    (tmp_path / "in").mkdir()
    shutil.copy(press, tmp_path / "in" / name)
    words = ("batch", tmp_path / "in", "--sensor", sensor, "--out", tmp_path / "out", "--jobs", "1")
    done = run(*words)
    assert (done.exit_code, done.stderr) == (0, "")
    with (tmp_path / "out" / "summary.csv").open(newline="", encoding="utf-8") as file:
        assert [row["recording"] for row in csv.DictReader(file)] == [shown]
    rows = json.loads(output_of(*words, "--resume", "--json"))["rows"]
    assert [(row["recording"], row["outcome"]) for row in rows] == [(name, "kept")]


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
