"""`python -m benchmarks …`: what judges methods; heavy imports inside."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from bubbleviz.cli.command_line import OneLineErrors
from bubbleviz.cli.study_commands import report_options, run, seed_option, sensor_option


@click.group(cls=OneLineErrors)
def benchmarks() -> None:
    """Measure what methods can do: bounds, limits, coverage, rivals."""


@benchmarks.command()
@report_options
@sensor_option
@seed_option
def edge(out: Path | None, as_json: bool, quick: bool, sensor: str, seed: int) -> None:
    """Edge of the patch by noise, against the mesh's best, the Cramér–Rao bound and a threshold."""
    from benchmarks.edge import EdgeGrid, edge_study, quick_grid
    from bubbleviz.sensor import load_sensor

    grid = replace(quick_grid() if quick else EdgeGrid(), seed=seed)
    run(edge_study(load_sensor(sensor), grid), out, as_json)


@benchmarks.command()
@report_options
@sensor_option
@seed_option
def detection(out: Path | None, as_json: bool, quick: bool, sensor: str, seed: int) -> None:
    """The smallest press that is found, at one false alarm in a thousand frames."""
    from benchmarks.detection import DetectionGrid, detection_study, quick_detection_grid
    from bubbleviz.sensor import load_sensor

    grid = replace(quick_detection_grid() if quick else DetectionGrid(), seed=seed)
    run(detection_study(load_sensor(sensor), grid), out, as_json)


@benchmarks.command()
@report_options
@sensor_option
@seed_option
def regularisation(out: Path | None, as_json: bool, quick: bool, sensor: str, seed: int) -> None:
    """Strength of the H1 term against the discrepancy principle and the L-curve."""
    import numpy as np

    from benchmarks.regularisation import regularisation_study
    from bubbleviz.sensor import load_sensor

    factors = np.logspace(-1, 1, 3) if quick else np.logspace(-3, 4, 15)
    nodes = {"truth_nodes": 3_000} if quick else {}
    study = regularisation_study(load_sensor(sensor), factors, seed=seed, **nodes)
    run(study, out, as_json)


@benchmarks.command()
@report_options
@seed_option
def membranes(out: Path | None, as_json: bool, quick: bool, seed: int) -> None:
    """The study of accuracy on bulged sheets and moulded domes, known and identified."""
    from benchmarks.membranes import GRID, quick_grid, specimen
    from bubbleviz.files.defaults import SYNTHETIC_SENSOR
    from bubbleviz.sensor import load_sensor
    from bubbleviz.study.accuracy import accuracy_study

    grid = replace(quick_grid() if quick else GRID, seed=seed)
    parts = None if out is None else out / "membranes_parts"
    run(accuracy_study(load_sensor(SYNTHETIC_SENSOR), grid, parts, specimen), out, as_json)


@benchmarks.command()
@report_options
@click.option(
    "--seeds", type=click.IntRange(1), help="Identifications of every rubber; by default 50."
)
def coverage(out: Path | None, as_json: bool, quick: bool, seeds: int | None) -> None:
    """How often 95 % intervals of rubber identified from inflation levels hold the truth.

    With --out a stopped run goes on where it was.
    """
    from benchmarks.coverage import CoverageGrid, coverage_study, quick_coverage

    grid = quick_coverage() if quick else CoverageGrid()
    grid = replace(grid, seeds=seeds or grid.seeds)
    parts = None if out is None else out / "coverage_parts"
    run(coverage_study(grid, parts), out, as_json)


@benchmarks.command()
@report_options
@seed_option
def shear(out: Path | None, as_json: bool, quick: bool, seed: int) -> None:
    """Force, torque and displacement with friction over drag, twist and flow noise.

    Then slip over the size of the contact, and the presets of the optical flow.
    """
    from benchmarks.flow_presets import flow_study
    from benchmarks.shear import ShearGrid, quick_shear_grid, shear_study
    from benchmarks.slip import slip_study

    grid = replace(quick_shear_grid() if quick else ShearGrid(), seed=seed)
    for study in (flow_study(grid), slip_study(grid), shear_study(grid)):
        run(study, out, as_json)


@benchmarks.command()
@report_options
@sensor_option
@seed_option
def pose(out: Path | None, as_json: bool, quick: bool, sensor: str, seed: int) -> None:
    """Pose against Open3D, small_gicp and the whole cloud, on the paper's membrane."""
    from benchmarks.pose_rivals import PoseGrid, quick_pose_grid, rivals_study
    from bubbleviz.sensor import load_sensor

    grid = replace(quick_pose_grid() if quick else PoseGrid(), seed=seed)
    run(rivals_study(load_sensor(sensor), grid), out, as_json)


@benchmarks.command()
@report_options
@sensor_option
def screws(out: Path | None, as_json: bool, quick: bool, sensor: str) -> None:
    """A nut that turns by 60°, followed and found again."""
    from benchmarks.screws import SEEDS, screw_study
    from bubbleviz.sensor import load_sensor

    seeds, nodes = (SEEDS[:1], 8_000) if quick else (SEEDS, None)
    run(screw_study(load_sensor(sensor), seeds, nodes), out, as_json)


@benchmarks.command()
@report_options
@sensor_option
def stages(out: Path | None, as_json: bool, quick: bool, sensor: str) -> None:
    """Every stage of a frame, from decoding to export: time, floor and growth."""
    from benchmarks.stages import StageSizes, stages_study
    from bubbleviz.sensor import load_sensor

    sizes = StageSizes.quick() if quick else StageSizes()
    run(stages_study(load_sensor(sensor), sizes), out, as_json)


if __name__ == "__main__":
    benchmarks(prog_name="python -m benchmarks")
