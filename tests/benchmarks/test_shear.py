"""The shear study prints its results and writes them to files."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.__main__ import benchmarks
from benchmarks.shear import ShearTrial, targets
from benchmarks.slip import SlipTrial, report_of
from tests.program import rows_of


def trial(**changed):
    """An accurate frame with these changes."""
    values = dict.fromkeys(ShearTrial.__dataclass_fields__, 0.0)
    words = {
        "object_name": "puck",
        "friction": np.nan,
        "depth_status": "ok",
        "status": "ok",
        "flow_sigma_px": 0.03,
    }
    return ShearTrial(**(values | words | changed))


def slip(**changed):
    """A contact whose slip is detected at once, with these changes."""
    values = {"judged": 10, "alarms": 0, "found_in": 1.0} | changed
    return SlipTrial(5e-3, "0.03 px", 20, **values)


@pytest.mark.parametrize(
    ("bad", "missed"),
    [
        ({}, set()),
        ({"status": "not_converged"}, {"share of frames solved"}),
        ({"force_error": 0.04}, {"force error, %"}),
        ({"angle_rad": 0.1, "torque_error": 0.06}, {"force angle, °", "torque error, %"}),
        ({"center_error_m": 1.5e-3}, {"centre, mm"}),
        ({"slip": 0.2}, {"false slip, share of frames"}),
        ({"slip": 0.2, "friction": 0.5}, set()),
        ({"force_error": 0.04, "flow_sigma_px": 0.3}, set()),
        ({"torque_error": np.nan}, set()),
    ],
)
def test_the_worst_frame_is_judged(bad, missed):
    found = targets([trial(), trial(**bad), *[trial()] * 3])
    assert {target.name for target in found if not target.met} == missed


@pytest.mark.parametrize(
    ("bad", "missed"),
    [
        ({"found_in": 3.0}, {"slip found, frame"}),
        ({"found_in": np.nan}, {"slip found, frame"}),
        ({"alarms": 2}, {"false slip, share of frames"}),
    ],
)
def test_slip_of_the_worst_contact_is_judged(bad, missed):
    found = report_of([slip(), slip(**bad)]).targets
    assert {target.name for target in found if not target.met} == missed


@pytest.mark.long
def test_quick_study(tmp_path):
    pytest.importorskip("cv2", reason="OpenCV, an extra, is not installed")
    out = tmp_path / "study"
    found = CliRunner().invoke(benchmarks, ["shear", "--quick", "--out", str(out)])
    assert found.exit_code == 0, found.output
    numbers, slips = (json.loads((out / f"{name}.json").read_text()) for name in ("shear", "slip"))
    met = {target["name"]: target["met"] for target in numbers["targets"] + slips["targets"]}
    del met["traction, ms of processor"]  # of the machine
    assert all(met.values())
    rows = rows_of(out / "shear.csv")
    assert len(rows) == len(numbers["trials"])
    assert [row["friction"] for row in rows[:5]] == ["nan"] * 5
    sliding = [row for row in rows[5:] if float(row["drag_m"]) > 5e-4 or float(row["twist_rad"])]
    assert len(sliding) >= 6
    assert all(float(row["friction"]) == 1.0 for row in sliding)
    assert [each["flow"] for each in slips["slips"]] == ["0.03 px", "rendered"]
    assert all(each["judged"] == 7 and each["points"] >= 4 for each in slips["slips"])
    dragged = rows[2]
    assert float(dragged["force_error"]) < float(dragged["depth_force_error"]) < 0.02
