"""The identification study: coverage of known values, and a small run that is resumed."""

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.coverage import (
    QUANTITIES,
    CoverageGrid,
    CoverageRow,
    coverage_study,
    coverages,
    targets,
)
from bubbleviz.errors import InputError

SMALL = CoverageGrid(("round sheet",), seeds=1, levels=(1.15,), frames=6, width=64, nodes=100)


def rows_of(quantity, truth, values, half_width, known="levels"):
    return [
        CoverageRow("sheet", k, known, quantity, truth, v, v - half_width, v + half_width)
        for k, v in enumerate(values)
    ]


def test_coverage_of_known_rows():
    values = [2500.0] * 18 + [2600.0, 2700.0]
    rows = rows_of("gauge_pressure_pa", 2500.0, values, 140.0)
    rows.append(CoverageRow("sheet", 20, "levels", "gauge_pressure_pa", 2500.0))
    (one,) = coverages(rows)
    assert (one["count"], one["determined"]) == (21, 20)
    assert one["covered"] == pytest.approx(0.95)
    assert one["rms_error"] == pytest.approx(np.sqrt((0.04**2 + 0.08**2) / 20))
    assert one["worst_error"] == pytest.approx(0.08)
    assert one["half_width"] == pytest.approx(0.056)
    assert one["worst_ratio"] == pytest.approx(200.0 / 140.0)
    assert all(target.met for target in targets(rows))
    worse = rows + rows_of("gauge_pressure_pa", 2500.0, [2750.0], 140.0)
    assert not any(target.met for target in targets(worse))


def test_errors_of_the_prestretch_are_absolute():
    (one,) = coverages(rows_of("prestretch", 1.2, [1.23, 1.25], 0.04))
    assert one["covered"] == 0.5
    assert one["bias"] == pytest.approx(0.04)
    assert one["half_width"] == pytest.approx(0.04)


@pytest.mark.long
def test_short_run_identifies_the_rubber_and_resumes(tmp_path):
    parts = tmp_path / "parts"
    found = coverage_study(SMALL, parts).run(tmp_path)
    assert [(row.known, row.quantity) for row in found.rows] == [
        (known, quantity) for known in ("levels", "vented") for quantity in QUANTITIES
    ]
    gauge = found.rows[-1]
    assert gauge.value == pytest.approx(2500.0, rel=0.01) and gauge.covered
    part = parts / "round_sheet_0.json"
    kept = json.loads(part.read_text())
    kept[0]["value"] = 123.0
    part.write_text(json.dumps(kept))
    assert coverage_study(SMALL, parts).run().rows[0].value == 123.0
    with pytest.raises(InputError, match="a study with other settings"):
        coverage_study(replace(SMALL, frames=9), parts).run()
    assert json.loads((tmp_path / "coverage.json").read_text())["coverage"]
    assert "round sheet" in found.to_text()
