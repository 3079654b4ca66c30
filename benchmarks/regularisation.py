"""Strength of the H1 term: the shipped λ against the discrepancy principle and the L-curve.

The discrepancy principle takes the largest λ whose misfit is still that of the noise, the L-curve
the corner of misfit against roughness. Most pixels see no contact, so that the misfit moves by a
few parts in a thousand over decades of λ: the discrepancy principle needs the noise known that
well, as only a simulation knows it, and there confirms what the shipped rule takes from physics.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import partial

import numpy as np

from bubbleviz.errors import InputError, SolveError
from bubbleviz.frames.frame import Frame
from bubbleviz.inverse.estimator import PRESSURE_SCALE, EstimatorOptions
from bubbleviz.inverse.solvers.inverse_solver import LINEAR
from bubbleviz.membrane.stiffness import cotangent_laplacian
from bubbleviz.pipeline import Pipeline
from bubbleviz.sensor import Sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation.depth_noise import DepthNoise
from bubbleviz.simulation.presses import GRID_OBJECTS, HELD_OUT_OBJECTS, Press
from bubbleviz.simulation.truth_bank import TRUTH_NODES, LinearPresses, Sighting, TruthBank
from bubbleviz.study.accuracy import PRODUCTS, at_nodes, errors_of
from bubbleviz.study.harness import Case, Column, Report, Study, Table

DEPTH_M = 0.015
"""Of the presses: the middle of the depths of the accuracy study."""


@dataclass(frozen=True)
class Strength:
    """Results of one λ over all presses: means, or medians where the name says so.

    `factor` is λ over the shipped one, `misfit` the residual rms over that of the noise alone,
    `roughness_pa` √∫|∇p_c|² dA, and `chosen_by` the rules that choose this λ.
    """

    factor: float
    misfit: float
    roughness_pa: float
    iou: float
    force_error_relative_median: float
    not_ok: int
    chosen_by: str = ""


def regularisation_study(
    sensor: Sensor, factors: np.ndarray, *, seed: int, truth_nodes: int = TRUTH_NODES
) -> Study:
    """Presses on the linear membrane with every λ (k,), ascending, at the sensor's own noise."""
    cases = [Press(name, DEPTH_M, False) for name in GRID_OBJECTS + HELD_OUT_OBJECTS]
    run = partial(sweep, sensor, cases, factors, seed=seed, truth_nodes=truth_nodes)
    return Study("regularisation", Strength, [Case("sweep", run)], report_of)


def sweep(
    sensor: Sensor, cases: list[Press], factors: np.ndarray, *, seed: int, truth_nodes: int
) -> list[Strength]:
    """Estimate every press with every λ."""
    bank = TruthBank(LinearPresses(SensorModel.of(sensor), truth_nodes), seed)
    sightings = []
    for press in cases:
        with suppress(InputError, SolveError):  # no such pose on this sensor
            sightings.append(bank.sighting(press))
    return _with_choices([_strength(sensor, bank, sightings, float(f)) for f in factors])


def _strength(
    sensor: Sensor, bank: TruthBank, sightings: list[Sighting], factor: float
) -> Strength:
    # λ is the inverse square of the pressure that the prior expects.
    options = EstimatorOptions(LINEAR, pressure_scale=PRESSURE_SCALE / np.sqrt(factor))
    pipeline = Pipeline.of(sensor, options=options)
    L = cotangent_laplacian(pipeline.mesh)
    noise = DepthNoise(relative=sensor.camera.noise_relative)
    rows, not_ok = [], 0
    for sighting in sightings:
        frame = bank.frame(sighting, noise, 0)
        pipeline.process(replace(frame, depth_m=np.full_like(frame.depth_m, np.nan)), PRODUCTS)
        result = pipeline.process(frame, PRODUCTS)
        estimate = result.estimate
        if estimate is None or estimate.status != "ok":
            not_ok += 1
            continue
        errors = errors_of(pipeline, result, sighting)
        p = estimate.contact_pressure_pa
        alone = _noise_rms(pipeline, sighting, frame)
        rows.append(
            (
                estimate.residual_rms_m / alone,
                float(np.sqrt(p @ (L @ p))),
                errors.iou,
                errors.force_error_relative,
            )
        )
    misfit, roughness, iou, force = np.array(rows or [(np.nan,) * 4]).T
    return Strength(
        factor=factor,
        misfit=float(misfit.mean()),
        roughness_pa=float(roughness.mean()),
        iou=float(iou.mean()),
        force_error_relative_median=float(np.median(force)),
        not_ok=not_ok,
    )


def _noise_rms(pipeline: Pipeline, sighting: Sighting, frame: Frame) -> float:
    """Weighted rms of this frame's noise: the residual with the true shape as the model."""
    observer = pipeline.estimator.observer
    truth = at_nodes(pipeline.mesh, sighting.mesh, sighting.truth.displacement_m)
    linear = observer.linearise(truth)
    observation = observer.observe(frame.depth_m, observer.predict(linear, truth))
    return observer.misfit(observation, linear, truth).rms_m


def _with_choices(found: list[Strength]) -> list[Strength]:
    chosen: dict[int, list[str]] = {}
    forces = [s.force_error_relative_median for s in found]
    rules = {
        "shipped": int(np.argmin([abs(np.log(s.factor)) for s in found])),
        "best IoU": int(np.argmax(np.nan_to_num([s.iou for s in found]))),
        "best force": int(np.argmin(np.nan_to_num(forces, nan=np.inf))),
        "discrepancy": discrepancy_choice(np.array([s.misfit for s in found])),
        "L-curve": l_curve_corner(
            np.array([s.misfit for s in found]), np.array([s.roughness_pa for s in found])
        ),
    }
    for name, index in rules.items():
        chosen.setdefault(index, []).append(name)
    return [replace(s, chosen_by=", ".join(chosen.get(k, []))) for k, s in enumerate(found)]


def discrepancy_choice(misfit: np.ndarray) -> int:
    """Index of the largest λ whose misfit (k,), in units of the noise, is at most 1; else 0."""
    within = np.flatnonzero(misfit <= 1.0)
    return int(within[-1]) if within.size else 0


def l_curve_corner(misfit: np.ndarray, roughness: np.ndarray) -> int:
    """Index of the largest curvature of log roughness against log misfit (Hansen 1992).

    Parameters
    ----------
    misfit, roughness : (k,) array
        For ascending λ.
    """
    if len(misfit) < 3:
        return 0
    x, y = np.log(misfit), np.log(roughness)
    t = np.arange(len(x), dtype=float)
    dx, dy = np.gradient(x, t), np.gradient(y, t)
    ddx, ddy = np.gradient(dx, t), np.gradient(dy, t)
    curvature = (dx * ddy - dy * ddx) / (dx**2 + dy**2) ** 1.5
    return int(1 + np.argmax(np.nan_to_num(curvature[1:-1], nan=-np.inf)))


_COLUMNS = (
    Column("λ / shipped", "factor", ".3g"),
    Column("misfit / noise", "misfit", ".4f"),
    Column("roughness Pa", "roughness_pa", ".3g"),
    Column("IoU", "iou", ".3f"),
    Column("force err %", "force_error_relative_median", ".2f", 100),
    Column("not ok", "not_ok"),
    Column("chosen by", "chosen_by"),
)


def report_of(found: Sequence[Strength]) -> Report:
    """Every λ."""
    records = [asdict(strength) for strength in found]
    return Report([Table("regularisation", records, _COLUMNS, "Strength of the H1 term")])
