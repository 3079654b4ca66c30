"""Covariance of the force and torque of a contact."""

from __future__ import annotations

import numpy as np

from bubbleviz.camera import IMAGE_ERRORS
from bubbleviz.inverse.friction import prior_scale
from bubbleviz.inverse.gauss_newton import Step
from bubbleviz.inverse.pivoting import part
from bubbleviz.membrane import cross
from bubbleviz.result import wrench_about

MODEL_ERROR = 0.02
"""Relative standard deviation of the force due to mesh, material law and friction model. Chosen on
balls and pucks that stick to a membrane of another mesh and are dragged and twisted: forces are
off by 1.8 % in the median of 42 frames, and by up to 9 % if a puck is twisted by 15° and dragged at
the same time; forces of frictionless presses by at most 1.4 %."""


def wrench_covariance(step: Step, friction: float, by_flow: np.ndarray) -> np.ndarray:
    """Covariance (6, 6) of the wrench due to noise, nuisances, material and model.

    The support is uncertain by one node: its neighbours may touch, too. This leaves friction less
    determined, so that the scale of its prior matters more.

    Parameters
    ----------
    step : Step
        The last one of the frame.
    friction : float
        Prior standard deviation of friction over pressure.
    by_flow : (n,) bool array
        Nodes whose friction optical flow sees.
    """
    nodes, problem = step.contact.nodes, step.contact.problem
    if not len(nodes):
        return np.zeros((6, 6))
    unit = unit_wrenches(step, nodes)
    by_material = step.measurements.jacobian @ step.tangent.by_material(step.state.x)
    wrenches = unit.T @ change_by(step, by_material)
    unknowns = np.concatenate([step.contact.pressure[nodes], step.contact.amplitudes])
    push = step.contact.pressure[:, None] * step.state.area_vectors
    error = float(np.hypot(MODEL_ERROR, step.tangent.model_error))
    covariance = _model_covariance(step.state.x, push, unknowns @ unit, friction * ~by_flow, error)
    covariance += wrenches @ wrenches.T
    around = np.flatnonzero(problem.with_neighbours(step.contact.pressure > 0.0))
    unit = unit_wrenches(step, around)
    alone = np.eye(len(unit))[:, len(around) + np.concatenate([own for own, _ in step.scaled])]
    joint = problem.covariance_of(around, np.hstack([unit, alone]))
    ends = np.cumsum([len(own) for own, _ in step.scaled])[:-1]
    places, scales = np.split(np.arange(6, len(joint)), ends), step.hyperparameters.scales
    for (own, sigma), at, scale in zip(step.scaled, places, scales, strict=True):
        if len(own):
            amplitudes, uncertain = step.contact.amplitudes[own], part(joint, at)
            spread = prior_scale(amplitudes, uncertain, sigma, scale).spread
            wrenches = np.linalg.solve(uncertain, joint[at, :6]).T
            covariance += wrenches @ spread @ wrenches.T
    return covariance + joint[:6, :6]


def image_errors_by_model(step: Step, errors: np.ndarray) -> np.ndarray:
    """Covariance (e, e) of the image's errors due to errors (k, s) of the ranges."""
    flow = len(step.measurements.error) - len(errors)
    change = change_by(step, np.pad(errors, ((0, flow), (0, 0))))[-len(IMAGE_ERRORS) :]
    covariance: np.ndarray = change @ change.T
    return covariance


def change_by(step: Step, measured: np.ndarray) -> np.ndarray:
    """Change of pressures and amplitudes (s + a, …) for changes of the measurements (k, …)."""
    contact, count = step.contact, len(step.contact.nodes)
    by_amplitudes = step.measurements.change_of_amplitudes(measured)
    if not count:
        return by_amplitudes
    unexplained = measured - step.measurements.by_nuisances @ by_amplitudes
    gradient = contact.problem.misfit_gradient(contact.nodes, unexplained)
    change: np.ndarray = -contact.covariance[:, :count] @ gradient
    change[count:] += by_amplitudes
    return change


def unit_wrenches(step: Step, nodes: np.ndarray) -> np.ndarray:
    """Force, and torque about the origin of B, on nodes (s,), (s + a, 6).

    For unit pressures of these nodes, and unit amplitudes.
    """
    nuisances, x, push = step.measurements.nuisances, step.state.x, -step.state.area_vectors[nodes]
    loads, at = nuisances.forces[nodes].swapaxes(1, 2), x[nodes]
    by_pressures = np.hstack([push, cross(at, push)])
    by_amplitudes = np.hstack([loads.sum(axis=0), cross(at[:, None], loads).sum(axis=0)])
    of_image = np.zeros((nuisances.errors.shape[1], 6))  # image errors are not forces
    return np.concatenate([by_pressures, by_amplitudes, of_image])


def _model_covariance(
    x: np.ndarray, push: np.ndarray, wrench: np.ndarray, friction: np.ndarray, error: float
) -> np.ndarray:
    """Covariance (6, 6) of a wrench (6,) by errors of the model, of a relative size.

    Errors of the force, equal in every direction, act at the centre of the normal forces `push`
    (n, 3) on nodes at `x` (n, 3); so do errors of the torque about it. The torque about the mean
    normal hardly changes the shape, and its estimate depends on how friction is distributed: for
    objects that stick it is off by as much as the prior of friction allows.
    """
    load = np.linalg.norm(push, axis=1)
    center, normal = load @ x / load.sum(), push.sum(axis=0) / np.linalg.norm(push.sum(axis=0))
    arm = np.linalg.norm(cross(x - center, normal), axis=1)
    unknown = friction * load
    spin = np.sqrt((unknown @ arm**2) * unknown.sum())
    size = np.linalg.norm((wrench_about(center) @ wrench).reshape(2, 3), axis=1)
    sigma = np.column_stack([np.diag(error * np.repeat(size, 3)), np.zeros(6)])
    sigma[3:, 6] = spin * normal
    back = wrench_about(-center) @ sigma
    return back @ back.T
