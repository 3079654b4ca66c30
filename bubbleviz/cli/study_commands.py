"""The commands `bubbleviz study …`: one thin function each, heavy imports inside."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from bubbleviz.files.defaults import SYNTHETIC_SENSOR

DEPTH_OF_SWEEP_M = 0.015  # of the presses of the sweep over λ, m: the middle of the grid's depths


@click.group()
def study() -> None:
    """Measure error against run time, speed, stability and pose."""


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
def accuracy(
    out: Path | None, as_json: bool, quick: bool, sensor: str, seed: int, shipped_only: bool
) -> None:
    """Error of patch, force and shape against run time; the linear model against the exact one.

    With --out a stopped study goes on where it was.
    """
    from dataclasses import replace

    import numpy as np

    from bubbleviz.files.tables import out_folder, to_json
    from bubbleviz.sensor import load_sensor
    from bubbleviz.study.accuracy import accuracy_report, linear_model, regularisation
    from bubbleviz.study.accuracy.accuracy_study import full_grid, quick_grid, run_accuracy
    from bubbleviz.study.report_files import check_free

    own = load_sensor(sensor)
    grid = replace(quick_grid() if quick else full_grid(), seed=seed)
    if shipped_only:
        grid = replace(grid, setups=grid.setups[:1])
    parts = None
    if out is not None:
        out_folder(out)
        check_free(out, accuracy_report.FILES + linear_model.FILES + regularisation.FILES)
        parts = out_folder(out / "accuracy_parts")
    with _progress(len(grid.setups), "setup") as bar:
        found = run_accuracy(own, grid, parts, lambda _: bar.update())
    strengths = regularisation.sweep(
        own,
        [press for press in grid.presses() if press.depth_m == DEPTH_OF_SWEEP_M],
        np.logspace(-1, 1, 3) if quick else np.logspace(-3, 4, 15),
        seed=seed,
        truth_nodes=grid.truth_nodes,
    )
    written: list[Path] = []
    if out is not None:
        written = accuracy_report.write(found, out) + regularisation.write(strengths, out)
        bubble = linear_model.bubble_of(own)
        if bubble is not None:
            depths = np.linspace(0.04, 0.6, 3 if quick else 15) * bubble.height_m
            compared = linear_model.compare(bubble, depths, 1_500 if quick else 6_000)
            written += linear_model.write(compared, out)
    if as_json:
        lambdas = regularisation.as_dict(strengths)
        click.echo(to_json({**accuracy_report.as_dict(found), "regularisation": lambdas}))
    else:
        click.echo(accuracy_report.to_text(found) + "\n\n" + regularisation.to_text(strengths))
    _name(written, as_json)


@study.command()
@_common
@_sensor
def speed(out: Path | None, as_json: bool, quick: bool, sensor: str) -> None:
    """Time by stage, growth with nodes and pixels, memory, and the moving press."""
    from bubbleviz.files.tables import out_folder, to_json
    from bubbleviz.sensor import load_sensor
    from bubbleviz.study.report_files import check_free
    from bubbleviz.study.speed import speed_report
    from bubbleviz.study.speed.speed_study import full_runs, quick_runs, read_ms, run_speed

    own = load_sensor(sensor)
    if out is not None:
        check_free(out_folder(out), speed_report.FILES)
    runs = quick_runs() if quick else full_runs()
    with _progress(len(runs), "run") as bar:
        rows = run_speed(own, runs, lambda _: bar.update())
    found = speed_report.Speed(rows, read_ms(own))
    written = speed_report.write(found, out) if out is not None else []
    click.echo(to_json(speed_report.as_dict(found)) if as_json else speed_report.to_text(found))
    _name(written, as_json)


@study.command()
@_common
@click.option("--case", "pattern", default="", help="Only cases with this in their name.")
def stability(out: Path | None, as_json: bool, quick: bool, pattern: str) -> None:
    """Stiff and extreme cases: each solved within its tolerance, or refused with a reason."""
    from bubbleviz.errors import InputError
    from bubbleviz.files.tables import out_folder, to_json, write_csv, write_json
    from bubbleviz.study.report_files import check_free
    from bubbleviz.study.stability.stability_cases import all_cases, quick_cases
    from bubbleviz.study.stability.stability_study import run_stability, summary

    cases = [case for case in (quick_cases() if quick else all_cases()) if pattern in case.name]
    if not cases:
        raise InputError(f"--case {pattern}: no case has this in its name; leave it out")
    if out is not None:
        check_free(out_folder(out), ("stability.json", "stability.csv"))
    with _progress(len(cases), "case") as bar:
        results = run_stability(cases, lambda _: bar.update())
    found = summary(results)
    if out is not None:
        write_json(out / "stability.json", found)
        write_csv(out / "stability.csv", results)
    if as_json:
        click.echo(to_json(found))
    else:
        for result in results:
            click.echo(f"{result.verdict:8} {result.name:44} {result.ms:8.0f} ms  {result.detail}")
        counts = ", ".join(f"{found[key]} {key}" for key in ("passed", "refused", "failed"))
        click.echo(f"{found['cases']} cases: {counts}")
    if out is not None:
        _name([out / "stability.json", out / "stability.csv"], as_json)


@study.command()
@_common
@_sensor
@click.option("--seed", type=click.IntRange(0), default=7, help="Seed of poses and noise.")
def pose(out: Path | None, as_json: bool, quick: bool, sensor: str, seed: int) -> None:
    """Pose error against run time and other libraries; on rubber pressed by the exact model."""
    from dataclasses import replace

    from bubbleviz.files.tables import out_folder, to_json
    from bubbleviz.sensor import load_sensor
    from bubbleviz.study.pose import pose_report
    from bubbleviz.study.pose.pose_study import PoseGrid, quick_pose_grid, run_pose_study
    from bubbleviz.study.pose.rubber_poses import RubberGrid, quick_rubber_grid, run_rubber_study
    from bubbleviz.study.pose.screw_motion import SEEDS, run_screws, screw_source
    from bubbleviz.study.report_files import check_free

    own = load_sensor(sensor)
    grid = replace(quick_pose_grid() if quick else PoseGrid(), seed=seed)
    if out is not None:
        check_free(out_folder(out), pose_report.FILES)
    with _progress(grid.poses * len(grid.objects), "press") as bar:
        trials = run_pose_study(own, grid, lambda _: bar.update())
    rubber_grid = replace(quick_rubber_grid() if quick else RubberGrid(), seed=seed)
    with _progress(rubber_grid.presses * len(rubber_grid.objects), "press on rubber") as bar:
        rubber = run_rubber_study(own, rubber_grid, lambda _: bar.update())
    nut = screw_source(own, nodes=grid.truth_nodes) if quick else screw_source(own)
    screws = run_screws(own, nut, SEEDS[:1] if quick else SEEDS)
    found = pose_report.PoseReport(trials, rubber, screws)
    written = pose_report.write(found, out) if out is not None else []
    click.echo(to_json(pose_report.as_dict(found)) if as_json else pose_report.to_text(found))
    _name(written, as_json)


def _progress(total: int, unit: str) -> Any:
    from tqdm import tqdm

    return tqdm(total=total, unit=unit, disable=None)  # only on a terminal


def _name(paths: list[Path], quiet: bool) -> None:
    if paths and not quiet:
        click.echo("wrote " + ", ".join(map(str, paths)))
