"""`bubbleviz identify` from a recording on disk to a sensor file, a report and JSON."""

import base64
import hashlib
import json
import re
from collections import Counter

import numpy as np
import pytest
from small_press import record

from bubbleviz.membrane import build_mesh
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import Recording
from bubbleviz.sensor import load_sensor, sensor_to_toml, with_colour_delay
from tests.program import output_of, refusal

from .domes import GAUGE, sphere
from .twin import make_twin, nominal_sensor


def recorded(source, sensor, folder):
    (folder / "given.toml").write_text(sensor_to_toml(sensor))
    return record(folder / "rest.mcap", source), folder / "given.toml"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Files of a sphere's identification, and the JSON it printed."""
    folder = tmp_path_factory.mktemp("sphere")
    dome = sphere(5, frames=20)
    recording, given = recorded(dome, with_colour_delay(dome.sensor, -0.055), folder)
    words = (recording, "--sensor", given, "--contact-free", "0:20", "--nodes", 300, "--json")
    out = ("--out", folder / "mine.toml", "--report", folder / "report")
    return folder, json.loads(output_of("identify", *words, *out))


def test_sensor_file_has_its_provenance(made):
    folder, numbers = made
    sensor = load_sensor(folder / "mine.toml")
    assert sensor.camera.colour_delay_s == -0.055
    assert sensor.membrane.shape == "spherical_cap"
    assert sensor.membrane.rim_radius_m == pytest.approx(0.075, abs=2e-4)
    assert sensor.pneumatics.tension_n_per_m == pytest.approx(GAUGE * 0.08125 / 2.0, rel=0.01)
    calibration = sensor.calibration
    assert calibration.recording == "rest.mcap"
    digest = hashlib.sha256((folder / "rest.mcap").read_bytes()).hexdigest()
    assert calibration.recording_sha256 == digest == numbers["origin"]["recording_sha256"]
    assert calibration.report == "report/report.html"
    assert (numbers["contact_free"]["first"], numbers["contact_free"]["last"]) == (0, 19)
    low, high = calibration.tension_interval_n_per_m
    assert low < sensor.pneumatics.tension_n_per_m < high
    assert not (folder / "mine.ply").exists()  # a cap needs no mesh file


def test_no_contact_on_contact_free_frames_after_identification(made):
    folder, _ = made
    sensor = load_sensor(folder / "mine.toml")
    pipeline = Pipeline.of(sensor)
    dome = sphere(77, frames=31)
    forces = [
        np.linalg.norm(pipeline.process(dome[k], frozenset({"patch"})).patch.force_n)
        for k in (28, 29, 30)
    ]
    assert max(forces) < 0.2  # 1 % noise: 1.4 mm


def test_report_is_self_contained(made):
    folder, numbers = made
    text = (folder / "report" / "report.html").read_text()
    assert json.loads((folder / "report" / "report.json").read_text()) == numbers
    assert numbers["verdict"]["summary"] in text
    assert numbers["reference_force_n"]["value"] > 0.0  # of a simulated press
    assert numbers["origin"]["recording_sha256"] in text
    pictures = re.findall(r'src="data:image/png;base64,([^"]+)"', text)
    assert len(pictures) >= 6 and "http" not in text and text.count("src=") == len(pictures)
    for picture in pictures:
        assert base64.b64decode(picture).startswith(b"\x89PNG\r\n")
    assert {"bubbleviz", "numpy", "python"} <= set(numbers["versions"])


def test_oval_sensor_with_gas_pressure_finds_contact_free_frames_with_a_reason(
    tmp_path, monkeypatch
):
    twin = make_twin(2)
    recording, given = recorded(twin, nominal_sensor(), tmp_path)
    out, read = tmp_path / "oval.toml", Counter()
    frame = Recording.__getitem__
    monkeypatch.setattr(Recording, "__getitem__", lambda own, k: read.update([k]) or frame(own, k))
    told = output_of("identify", recording, "--sensor", given, "--out", out, "--nodes", 300)
    assert read == dict.fromkeys(range(len(twin)), 1)  # each frame once
    assert "Shape used: free-form" in told and f"wrote {out}" in told
    sensor = load_sensor(out)
    assert sensor.membrane.shape == "mesh" and sensor.calibration.report is None
    assert abs(len(build_mesh(sensor).nodes) - 300) < 20
    with Recording(recording) as again:
        assert again.name == sensor.calibration.recording


@pytest.mark.parametrize(
    ("extra", "match"),
    [
        (("--contact-free", "9:3"), "outside its 6 frames"),
        (("--contact-free", "0:4"), "at least 5"),
        (("--out", "given.toml"), "exists already"),
        (("--out", "mine.txt"), "end it in .toml"),
    ],
)
def test_refused_calibration_leaves_no_files(tmp_path, extra, match):
    dome = sphere(1, frames=6)
    recording, given = recorded(dome, dome.sensor, tmp_path)
    extra = [tmp_path / e if e.endswith((".toml", ".txt")) else e for e in extra]
    before = sorted(tmp_path.iterdir())
    out = () if "--out" in extra else ("--out", tmp_path / "new.toml")
    report = ("--report", tmp_path / "r")
    assert match in refusal("identify", recording, "--sensor", given, *out, *report, *extra)
    assert sorted(tmp_path.iterdir()) == before
