"""Two recordings of one press on one time axis."""

import json

import numpy as np
import pytest
from small_press import changed, write_press

import bubbleviz as bv
from bubbleviz.errors import InputError
from bubbleviz.recordings import RecordingWriter
from tests.program import facts_of, output_of, rows_of

CLEAR, PRESS = (0.060,), (0.046, 0.044, 0.042, 0.041, 0.042, 0.045)
LATER = 3
"""Frames by which the press of the second recording is later."""
STEP_S = 1.0 / 30.0


@pytest.fixture(scope="module")
def recordings(sensor, tmp_path_factory):
    """The same press, recorded with other noise, once later."""
    waits, folder = {"a": 2, "b": 2 + LATER}, tmp_path_factory.mktemp("recordings")
    return [
        write_press(folder / f"{name}.mcap", sensor, wait * CLEAR + PRESS, seed)
        for seed, (name, wait) in enumerate(waits.items())
    ]


@pytest.fixture(scope="module")
def runs(sensor, recordings):
    return [bv.estimate(path, sensor) for path in recordings]


def test_by_contact_each_frame_meets_the_frame_of_the_same_moment(runs):
    found = bv.compare(*runs, align="contact")
    assert found.shift_s == pytest.approx(LATER * STEP_S, abs=1e-6)
    np.testing.assert_allclose(found.other_force_n, runs[1].force_n[LATER:], atol=1e-4)
    areas = [run.columns()["patch_area_m2"] for run in runs]
    np.testing.assert_allclose(found.other_area_m2, areas[1][LATER:], rtol=1e-4)
    told, touching = found.facts(), areas[0] > 0.0
    assert told["frames"] == 8 and told["contact_frames"] == touching.sum() >= 5
    difference = np.linalg.norm(runs[1].force_n[LATER:] - runs[0].force_n, axis=1)[touching]
    for statistic, value in (
        ("median", np.median(difference)),
        ("p95", np.percentile(difference, 95.0)),
        ("max", difference.max()),
    ):
        assert told[f"{statistic}_force_difference_n"] == pytest.approx(value, abs=1e-4)
    by_time = bv.compare(*runs).facts()
    assert by_time["shift_s"] == 0.0
    assert by_time["median_force_difference_n"] > 5.0 * told["median_force_difference_n"]


def test_frames_between_those_of_the_other_one_are_interpolated_but_not_where_they_are_missing(
    sensor, recordings, tmp_path
):
    whole, holed = bv.open(recordings[0]), tmp_path / "holed.mcap"
    with RecordingWriter(holed) as writer:
        for k, frame in enumerate(whole):
            if k != 4:
                writer.write(frame)
    run = bv.estimate(whole, sensor)
    found = bv.compare(run, bv.estimate(holed, sensor))
    assert np.flatnonzero(np.isnan(found.force_difference_n)).tolist() == [4]
    half = bv.compare(run, bv.estimate(whole[::2], sensor))
    mean = 0.5 * (half.other_force_n[2] + half.other_force_n[4])
    np.testing.assert_allclose(half.other_force_n[3], mean, atol=1e-3)
    assert np.isnan(half.other_force_n[-1]).all()  # after its last frame


def test_the_command_takes_recordings_results_and_another_sensor_file(
    sensor, recordings, runs, tmp_path
):
    stiffer = bv.load_sensor(sensor)
    gauge = {"gauge_pressure_pa": 1.5 * stiffer.pneumatics.gauge_pressure_pa}
    other = tmp_path / "other.toml"
    bv.save_sensor(changed(stiffer, pneumatics=gauge), other)
    saved = tmp_path / "a.npz"
    runs[0].save(saved)
    words = ["compare", saved, recordings[0], "--other-sensor", other]
    told = facts_of(*words, "--out", tmp_path / "all")
    share = told["max_force_difference_n"] / np.linalg.norm(runs[0].force_n, axis=1).max()
    assert share == pytest.approx(0.5, abs=0.1)  # force is proportional to the gauge pressure
    assert json.loads((tmp_path / "all" / "comparison.json").read_text()) == told
    assert (tmp_path / "all" / "comparison.png").read_bytes().startswith(b"\x89PNG")
    rows = rows_of(tmp_path / "all" / "comparison.csv")
    assert [float(row["force_z_n"]) for row in rows] == pytest.approx(runs[0].force_n[:, 2])
    text = output_of("compare", *recordings, "--sensor", sensor, "--align", "contact")
    assert "aligned by first contact: b.mcap shifted 0.100 s earlier" in text and "N median" in text


def test_what_cannot_be_compared_is_refused(runs, tmp_path):
    clear = runs[1][: 2 + LATER]
    with pytest.raises(InputError, match=r"b\.mcap: no contact was found; use --align time"):
        bv.compare(runs[0], clear, align="contact")
    with pytest.raises(InputError, match="at no time do both have a trusted force"):
        bv.compare(runs[0][:2], runs[0][4:])
    with pytest.raises(InputError, match=r"end it in \.png"):
        bv.compare(*runs, out=tmp_path / "a.xyz")
