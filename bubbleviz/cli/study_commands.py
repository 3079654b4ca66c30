"""Commands `bubbleviz study …`: error and speed measurements; imports inside functions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bubbleviz.cli.binding import PATH, json_option
from bubbleviz.files import SYNTHETIC_SENSOR

if TYPE_CHECKING:
    from bubbleviz.simulation import Model
    from bubbleviz.study.harness import Study


@click.group()
def study() -> None:
    """Measure errors, speed and numerical stability."""


sensor_option = click.option(
    "--sensor", default=SYNTHETIC_SENSOR, show_default=True, help="Sensor file or preset."
)
seed_option = click.option(
    "--seed", type=click.IntRange(0), default=7, help="Seed of poses and noise (default 7)."
)


def report_options(function: Callable[..., None]) -> Callable[..., None]:
    quick = click.option("--quick", is_flag=True, help="Run only a few cases, about a minute.")
    out = click.option("--out", type=PATH, help="Folder for the report.")
    return out(json_option(quick(function)))


def run(study: Study, out: Path | None, as_json: bool) -> None:
    """Run a study, print its report, and write it if a folder is given."""
    report = study.run(out)
    click.echo(report.to_json() if as_json else report.to_text())


@study.command()
@report_options
@sensor_option
@seed_option
@click.option(
    "--model",
    type=click.Choice(("rubber", "linear")),
    default="rubber",
    show_default=True,
    help="Membrane of the ground truth: exact, or the paper's linear one.",
)
def accuracy(
    out: Path | None,
    as_json: bool,
    quick: bool,
    sensor: str,
    seed: int,
    model: Model,
) -> None:
    """Measure the error of force, patch and shape.

    For the exact, the linear and the paper's estimator, over press depth, run time, noise and
    membranes. With --out an interrupted study is continued.
    """
    from bubbleviz.sensor import load_sensor
    from bubbleviz.study.accuracy import accuracy_study, full_grid, quick_grid

    grid = replace(quick_grid(model) if quick else full_grid(model), seed=seed)
    parts = None if out is None else out / "accuracy_parts"
    run(accuracy_study(load_sensor(sensor), grid, parts), out, as_json)


@study.command()
@report_options
@sensor_option
def speed(out: Path | None, as_json: bool, quick: bool, sensor: str) -> None:
    """Measure time by stage, growth with size, and memory."""
    from bubbleviz.sensor import load_sensor
    from bubbleviz.study.speed import contact_runs, full_runs, quick_runs, speed_study

    runs = quick_runs() if quick else full_runs()
    runs += contact_runs(frames=6 if quick else 40)
    run(speed_study(load_sensor(sensor), runs), out, as_json)


@study.command()
@report_options
@click.option("--case", "pattern", default="", help="Only cases whose name contains this text.")
def stability(out: Path | None, as_json: bool, quick: bool, pattern: str) -> None:
    """Check that extreme cases are solved, or refused with a reason."""
    from bubbleviz.study.stability import stability_study

    run(stability_study(pattern, quick=quick), out, as_json)


@study.command()
@report_options
@sensor_option
@seed_option
def pose(out: Path | None, as_json: bool, quick: bool, sensor: str, seed: int) -> None:
    """Measure pose errors and run time, on simulated rubber."""
    from bubbleviz.sensor import load_sensor
    from bubbleviz.study.pose import Grid, pose_study, quick_grid

    grid = replace(quick_grid() if quick else Grid(), seed=seed)
    run(pose_study(load_sensor(sensor), grid), out, as_json)
