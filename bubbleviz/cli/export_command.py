"""The command `export`: a recording's frames as files for other programs; heavy imports inside."""

from __future__ import annotations

from pathlib import Path

import click

from bubbleviz.cli.shared_options import friction_option, report, solver_option


@click.command()
@click.argument("recording", metavar="REC", type=click.Path(path_type=Path))
@click.option("--sensor", required=True, help="Sensor file, preset, or auto: the preset that fits.")
@click.option(
    "--out",
    required=True,
    type=click.Path(path_type=Path),
    help="TABLE.csv, TABLE.parquet, PLOTS.png (or .svg, .pdf), or a new folder for --what.",
)
@click.option(
    "--what",
    default="",
    help="Into a folder, with commas: table, parquet, plots, vtk (ParaView), ply, patch (points "
    "with pressure), depth, pressure (pictures; png for both).",
)
@click.option("--frames", help="A:B[:STEP], B left out; all by default.")
@click.option("--poses", type=click.Path(path_type=Path), help="POSES.csv to join to the table.")
@click.option("--kappa", type=float, help="Patch threshold over the mean contact pressure.")
@solver_option
@friction_option
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def export(
    recording: Path,
    sensor: str,
    out: Path,
    what: str,
    frames: str | None,
    poses: Path | None,
    kappa: float | None,
    solver: str | None,
    friction: float | None,
    as_json: bool,
) -> None:
    """Tables, ParaView and PLY series, patch clouds, pictures and plots of a recording.

    Only what the chosen files need is computed: depth pictures solve nothing.
    """
    from tqdm import tqdm

    from bubbleviz.commands.export import export_recording
    from bubbleviz.export.export_plan import ExportPlan
    from bubbleviz.export.pose_columns import read_poses

    asked = [word.strip() for word in what.split(",") if word.strip()]
    plan = ExportPlan.of(out, asked, None if poses is None else read_poses(poses))
    with tqdm(total=100, unit="%", leave=False, disable=None) as bar:  # only on a terminal

        def advance(step: str, done: float) -> None:
            bar.update(100.0 * done - bar.n)

        summary = export_recording(
            recording,
            sensor,
            plan,
            frames=frames,
            kappa=kappa,
            solver=solver,
            friction=friction,
            progress=advance,
        )
    report(summary, summary.warning, as_json=as_json)
