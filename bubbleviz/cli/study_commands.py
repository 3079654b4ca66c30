"""The commands `bubbleviz study …`; heavy imports inside."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bubbleviz.files.defaults import SYNTHETIC_SENSOR

if TYPE_CHECKING:
    from bubbleviz.commands.study import Findings
    from bubbleviz.simulation.synthetic_source import Model


@click.group()
def study() -> None:
    """Measure error against run time, speed, stability, identification, pose and shear."""


_sensor = click.option(
    "--sensor", default=SYNTHETIC_SENSOR, show_default=True, help="Sensor file or preset."
)


def _common(function: Callable[..., None]) -> Callable[..., None]:
    """Options of every study."""
    options = [
        click.option("--out", type=click.Path(path_type=Path), help="Folder for the report."),
        click.option("--json", "as_json", is_flag=True, help="Print JSON, SI units."),
        click.option("--quick", is_flag=True, help="A few cases, about a minute."),
    ]
    return functools.reduce(lambda f, option: option(f), reversed(options), function)


@study.command()
@_common
@_sensor
@click.option("--seed", type=click.IntRange(0), default=7, help="Seed of poses and noise.")
@click.option("--shipped-only", is_flag=True, help="The whole grid, with the shipped default only.")
@click.option("--edge", is_flag=True, help="Only the edge of the patch, on more objects.")
@click.option(
    "--model",
    type=click.Choice(("rubber", "linear")),
    default="rubber",
    show_default=True,
    help="Membrane that makes the truth: the exact one, or the paper's linear one.",
)
def accuracy(
    out: Path | None,
    as_json: bool,
    quick: bool,
    sensor: str,
    seed: int,
    shipped_only: bool,
    edge: bool,
    model: Model,
) -> None:
    """Error of force, patch and shape of the exact, the linear and the paper's estimator.

    Over press depth, run time, noise and membranes, of known rubber and of rubber identified from
    inflation levels. With --out a stopped study goes on where it was.
    """
    from bubbleviz.commands.study import study_accuracy, study_edge

    if edge and (shipped_only or model != "rubber"):
        raise click.UsageError("--edge has a grid of its own: leave out --shipped-only and --model")
    if edge:
        found = study_edge(sensor, out, quick=quick, seed=seed)
    else:
        found = study_accuracy(
            sensor, out, quick=quick, seed=seed, shipped_only=shipped_only, model=model
        )
    _print(found, as_json)


@study.command()
@_common
@_sensor
@click.option(
    "--recording",
    type=click.Path(exists=True, path_type=Path),
    help="A real press to measure the exact and the linear membrane on, too.",
)
@click.option(
    "--stages",
    is_flag=True,
    help="Only the table of stages, from decoding to export: time, floor and growth.",
)
def speed(
    out: Path | None,
    as_json: bool,
    quick: bool,
    sensor: str,
    recording: Path | None,
    stages: bool,
) -> None:
    """Time by stage, growth with nodes and pixels, memory, and the moving press."""
    from bubbleviz.commands.study import study_speed, study_stages

    if stages and recording is not None:
        raise click.UsageError("--stages measures a simulated press: leave --recording out")
    if stages:
        _print(study_stages(sensor, out, quick=quick), as_json)
        return
    _print(study_speed(sensor, out, quick=quick, recording=recording), as_json)


@study.command()
@_common
@click.option("--case", "pattern", default="", help="Only cases with this in their name.")
def stability(out: Path | None, as_json: bool, quick: bool, pattern: str) -> None:
    """Stiff and extreme cases: each solved within its tolerance, or refused with a reason."""
    from bubbleviz.commands.study import study_stability

    _print(study_stability(pattern, out, quick=quick), as_json)


@study.command()
@_common
@click.option(
    "--seeds", type=click.IntRange(1), help="Identifications of every rubber; 50 by default."
)
def identification(out: Path | None, as_json: bool, quick: bool, seeds: int | None) -> None:
    """Coverage of the truth by the intervals of rubber identified from inflation levels.

    With --out a stopped study goes on where it was.
    """
    from bubbleviz.commands.study import study_identification

    _print(study_identification(out, quick=quick, seeds=seeds), as_json)


@study.command()
@_common
@_sensor
@click.option("--seed", type=click.IntRange(0), default=7, help="Seed of poses and noise.")
def pose(out: Path | None, as_json: bool, quick: bool, sensor: str, seed: int) -> None:
    """Pose error against run time and other libraries; on rubber pressed by the exact model."""
    from bubbleviz.commands.study import study_pose

    _print(study_pose(sensor, out, quick=quick, seed=seed), as_json)


@study.command()
@_common
@click.option("--seed", type=click.IntRange(0), default=7, help="Seed of the noise.")
def shear(out: Path | None, as_json: bool, quick: bool, seed: int) -> None:
    """Error of force, torque and displacement with friction over drag, twist and flow noise.

    Flow is also found in images of a rendered texture, by each preset.
    """
    from bubbleviz.commands.study import study_shear

    _print(study_shear(out, quick=quick, seed=seed), as_json)


def _print(found: Findings, as_json: bool) -> None:
    click.echo(found.to_json() if as_json else found.to_text())
