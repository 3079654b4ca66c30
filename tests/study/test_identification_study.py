"""The identification study: coverage of known numbers, and a small run that goes on."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bubbleviz.errors import InputError
from bubbleviz.study.identification import coverage_report
from bubbleviz.study.identification.coverage_study import (
    QUANTITIES,
    CoverageGrid,
    CoverageRow,
    run_coverage,
)

SMALL = CoverageGrid(("round sheet",), seeds=1, levels=(1.15,), frames=6, width=64, nodes=100)


def rows_of(quantity, truth, values, half_width, known="levels"):
    return [
        CoverageRow("sheet", k, known, quantity, truth, v, v - half_width, v + half_width)
        for k, v in enumerate(values)
    ]


def test_coverage_of_known_rows():
    values = [2500.0] * 8 + [2600.0, 2700.0]
    rows = rows_of("gauge_pressure_pa", 2500.0, values, 110.0)
    rows.append(CoverageRow("sheet", 10, "levels", "gauge_pressure_pa", 2500.0))
    (one,) = coverage_report.coverages(rows)
    assert (one.seeds, one.determined) == (11, 10)
    assert one.covered == pytest.approx(0.9)
    assert one.within == pytest.approx(0.9)
    assert one.rms_error == pytest.approx(np.sqrt((0.04**2 + 0.08**2) / 10))
    assert one.worst_error == pytest.approx(0.08)
    assert one.half_width == pytest.approx(0.044)
    assert all(target.met for target in coverage_report.targets(rows))
    worse = rows + rows_of("gauge_pressure_pa", 2500.0, [2700.0], 110.0)
    assert not any(target.met for target in coverage_report.targets(worse))


def test_errors_of_the_prestretch_are_absolute():
    (one,) = coverage_report.coverages(rows_of("prestretch", 1.2, [1.23, 1.25], 0.04))
    assert (one.covered, one.within) == (0.5, 0.5)
    assert one.bias == pytest.approx(0.04)
    assert one.half_width == pytest.approx(0.04)


@pytest.mark.long
def test_a_small_run_finds_the_rubber_and_goes_on(tmp_path):
    parts = tmp_path / "parts"
    parts.mkdir()
    rows = run_coverage(SMALL, parts)
    assert [(row.known, row.quantity) for row in rows] == [
        (known, quantity) for known in ("levels", "vented") for quantity in QUANTITIES
    ]
    gauge = rows[-1]
    assert gauge.value == pytest.approx(2500.0, rel=0.01) and gauge.covered
    (part,) = parts.iterdir()
    kept = json.loads(part.read_text())
    kept["rows"][0]["value"] = 123.0
    part.write_text(json.dumps(kept))
    assert run_coverage(SMALL, parts)[0].value == 123.0
    with pytest.raises(InputError, match="another grid"):
        run_coverage(replace(SMALL, frames=9), parts)
    written = coverage_report.write(rows, tmp_path)
    assert json.loads(written[1].read_text())["coverage"]
    assert written[2].stat().st_size > 10_000
    assert "round sheet" in coverage_report.to_text(rows)
