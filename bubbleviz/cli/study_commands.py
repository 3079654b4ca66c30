"""Commands `bubbleviz study …`: error and speed measurements; imports inside functions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bubbleviz.cli.binding import PATH, json_option
from bubbleviz.files import SYNTHETIC_SENSOR, to_json

if TYPE_CHECKING:
    from bubbleviz.sensor import Sensor
    from bubbleviz.simulation import Model
    from bubbleviz.study.harness import Study


@click.group()
def study() -> None:
    """Measure errors, speed and numerical stability."""


seed_option = click.option(
    "--seed", type=click.IntRange(0), default=7, help="Seed of poses and noise (default 7)."
)
_OPTIONS = {
    "sensor": click.option(
        "--sensor", default=SYNTHETIC_SENSOR, show_default=True, help="Sensor file or preset."
    ),
    "seed": seed_option,
    "quick": click.option("--quick", is_flag=True, help="Run only a few cases, about a minute."),
    "model": click.option(
        "--model",
        type=click.Choice(("rubber", "linear")),
        default="rubber",
        show_default=True,
        help="Membrane of the ground truth: exact, or the paper's linear one.",
    ),
    "case": click.option("--case", default="", help="Only cases whose name contains this text."),
}
_out_option = click.option("--out", type=PATH, help="Folder for the report.")


def command_of(make: Callable[..., Study | list[Study]], group: click.Group, parts: str) -> None:
    """Make a command of a function that makes studies, with options for its parameters.

    `parts` is the name of the folder in --out with the cases of an interrupted study, which is
    resumed.
    """
    wanted = signature(make).parameters

    def measure(out: Path | None, as_json: bool, **given: Any) -> None:
        from bubbleviz.sensor import load_sensor

        if "sensor" in wanted:
            given["sensor"] = load_sensor(given["sensor"])
        if "parts" in wanted:
            given["parts"] = out and out / parts
        made = make(**given)
        several = made if isinstance(made, list) else [made]
        reports = {one.name: one.run(out) for one in several}
        if not as_json:
            click.echo("\n\n".join(report.to_text() for report in reports.values()))
        elif isinstance(made, list):
            click.echo(to_json({name: report.to_dict() for name, report in reports.items()}))
        else:
            click.echo(reports[made.name].to_json())

    command = group.command(make.__name__, help=make.__doc__)(measure)
    for option in (*(_OPTIONS[name] for name in wanted if name in _OPTIONS), json_option):
        option(command)
    _out_option(command)


def _command(make: Callable[..., Study]) -> None:
    command_of(make, study, f"{make.__name__}_parts")


@_command
def accuracy(sensor: Sensor, seed: int, model: Model, quick: bool, parts: Path | None) -> Study:
    """Measure the error of force, patch and shape.

    For the exact, the linear and the paper's estimator, over press depth, run time, noise and
    membranes. With --out an interrupted study is continued.
    """
    from bubbleviz.study.accuracy import accuracy_study, full_grid, quick_grid

    grid = replace(quick_grid(model) if quick else full_grid(model), seed=seed)
    return accuracy_study(sensor, grid, parts)


@_command
def speed(sensor: Sensor, quick: bool) -> Study:
    """Measure time by stage, growth with size, and memory."""
    from bubbleviz.study.speed import contact_runs, full_runs, quick_runs, speed_study

    runs = quick_runs() if quick else full_runs()
    return speed_study(sensor, runs + contact_runs(frames=6 if quick else 40))


@_command
def stability(case: str, quick: bool) -> Study:
    """Check that extreme cases are solved, or refused with a reason."""
    from bubbleviz.study.stability import stability_study

    return stability_study(case, quick=quick)


@_command
def pose(sensor: Sensor, seed: int, quick: bool) -> Study:
    """Measure pose errors and run time, on simulated rubber."""
    from bubbleviz.study.pose import Grid, pose_study, quick_grid

    return pose_study(sensor, replace(quick_grid() if quick else Grid(), seed=seed))
