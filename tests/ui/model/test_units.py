"""Formatting of numbers with units."""

import math
import re

import pytest
from PySide6.QtWidgets import QApplication
from window_driver import CONTACT, clipped_texts, view_texts

from bubbleviz_ui.model.units import UNIT_CHOICES, Units


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (Units().pressure.text(1234.0), "1.23 kPa"),
        (Units().area.text(231e-6), "231 mm²"),
        (Units().length.text(4.6e-5), "0.05 mm"),
        (Units().force.text(-0.001), "0.00 N"),
        (Units().force.text(None), "–"),
        (Units().force.text(math.nan), "–"),
        (Units().gas_pressure.text(443.2, signed=True), "+443 Pa"),
        (Units().pressure.rough(70_690.0), "71 kPa"),
        (Units().pressure.rough(153.0), "0.15 kPa"),
        (Units().gas_pressure.rough(1234.0), "1200 Pa"),
        (Units().force.with_interval(4.784, 0.034), "4.78 ± 0.03 N"),
        (Units().force.with_interval(4.784, 0.002), "4.78 ± 0.01 N"),  # not 0.00
        (Units().force.with_interval(4.784, 0.0), "4.78 ± 0.00 N"),
        (Units().force.with_interval(47.84, 3.14), "47.8 ± 3.1 N"),
        (Units().tension.with_interval(219.32, 25.62), "219 ± 26 N/m"),
        (Units().gas_pressure.with_interval(8690.0, 978.0), "8690 ± 980 Pa"),
        (Units().force.with_interval(-0.2, 12.0), "0 ± 12 N"),
        (Units().tension.between(192.79, 244.02), "193 … 244 N/m"),
        (Units().gas_pressure.between(2500.0, 2700.0), "2500 … 2700 Pa"),
        (Units().area.with_range(28e-6, 7e-6, 139.6e-6), "28 (7…140) mm²"),
        (Units().area.with_range(28e-6, 4e-7, 139.6e-6), "28 (up to 140) mm²"),
        (Units().area.with_range(28e-6, 0.0, 0.0), "28 mm²"),
    ],
)
def test_default_units(text, expected):
    assert text == expected


@pytest.mark.parametrize(
    ("quantity", "symbol", "si", "text"),
    [
        ("pressure", "psi", 6894.757293168e4, "10000.000 psi"),
        ("pressure", "Pa", 1234.4, "1234 Pa"),
        ("gas_pressure", "psi", 689.4757, "0.1000 psi"),
        ("length", "m", 0.0123, "0.01230 m"),
        ("area", "m", 66e-6, "0.000066 m²"),
        ("volume", "m", 2.2e-3, "0.0022000 m³"),
        ("force", "mN", 2.68, "2680 mN"),
        ("duration", "s", 9.4, "0.0094 s"),
    ],
)
def test_other_units(quantity, symbol, si, text):
    units = Units()
    kind = next(k for k, s in UNIT_CHOICES.items() if symbol in s and quantity in s[symbol])
    units.use({kind: symbol})
    unit = getattr(units, quantity)
    assert unit.text(si) == text and unit.to_si(unit.from_si(si)) == pytest.approx(si)


def test_labels_follow_the_chosen_units(drive):
    driver = drive(frame=CONTACT)
    window = driver.window
    window.resize(1280, 800)
    plots, images = frozenset({"force", "center"}), frozenset({"depth"})
    layers = driver.state.settings.layers | {"cloud"}
    driver.state.change(plots=plots, images=images, kappa=3.0, layers=layers)
    driver.show("images", "plots")
    driver.wait(lambda: "depth" in window.controller.inspection.images)
    window.hover.point_at((24, 44))
    driver.wait_until_shown()
    solved = driver.pipeline.counts["estimate"]
    for symbol in ("m", "psi", "mN", "s"):
        driver.trigger(f"View › Units › {symbol}")
    driver.wait_until_shown()
    force = 1e3 * float((driver.result.patch.force_n**2).sum() ** 0.5)
    labels = window.status.labels
    shown = labels["force"].text().removeprefix("force ")
    assert re.fullmatch(r"\d+ ± \d+ mN", shown)
    assert float(shown.split()[0]) == pytest.approx(force, rel=0.002)
    for name, symbol in {"area": "m²", "gas": "psi", "residual": "m", "solve": "Hz"}.items():
        assert labels[name].text().endswith(f" {symbol}")
    assert " s · " in labels["solve"].text()
    assert window.kappa.force.text() == shown
    assert window.kappa.threshold.text().endswith("psi")
    assert window.layers.pressure_max.suffix() == " psi"
    assert window.layers.residual_max.suffix() == " m"
    for line, symbol in zip(window.images.lines, ("m", "m", "psi"), strict=True):
        assert f" {symbol}" in line.text()
    assert window.images.cells["depth"].text.endswith(" m")
    assert "mN" in window.plots.plots["force"].text
    assert window.plots.plots["center"].text.endswith(" m")
    head, rest, *others = view_texts(driver)
    assert head.startswith("contact") and head.endswith("mN")
    assert rest.startswith("peak") and "psi" in rest
    bars, (pointed,) = [t for t in others if ")" in t], [t for t in others if "node" in t]
    assert sorted(bar.split()[-1] for bar in bars) == ["(m)", "(psi)"]
    assert re.search(r"p_c .* psi .*\n u .* m ", pointed)
    drawn = window.scene.layers["membrane"].actor.mapper.GetInput()["contact pressure"].max()
    peak = driver.result.estimate.contact_pressure_pa.max()
    assert drawn == pytest.approx(peak / 6894.757293168)
    assert driver.pipeline.counts["estimate"] == solved  # without computing anything
    window.show_rates()
    QApplication.processEvents()
    assert window.width() == 1280 and not clipped_texts(window.status)
    driver.trigger("View › Units › kPa")
    assert window.kappa.threshold.text().endswith("kPa")
    # a colour range set by the user stays; 0 means automatic
    box = window.layers.pressure_max
    box.setValue(5.0)
    assert driver.state.settings.pressure_max_pa == pytest.approx(5000.0)
    driver.trigger("View › Units › psi")
    assert driver.state.settings.pressure_max_pa == pytest.approx(5000.0)
    assert box.value() == pytest.approx(5000.0 / 6894.757, abs=1e-3)
    driver.trigger("View › Units › kPa")
    assert box.value() == 5.0
    box.setValue(0.0)
    assert driver.state.settings.pressure_max_pa is None
