"""Numbers come with their unit, whatever they are."""

from __future__ import annotations

import math

import pytest

from ui.scene.ranges import rounded_up
from ui.units import Units


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (Units().pressure.text(1234.0), "1.23 kPa"),
        (Units().area.text(231e-6), "231 mm²"),
        (Units().length.text(4.6e-5), "0.05 mm"),
        (Units().force.text(-0.001), "0.00 N"),
        (Units().force.text(None), "– N"),
        (Units().force.text(math.nan), "– N"),
        (Units().gas_pressure.text(443.2, signed=True), "+443 Pa"),
    ],
)
def test_text(text: str, expected: str) -> None:
    assert text == expected


def test_there_and_back() -> None:
    unit = Units().pressure
    assert unit.to_si(unit.of(321.0)) == pytest.approx(321.0)


@pytest.mark.parametrize(
    ("value", "end"), [(0.9, 1.0), (1.0, 1.0), (1.01, 1.5), (8.1, 10.0), (646.0, 800.0)]
)
def test_scales_end_at_round_numbers(value: float, end: float) -> None:
    assert rounded_up(value) == pytest.approx(end)
