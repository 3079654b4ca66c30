"""Errors of depth and camera in the recording of the real press, by the command alone.

A frame must be refused, warned of, or have the force of the undisturbed recording in its interval.
"""

import re
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest

from bubbleviz.sensor import load_sensor
from tests.program import rows_of, run
from tests.recordings.mcap_copy import copied

PRESETS = Path(__file__).parents[2] / "presets" / "sensors"
ROWS, COLUMNS, DENT = 480, 640, (259, 289)
"""Size of the images, and the pixel (u, v) of the press."""
FOCAL_LENGTHS = (132, 164, 276, 316)
"""Where a camera info has fx, fy, fx, fy."""
STEP, CONTACT = 3, 60
"""Of so many frames one is kept, of half as many before contact."""


def rewritten(folder, target, change):
    """Copy a recording; `change(topic, data, k)` edits the k-th message of a topic."""

    def edited(topic, data, k):
        if topic.endswith("image_rect_raw") and k % (STEP if k >= CONTACT else 2 * STEP):
            return None
        data = bytearray(data)
        change(topic, data, k)
        return bytes(data)

    return copied(next(folder.glob("*.mcap")), target, edited)


def depth(change):
    def edit(topic, data, k):
        if topic.endswith("image_rect_raw"):
            image = np.frombuffer(data, "<f4", offset=len(data) - 4 * ROWS * COLUMNS)
            image = image.reshape(ROWS, COLUMNS)
            image[:] = change(image.copy(), k)

    return edit


def focal_length(share):
    def edit(topic, data, _):
        for at in FOCAL_LENGTHS if topic.endswith("camera_info") else ():
            (value,) = struct.unpack_from("<d", data, at)
            struct.pack_into("<d", data, at, value * share)

    return edit


def with_hole(size):
    (u, v), half = DENT, size // 2

    def change(image, _):
        image[v - half : v + half, u - half : u + half] = 0.0
        return image

    return depth(change)


def drift(image, k):
    return np.where(image > 0.0, image - np.float32(0.5e-3 * min(k, 59) / 59), 0.0)


def estimated(recording, folder, sensor="punyo_oval_d405", *options):
    """Status, force, σ of each frame and what stderr says."""
    table = folder / f"{recording.stem}.csv"
    words = ("--sensor", sensor, "--out", table.with_suffix(".npz"), "--csv", table)
    done = run("estimate", recording, *words, *options)
    assert done.exit_code in (0, 2), done.output
    if done.exit_code:
        return [], np.zeros((0, 3)), np.zeros((0, 3)), done.stderr
    rows = rows_of(table)
    force, sigma = (
        np.array([[float(row[f"{name}_{axis}_n"] or "nan") for axis in "xyz"] for row in rows])
        for name in ("force", "force_sigma")
    )
    return [row["status"] for row in rows], force, sigma, done.stderr


@pytest.fixture(scope="module")
def undisturbed(punyo_press, tmp_path_factory):
    folder = tmp_path_factory.mktemp("undisturbed")
    copy = rewritten(punyo_press, folder / "copy.mcap", lambda *_: None)
    statuses, force, _, warnings = estimated(copy, folder)
    assert set(statuses) == {"no_contact", "ok"} and not warnings
    return force


@pytest.mark.long  # in short: tests/inverse/test_image_errors.py and test_image_zero.py
@pytest.mark.parametrize(
    "change",
    [
        # shifts of the gas pressure of the same press: calibration/test_weather.py
        pytest.param(depth(drift), id="depth drifts by 0.5 mm"),
        pytest.param(depth(lambda image, _: image * np.float32(0.995)), id="depth × 0.995"),
        pytest.param(focal_length(1.02), id="focal lengths × 1.02"),
        pytest.param(depth(lambda image, _: image[::-1, ::-1]), id="turned by 180°"),
        pytest.param(with_hole(16), id="hole of 16 pixels at the press"),
    ],
)
def test_no_wrong_force_is_ok(punyo_press, undisturbed, tmp_path, change):
    recording = rewritten(punyo_press, tmp_path / "changed.mcap", change)
    statuses, force, sigma, warnings = estimated(recording, tmp_path)
    if statuses and not warnings:
        trusted = np.isin(statuses, ["ok", "no_contact"])
        limit = 3.0 * sigma + 0.02  # some thirty components are compared
        assert (np.abs(force - undisturbed) <= limit)[trusted].all()


def test_a_tension_outside_its_interval_is_refused_or_warned_of(punyo_press, tmp_path):
    shutil.copytree(PRESETS, tmp_path / "sensors")
    sensor = tmp_path / "sensors" / "punyo_oval_d405.toml"
    tenth = f"{0.1 * load_sensor(sensor).pneumatics.tension_n_per_m:g}"
    text = re.sub(r"(tension_n_per_m) = .*", rf"\1 = {tenth}", sensor.read_text(encoding="utf-8"))
    sensor.write_text(text, encoding="utf-8")
    recording = rewritten(punyo_press, tmp_path / "copy.mcap", lambda *_: None)
    *_, warnings = estimated(recording, tmp_path, sensor, "--frames", "0:3")
    assert f"tension_n_per_m = {tenth} in the sensor file is outside the interval" in warnings
