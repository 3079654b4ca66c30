"""Frames whose noise factors and supports could lead to each other for ever."""

import numpy as np
import pytest

import bubbleviz as bv
from tests.inverse.test_rubber_estimator import depth_image_of, error, estimator, pressed


def test_friction_scales_do_not_alternate(monkeypatch):
    """In this frame two scales led to each other, step by step, until they were found together."""
    noise_m, (mesh, contact) = 5e-4, pressed("cylinder", 0.007)
    solver = estimator(relative=noise_m / 0.065)
    image, shapes = depth_image_of(mesh, contact.displacement_3d_m, noise_m), []
    around = solver.observer.around

    def counted(nodes, *last):
        shapes.append(nodes)
        return around(nodes, *last)

    monkeypatch.setattr(solver.observer, "around", counted)
    estimate, start = solver.estimate(image)
    assert len(shapes) < 6
    assert error(estimate, contact.nodal_force_n.sum(axis=0)) < 0.03
    again, _ = solver.estimate(image, start=start)
    assert error(again, estimate.force_n) < 0.01
    assert again.resolution_m == pytest.approx(estimate.resolution_m, rel=0.05)


def test_a_frame_is_solved_although_two_noise_factors_select_two_supports():
    """From rest, a deep flat face; the factors alternate before the shape has converged."""
    place, noise = "0 0 0.036 0 0 0 1", 0.003
    press = bv.simulate(
        "pico_flexx_75mm", "cylinder", place, frames=2, noise_relative=noise, seed=5
    )
    found, true = bv.Estimator("pico_flexx_75mm").update(press[1]), press.truth(1).force_n
    assert found.status == "ok"
    assert np.linalg.norm(found.force_n - true) < 0.01 * np.linalg.norm(true)
