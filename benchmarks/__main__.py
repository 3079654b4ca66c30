"""`python -m benchmarks …`: accuracy benchmarks; imported inside functions for a quick --help."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bubbleviz.cli.command_line import OneLineErrors
from bubbleviz.cli.study_commands import command_of, seed_option
from bubbleviz.files import SYNTHETIC_SENSOR

if TYPE_CHECKING:
    from bubbleviz.sensor import Sensor
    from bubbleviz.study.harness import Study


@click.group(cls=OneLineErrors)
def benchmarks() -> None:
    """Accuracy benchmarks: bounds, limits, coverage."""


def _command(make: Callable[..., list[Study]]) -> None:
    command_of(make, benchmarks, "parts")


@_command
def edge(sensor: Sensor, quick: bool, seed: int) -> list[Study]:
    """Edge of the patch over noise; Cramér–Rao bound and thresholds on depth."""
    from benchmarks.edge import EdgeGrid, edge_study, quick_grid

    return [edge_study(sensor, replace(quick_grid() if quick else EdgeGrid(), seed=seed))]


@_command
def detection(sensor: Sensor, quick: bool, seed: int) -> list[Study]:
    """Smallest detectable press at a false-alarm rate of 1 in 1,000 frames."""
    from benchmarks.detection import DetectionGrid, detection_study, quick_detection_grid

    grid = quick_detection_grid() if quick else DetectionGrid()
    return [detection_study(sensor, replace(grid, seed=seed))]


@_command
def membranes(quick: bool, seed: int, parts: Path | None) -> list[Study]:
    """The study of accuracy on bulged sheets and moulded domes, known and identified."""
    from benchmarks.membranes import GRID, quick_grid, specimen
    from bubbleviz.sensor import load_sensor
    from bubbleviz.study.accuracy import accuracy_study

    grid = replace(quick_grid() if quick else GRID, seed=seed)
    return [accuracy_study(load_sensor(SYNTHETIC_SENSOR), grid, parts, specimen)]


@_command
def coverage(quick: bool, parts: Path | None) -> list[Study]:
    """Coverage of the 95 % intervals of rubber identified from inflation levels."""
    from benchmarks.coverage import CoverageGrid, coverage_study

    grid = CoverageGrid()
    if quick:  # short recordings of small images
        grid = CoverageGrid(("round sheet",), seeds=3, frames=20, width=120, nodes=500)
    return [coverage_study(grid, parts)]


@_command
def shear(quick: bool, seed: int) -> list[Study]:
    """Force with friction over drag, twist and flow noise; slip."""
    from benchmarks.shear import ShearGrid, quick_shear_grid, shear_study
    from benchmarks.slip import slip_study

    grid = replace(quick_shear_grid() if quick else ShearGrid(), seed=seed)
    return [slip_study(grid), shear_study(grid)]


@_command
def poses(sensor: Sensor, quick: bool, seed: int, parts: Path | None) -> list[Study]:
    """Error, coverage and time of tracked poses, at rest and moving."""
    from benchmarks.pose_coverage import Grid, coverage_study

    grid = Grid(seed=seed)
    if quick:
        grid = replace(grid, objects=("torus",), frames=6, paths=1, seeds=3)
    return [coverage_study(sensor, grid, parts)]


@_command
def dragged(quick: bool) -> list[Study]:
    """Tracked poses of objects that rubber of another solver sticks to, dragged and twisted."""
    from benchmarks.pose_dragged import Grid, dragged_study

    return [dragged_study(Grid(noises_m=(1.5e-4,), seeds=1, every=4) if quick else Grid())]


@_command
def faults(quick: bool, seed: int, parts: Path | None) -> list[Study]:
    """Random errors of pressure, depth and camera: rate of wrong forces without a warning."""
    from benchmarks.faults import faults_study

    return [faults_study(24 if quick else 1_000, seed, parts)]


@benchmarks.command()
@click.option("--count", type=click.IntRange(1), default=10_000, help="Of inputs.")
@click.option("--first", type=click.IntRange(0), default=0, help="Number of the first one.")
@seed_option
@click.option("--keep", type=click.Path(path_type=Path), help="New folder to leave the inputs in.")
def fuzz(count: int, first: int, seed: int, keep: Path | None) -> None:
    """Damaged and hostile inputs; exit code 1 unless each is read or refused in one line."""
    from tempfile import TemporaryDirectory

    from tqdm import tqdm

    from benchmarks.fuzz import fuzz, to_text

    with TemporaryDirectory() as scratch:
        folder = Path(scratch) if keep is None else keep
        folder.mkdir(exist_ok=keep is None)
        running = fuzz(range(first, first + count), seed, folder)
        outcomes = list(tqdm(running, total=count, leave=False, disable=None))
    click.echo(to_text(outcomes))
    if any(each.fault for each in outcomes):
        raise SystemExit(1)


if __name__ == "__main__":
    benchmarks(prog_name="python -m benchmarks")
