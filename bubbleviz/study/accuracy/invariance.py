"""What should not matter to the force: the estimator's mesh, and how firmly it holds the rim.

There is no contact zone whose radius could be chosen: which nodes may touch is found by the L1 term
in every frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from bubbleviz.errors import InputError, SolveError
from bubbleviz.files.tables import table
from bubbleviz.frames.frame import Frame
from bubbleviz.inverse.estimator import RIM_SLACK_M, EstimatorOptions
from bubbleviz.inverse.solvers.inverse_solver import RUBBER
from bubbleviz.membrane.refine import refine
from bubbleviz.pipeline import Pipeline
from bubbleviz.sensor import Sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation.depth_noise import DepthNoise
from bubbleviz.study.accuracy.specimens import specimen
from bubbleviz.study.presses import SMOOTH_OBJECTS, presses
from bubbleviz.study.report_files import Target, at_most, target_table
from bubbleviz.study.truth_bank import Sighting, TruthBank, noise_name

FILES = ("accuracy_invariance.csv",)
LARGEST_CHANGE = 0.03
MESH, RIM = "mesh × 4", "rim prior × 3"


@dataclass(frozen=True)
class InvarianceGrid:
    """What runs; attributes as of `accuracy_study.Grid`.

    `nodes` is the size of the estimator's usual mesh of `sensor` and domes, where it is not theirs.
    """

    specimens: tuple[str, ...] = ("sensor", "dome λ 1.2", "oval sheet λ 1.15")
    objects: tuple[str, ...] = SMOOTH_OBJECTS
    depths: tuple[float, ...] = (0.15, 0.3)
    noises: tuple[DepthNoise, ...] = (DepthNoise(absolute_m=1e-4), DepthNoise(relative=0.01))
    truth_nodes: int = 2_600
    limit_s: float | None = 120.0
    seed: int = 7
    nodes: int | None = None


def quick_invariance_grid() -> InvarianceGrid:
    """A few seconds' worth."""
    noises = (DepthNoise(absolute_m=1e-4),)
    return InvarianceGrid(("dome λ 1.2",), ("sphere",), (0.2,), noises, 900, None, nodes=400)


@dataclass(frozen=True)
class Change:
    """|F| of one frame with one thing changed, over that with nothing changed, less 1."""

    specimen: str
    object_name: str
    depth_m: float
    noise: str
    changed: str
    force_n: float
    change_relative: float


def variants(model: SensorModel) -> dict[str, Pipeline]:
    """Pipelines of the exact estimator that should find the same force; the first is as usual."""
    usual = EstimatorOptions(RUBBER)
    return {
        "": Pipeline(model, usual),
        MESH: Pipeline(_finer(model), usual),
        RIM: Pipeline(model, replace(usual, rim_slack_m=3.0 * RIM_SLACK_M)),
    }


def changes(pipelines: dict[str, Pipeline], frame: Frame) -> dict[str, tuple[float, float]]:
    """|F| in N of a first frame, and its relative change, by what was changed."""
    forces = {}
    for name, pipeline in pipelines.items():
        pipeline.restart()
        patch = pipeline.process(frame, frozenset({"patch"})).patch
        forces[name] = np.nan if patch is None else float(np.linalg.norm(patch.force_n))
    usual = forces.pop("")
    return {name: (force, force / usual - 1.0) for name, force in forces.items()}


def run_invariance(
    sensor: Sensor, grid: InvarianceGrid, tick: Callable[[str], None] = lambda _: None
) -> list[Change]:
    """Press simulated rubber and estimate with every variant."""
    found: list[Change] = []
    for name in grid.specimens:
        own = specimen(name, sensor, "rubber", grid.truth_nodes, grid.seed)
        bank = TruthBank(own.presses, grid.seed, limit_s=grid.limit_s)
        height = float(bank.mesh.nodes[:, 2].max())
        depths = tuple(share * height for share in grid.depths)
        sightings: list[Sighting] = []
        for press in presses(grid.objects, depths):
            try:
                sightings.append(bank.sighting(press))
            except (InputError, SolveError):  # the grid of the study names such a press
                continue
        for noise in grid.noises:
            told = own.told(noise)
            if grid.nodes is not None:
                told = SensorModel.of(told.sensor, nodes=grid.nodes)
            pipelines = variants(told)
            for each in sightings:
                made = changes(pipelines, bank.frame(each, noise, 0))
                press = each.press
                found += [
                    Change(name, press.object_name, press.depth_m, noise_name(noise), changed, *f)
                    for changed, f in made.items()
                ]
        tick(name)
    return found


def targets(found: list[Change]) -> list[Target]:
    """Largest change of each kind; one without an answer is not met."""
    kinds = dict.fromkeys((each.changed, each.noise) for each in found)
    return [
        at_most(
            f"{changed}, {noise}: largest change of |F|",
            float(np.max([abs(c.change_relative) for c in found if (c.changed, c.noise) == kind])),
            LARGEST_CHANGE,
        )
        for kind in kinds
        for changed, noise in (kind,)
    ]


def to_text(found: list[Change]) -> str:
    """Tables for the terminal."""
    header = ("membrane", "object", "mm", "noise", "changed", "N", "change %")
    lines = [
        (
            each.specimen, each.object_name, f"{1e3 * each.depth_m:.1f}", each.noise, each.changed,
            f"{each.force_n:.3f}", f"{100 * each.change_relative:+.2f}",
        )
        for each in found
    ]  # fmt: skip
    return f"What should not matter\n{table(header, lines)}\n\n{target_table(targets(found))}"


def _finer(model: SensorModel) -> SensorModel:
    """The sensor on a mesh of four times as many nodes."""
    if model.sensor.membrane.shape == "spherical_cap":
        return replace(
            model, mesh=SensorModel.of(model.sensor, nodes=4 * len(model.mesh.nodes)).mesh
        )
    return replace(model, mesh=refine(model.mesh))
