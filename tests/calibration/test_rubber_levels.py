"""λ and gauge pressure from inflation levels, of rubber whose truth is known."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from bubbleviz.cli.identify_command import identify as command
from bubbleviz.frames.recording_writer import RecordingWriter
from bubbleviz.membrane.rubber_model.inflation import Inflation
from bubbleviz.membrane.rubber_model.prestress import prestressed
from bubbleviz.sensor import load_sensor, sensor_to_toml
from bubbleviz.study.axial_mesh import swept_mesh
from bubbleviz.study.inflated_rubber import ATMOSPHERE_PA, InflatedRubber
from bubbleviz.study.rubber_oracle import AxialRubber

G = 2500.0
SHEET = InflatedRubber.round_sheet(0.045, 110.0, 1.15, G)
WIDTH, FRAMES = 120, 20


def recorded(truth, level, path, seed=0):
    source = truth.recording(level, seed, frames=FRAMES, width=WIDTH)
    with RecordingWriter(path) as writer:
        for k in range(len(source)):
            writer.write(source[k])
    return path


@pytest.mark.parametrize("level", [0.85, 1.15])
def test_inflation_is_that_of_the_meridian(level):
    truth = AxialRubber(0.045, 110.0, 1.15, G)
    rest = swept_mesh(truth.rest, 1000)
    inflated = Inflation(prestressed(rest, G, 110.0)).at(level * G)
    exact = swept_mesh(replace(truth, gauge_pressure_pa=level * G).rest, 1000).nodes
    motion = np.linalg.norm(exact - rest.nodes, axis=1)
    error = np.linalg.norm(inflated - exact, axis=1)
    assert error.max() < 0.03 * motion.max()
    assert np.sqrt(np.mean(error**2)) < 0.01 * np.sqrt(np.mean(motion**2))


def test_command_finds_rubber_and_gauge_pressure(tmp_path):
    """Levels of ±15 %; the sensor file's atmosphere is 0.7 kPa too much."""
    names = {0.85: "low", 1.0: "rest", 1.15: "high"}
    files = {
        level: recorded(SHEET, level, tmp_path / f"{name}.mcap", seed)
        for seed, (level, name) in enumerate(names.items(), 10)
    }
    given = SHEET.sensor(WIDTH)
    air = given.pneumatics.model_copy(update={"atmospheric_pressure_pa": ATMOSPHERE_PA + 700.0})
    given = given.model_copy(update={"pneumatics": air})
    (tmp_path / "given.toml").write_text(sensor_to_toml(given))
    out = tmp_path / "new.toml"
    result = CliRunner().invoke(command, [
        str(files[1.0]), "--sensor", str(tmp_path / "given.toml"), "--nodes", "500",
        "--level", str(files[0.85]), "--level", str(files[1.15]), "--out", str(out),
        "--report", str(tmp_path / "report"), "--json",
    ])  # fmt: skip
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)["rubber"]
    sensor = load_sensor(out)
    saved = sensor.calibration
    for interval, truth in (
        (saved.gauge_interval_pa, G),
        (saved.prestretch_interval, SHEET.prestretch),
        (saved.tension_interval_n_per_m, SHEET.tension_n_per_m),
    ):
        assert interval[0] < truth < interval[1]
    assert sensor.pneumatics.gauge_pressure_pa == pytest.approx(G, rel=0.05)
    assert sensor.membrane.prestretch == pytest.approx(SHEET.prestretch, abs=0.04)
    assert sensor.pneumatics.atmospheric_pressure_pa == pytest.approx(ATMOSPHERE_PA, abs=150.0)
    assert saved.prestretch_from == "inflation levels: low.mcap, high.mcap"
    assert found["levels"]["unexplained_rms_m"] < 0.1 * found["levels"]["change_rms_m"]
    assert "gauge pressure rests on" in (tmp_path / "report" / "report.html").read_text()
