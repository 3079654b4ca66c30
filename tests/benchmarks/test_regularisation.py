"""The sweep over λ: its rules on curves whose answer is known, and the sweep itself."""

import numpy as np
import pytest

from benchmarks import regularisation
from bubbleviz.sensor import load_sensor
from bubbleviz.simulation.presses import Press
from bubbleviz.simulation.sensor_variants import with_nodes


def test_discrepancy_takes_the_largest_within_the_noise():
    assert regularisation.discrepancy_choice(np.array([0.97, 0.99, 1.0, 1.1])) == 2
    assert regularisation.discrepancy_choice(np.array([1.2, 1.3])) == 0


@pytest.mark.parametrize("corner", [3, 6, 9])
def test_corner_of_an_l(corner):
    k = np.arange(13.0)
    misfit = np.exp(np.maximum(k - corner, 0.0) + 0.01 * k)
    roughness = np.exp(np.maximum(corner - k, 0.0) - 0.01 * k)
    assert regularisation.l_curve_corner(misfit, roughness) == corner


def test_sweep_shows_too_little_and_too_much():
    """Noise of the untouched membrane is the unit of the misfit: it passes 1 near the shipped λ."""
    sensor = with_nodes(load_sensor("pico_flexx_75mm"), 700)
    press = [Press("sphere", 0.012, False)]
    found = regularisation.sweep(sensor, press, np.logspace(-3, 3, 3), seed=3, truth_nodes=2_500)
    weak, shipped, strong = found
    assert weak.roughness_pa > shipped.roughness_pa > strong.roughness_pa
    assert weak.misfit < shipped.misfit < strong.misfit
    assert shipped.misfit == pytest.approx(1.0, abs=0.01) and strong.misfit > 1.02
    assert shipped.iou > max(weak.iou, strong.iou)
    assert "shipped" in shipped.chosen_by and "shipped" in regularisation.report_of(found).to_text()
