"""The verdict weighs all ways to γ0 that the report lists."""

from bubbleviz.calibration.identification import identify
from bubbleviz.calibration.reports.verdict import judge
from bubbleviz.simulation.depth_noise import DepthNoise

from .domes import Dome, sphere

NOISE = DepthNoise(relative=0.003)


def verdict_on(dome):
    found = identify(dome, dome.sensor, range(len(dome)), nodes=200)
    return found.tension, judge(found)


def test_balance_and_least_squares_that_disagree_are_a_reason_against_good():
    """On a tall spheroid no constant tension is in balance with the gas pressure everywhere."""
    tension, verdict = verdict_on(Dome((0.07, 0.07, 0.09), 0.05, NOISE, 0, frames=20, scale=0.35))
    (reason,) = (sentence for sentence in verdict.advice if "apart" in sentence)
    assert f"{tension.tension.value:.1f} N/m" in reason
    assert f"{tension.least_squares_n_per_m:.1f} N/m" in reason
    assert verdict.grade != "good"


def test_on_a_sphere_they_agree():
    _, verdict = verdict_on(sphere(0, NOISE, frames=20, scale=0.35))
    assert not any("apart" in sentence for sentence in verdict.advice)
