"""Strength of the H1 term: the shipped λ against the discrepancy principle and the L-curve.

The discrepancy principle takes the largest λ whose misfit is still that of the noise, the L-curve
the corner of misfit against roughness. Most pixels see no contact, so that the misfit moves by a
few parts in a thousand over decades of λ: the discrepancy principle needs the noise known that
well, as only a simulation knows it, and there confirms what the shipped rule takes from physics.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from bubbleviz.errors import InputError, SolveError
from bubbleviz.files.tables import table, write_csv
from bubbleviz.frames.frame import Frame
from bubbleviz.inverse.estimator import PRESSURE_SCALE, EstimatorOptions
from bubbleviz.inverse.solvers.inverse_solver import LINEAR
from bubbleviz.membrane.stiffness import cotangent_laplacian
from bubbleviz.pipeline import Pipeline
from bubbleviz.sensor import Sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation.depth_noise import DepthNoise
from bubbleviz.study.accuracy.accuracy_study import PRODUCTS
from bubbleviz.study.error_metrics import Judge
from bubbleviz.study.presses import Press
from bubbleviz.study.report_files import save_figure
from bubbleviz.study.truth_bank import LinearPresses, Sighting, TruthBank

FILES = ("regularisation.csv", "regularisation.png")


@dataclass(frozen=True)
class Strength:
    """Results of one λ over all presses: means, or medians where the name says so.

    Attributes
    ----------
    factor : float
        λ over the shipped one.
    misfit : float
        Residual rms over that of the noise alone, as the untouched membrane shows it.
    roughness_pa : float
        √∫|∇p_c|² dA.
    chosen_by : str
        Rules that choose this λ, of those in the sweep.
    """

    factor: float
    misfit: float
    roughness_pa: float
    iou: float
    force_error_relative_median: float
    not_ok: int
    chosen_by: str = ""


def sweep(
    sensor: Sensor, cases: list[Press], factors: np.ndarray, *, seed: int, truth_nodes: int
) -> list[Strength]:
    """Estimate every press on the linear membrane with every λ, at the sensor's own noise.

    Parameters
    ----------
    sensor : Sensor
    cases : list of Press
    factors : (k,) array
        λ over the shipped one, ascending.
    seed, truth_nodes : int
        Of the presses and of the mesh that makes their truth.
    """
    bank = TruthBank(LinearPresses(SensorModel.of(sensor), truth_nodes), seed)
    sightings = []
    for press in cases:
        try:
            sightings.append(bank.sighting(press))
        except (InputError, SolveError):  # no such pose on this sensor; the grid names it
            continue
    return _with_choices([_strength(sensor, bank, sightings, float(f)) for f in factors])


def _strength(
    sensor: Sensor, bank: TruthBank, sightings: list[Sighting], factor: float
) -> Strength:
    # λ is the inverse square of the pressure that the prior expects.
    options = EstimatorOptions(LINEAR, pressure_scale=PRESSURE_SCALE / np.sqrt(factor))
    pipeline = Pipeline.of(sensor, options=options)
    judge = Judge(pipeline)
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
        errors = judge.errors(result, sighting)
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
    truth = Judge(pipeline).displacement_m(sighting)
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


def to_text(found: list[Strength]) -> str:
    """Table for the terminal."""
    header = ("λ / shipped", "misfit / noise", "roughness Pa", "IoU", "force err %", "not ok", "")
    lines = [
        (
            f"{s.factor:.3g}", f"{s.misfit:.4f}", f"{s.roughness_pa:.3g}", f"{s.iou:.3f}",
            f"{100 * s.force_error_relative_median:.2f}", str(s.not_ok), s.chosen_by,
        )
        for s in found
    ]  # fmt: skip
    return "Strength of the H1 term\n" + table(header, lines)


def as_dict(found: list[Strength]) -> list[dict[str, object]]:
    """Rows for JSON."""
    return [asdict(s) for s in found]


def write(found: list[Strength], folder: Path) -> list[Path]:
    """Write regularisation.csv and .png; the paths."""
    paths = [folder / name for name in FILES]
    write_csv(paths[0], found)
    _plot(found, paths[1])
    return paths


def _plot(found: list[Strength], path: Path) -> None:
    figure = Figure(figsize=(12, 4.5), layout="constrained")
    quality, curve = figure.subplots(1, 2)
    factor = [s.factor for s in found]
    quality.plot(factor, [s.iou for s in found], "o-", label="mean patch IoU")
    quality.set(xscale="log", xlabel="λ over the shipped one", ylabel="mean patch IoU")
    force = quality.twinx()
    force.plot(factor, [100 * s.force_error_relative_median for s in found], "s--", color="C1")
    force.set(ylabel="median force error, % (dashed)", yscale="log")
    curve.plot([s.misfit for s in found], [s.roughness_pa for s in found], "o-")
    curve.set(yscale="log", xlabel="misfit over noise", ylabel="roughness √∫|∇p|², Pa")
    for s in found:
        if s.chosen_by:
            place = {"xytext": (6, 6), "textcoords": "offset points", "fontsize": 8}
            quality.annotate(s.chosen_by, (s.factor, s.iou), **place)
            curve.annotate(s.chosen_by, (s.misfit, s.roughness_pa), **place)
    for axes in (quality, curve):
        axes.grid(alpha=0.3)
    save_figure(figure, path)
