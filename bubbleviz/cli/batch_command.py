"""The command `batch`: all recordings of a folder; heavy imports inside."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from bubbleviz.cli.shared_options import friction_option, solver_option

if TYPE_CHECKING:
    from bubbleviz.batch.summary_row import Row


@click.command()
@click.argument("folder", metavar="FOLDER", type=click.Path(path_type=Path))
@click.option("--sensor", required=True, help="Sensor file, preset, or auto: what fits each.")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="New folder.")
@click.option("--jobs", type=click.IntRange(1, 1024), help="Processes; one a processor if left.")
@click.option("--scheduler", metavar="ADDRESS", help="Dask scheduler, e.g. tcp://10.0.0.5:8786.")
@click.option("--resume", is_flag=True, help="Go on in OUT; keep what is up to date.")
@click.option("--kappa", type=float, help="Patch threshold over the mean contact pressure.")
@solver_option
@friction_option
@click.option("--frames", help="A:B[:STEP] of each recording, B left out; all by default.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON, SI units, times in ms.")
def batch(
    folder: Path,
    sensor: str,
    out: Path,
    jobs: int | None,
    scheduler: str | None,
    resume: bool,
    kappa: float | None,
    solver: str | None,
    friction: float | None,
    frames: str | None,
    as_json: bool,
) -> None:
    """Estimate every recording below FOLDER, in parallel; OUT/summary.csv compares them.

    A recording that fails does not stop the others; the exit code then is 2 (bad input) or 1.
    """
    if jobs is not None and scheduler is not None:
        raise click.UsageError("--jobs is for processes here; the cluster has its own")
    from tqdm import tqdm

    from bubbleviz.batch.batch_job import Settings
    from bubbleviz.commands.batch import run_batch

    settings = Settings(sensor, kappa, solver, frames, friction)
    with tqdm(unit="recording", leave=False, disable=None) as bar:  # only on a terminal

        def advance(row: Row, done: int, count: int) -> None:
            bar.total = count
            bar.set_postfix_str(row.recording, refresh=False)
            bar.update()

        summary = run_batch(
            folder,
            settings,
            out,
            jobs=jobs,
            scheduler=scheduler,
            resume=resume,
            progress=advance,
        )
    click.echo(summary.to_json() if as_json else summary.to_text())
    summary.raise_failures()
