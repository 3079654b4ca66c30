"""The commands info, simulate, estimate and pose: one thin function each, heavy imports inside."""

from __future__ import annotations

from math import radians
from pathlib import Path
from typing import Literal

import click

from bubbleviz.cli.shared_options import colour_delay_option, friction_option, report, solver_option


@click.command()
@click.argument("recording", metavar="REC", type=click.Path(path_type=Path))
@click.option("--lag", is_flag=True, help="Tell the delay of the colour images that is seen.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON, SI units.")
def info(recording: Path, lag: bool, as_json: bool) -> None:
    """Show topics, frames, rate, duration, size and gaps of a recording."""
    from bubbleviz.commands.info import recording_info

    facts = recording_info(recording, lag=lag)
    click.echo(facts.to_json() if as_json else facts.to_text())


@click.command()
@click.option("--sensor", required=True, help="Sensor file or preset.")
@click.option("--object", "object_name", required=True, help="Object mesh or preset.")
@click.option("--pose", help='T_B_O as "x y z qx qy qz qw" (m, unit quaternion).')
@click.option("--path", "path_file", type=click.Path(path_type=Path), help="CSV of poses instead.")
@click.option("--frames", type=click.IntRange(1), default=1, help="Frames at --pose.")
@click.option("--rate", type=click.FloatRange(0.01, 1e4), default=30.0, help="Frames a second.")
@click.option("--noise-sigma", type=float, default=0.0, help="σ of range, m.")
@click.option("--noise-relative", type=float, default=0.0, help="σ of range over range.")
@click.option("--noise-correlation", type=float, default=0.0, help="1/e distance of noise, pixels.")
@click.option("--holes", type=float, default=0.0, help="Fraction of pixels without a return.")
@click.option("--outliers", type=float, default=0.0, help="Fraction of pixels far off.")
@click.option("--seed", type=click.IntRange(0), default=0, help="Seed of the noise.")
@click.option(
    "--model",
    type=click.Choice(["rubber", "linear"]),
    help="The exact membrane (default where the sensor has a prestretch), or the linear one.",
)
@click.option("--friction", metavar="MU", type=float, default=0.0, help="Coulomb's coefficient.")
@click.option("--drag", metavar="MM", type=float, default=0.0, help="Then along x of B, mm.")
@click.option("--twist", metavar="DEG", type=float, default=0.0, help="Then about its z axis, °.")
@click.option("--texture", is_flag=True, help="Print a speckle on the membrane: colour images.")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="REC.mcap.")
@click.option("--truth", type=click.Path(path_type=Path), help="TRUTH.npz.")
def simulate(
    sensor: str,
    object_name: str,
    pose: str | None,
    path_file: Path | None,
    frames: int,
    rate: float,
    noise_sigma: float,
    noise_relative: float,
    noise_correlation: float,
    holes: float,
    outliers: float,
    seed: int,
    model: Literal["rubber", "linear"] | None,
    friction: float,
    drag: float,
    twist: float,
    texture: bool,
    out: Path,
    truth: Path | None,
) -> None:
    """Record a rigid object pressed into a simulated sensor."""
    where = path_file or pose
    if where is None:
        raise click.UsageError("give --pose, or --path for a pose in every frame")
    if noise_sigma and noise_relative:
        raise click.UsageError("give either --noise-sigma or --noise-relative")
    from bubbleviz.commands.simulate import simulated_press, write_simulation
    from bubbleviz.simulation.depth_noise import DepthNoise
    from bubbleviz.simulation.printed_speckle import Speckle

    noise = DepthNoise(
        relative=noise_relative,
        absolute_m=noise_sigma,
        correlation_px=noise_correlation,
        holes=holes,
        outliers=outliers,
    )
    source = simulated_press(
        sensor,
        object_name,
        where,
        noise,
        frames=frames,
        rate_hz=rate,
        seed=seed,
        model=model,
        friction=friction,
        drag_m=1e-3 * drag,
        twist_rad=radians(twist),
        texture=Speckle(seed=seed) if texture else None,
    )
    write_simulation(source, out, truth)


@click.command()
@click.argument("recording", metavar="REC", type=click.Path(path_type=Path))
@click.option("--sensor", required=True, help="Sensor file, preset, or auto: the preset that fits.")
@click.option("--kappa", type=float, help="Patch threshold over the mean contact pressure.")
@solver_option
@click.option("--frames", help="A:B[:STEP], B left out; all by default.")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="RESULT.npz.")
@click.option("--csv", "csv_file", type=click.Path(path_type=Path), help="RESULT.csv.")
@click.option(
    "--zero-gas/--no-zero-gas",
    default=True,
    help="Zero the gas pressure on contact-free frames (default), or believe it as it is.",
)
@click.option("--shear", is_flag=True, help="Friction and slip, too, from the colour images.")
@friction_option
@colour_delay_option
@click.option("--json", "as_json", is_flag=True, help="Print JSON, SI units, times in ms.")
def estimate(
    recording: Path,
    sensor: str,
    kappa: float | None,
    solver: str | None,
    frames: str | None,
    out: Path,
    csv_file: Path | None,
    zero_gas: bool,
    shear: bool,
    friction: float | None,
    colour_delay_s: float | None,
    as_json: bool,
) -> None:
    """Contact pressure, patch and force of every frame of a recording."""
    if colour_delay_s is not None and not shear:
        raise click.UsageError("--colour-delay is of the images that --shear takes; give it, too")
    from bubbleviz.commands.estimate import estimate_recording

    summary = estimate_recording(
        recording,
        sensor,
        out,
        csv_file,
        kappa=kappa,
        solver=solver,
        frames=frames,
        zero_gas=zero_gas,
        shear=shear,
        friction=friction,
        colour_delay_s=colour_delay_s,
    )
    report(summary, summary.warning, as_json=as_json)


@click.command()
@click.argument("recording", metavar="REC", type=click.Path(path_type=Path))
@click.option("--sensor", required=True, help="Sensor file, preset, or auto: the preset that fits.")
@click.option("--object", "object_name", required=True, help="Object mesh or preset.")
@click.option("--unit", type=click.Choice(["m", "mm"]), help="Unit of the object's file.")
@click.option("--init", help='T_B_O in the first frame as "x y z qx qy qz qw"; else searched for.')
@solver_option
@friction_option
@click.option("--frames", help="A:B[:STEP], B left out; all by default.")
@click.option(
    "--object-patch", is_flag=True, help="The contact patch by the object's surface, too: its area."
)
@click.option("--out", required=True, type=click.Path(path_type=Path), help="POSES.csv.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON, SI units, times in ms.")
def pose(
    recording: Path,
    sensor: str,
    object_name: str,
    unit: Literal["m", "mm"] | None,
    init: str | None,
    solver: str | None,
    friction: float | None,
    frames: str | None,
    object_patch: bool,
    out: Path,
    as_json: bool,
) -> None:
    """Where a known object is in every frame of a recording."""
    from bubbleviz.commands.pose import pose_recording

    summary = pose_recording(
        recording,
        sensor,
        object_name,
        out,
        init=init,
        unit=unit,
        solver=solver,
        friction=friction,
        frames=frames,
        object_patch=object_patch,
    )
    report(summary, summary.warning, as_json=as_json)
