"""The verbs of the library as commands, each with its function's options; heavy imports inside.

An option has the name of the function's parameter, without the unit where that is a plain SI unit.
"""

from __future__ import annotations

from functools import partial
from math import radians
from pathlib import Path
from typing import Any

import click

import bubbleviz as bv
from bubbleviz.cli.shared_options import (
    PATH,
    Bar,
    check_new,
    colour_delay_option,
    duration_option,
    former,
    frames_option,
    friction_option,
    json_option,
    kappa_option,
    out_option,
    publish_options,
    report,
    sensor_option,
    shear_option,
    solver_option,
    source_option,
    zero_gas_option,
)

option = click.option
_number = partial(click.option, type=float, default=0.0)
_recording = click.argument("recording", metavar="REC", type=PATH)
_simulated = click.option(
    "--sensor", default="auto", help="Sensor that synthetic: simulates; auto: the built-in one."
)


@click.command()
@_recording
@json_option
def info(recording: Path, as_json: bool) -> None:
    """Show topics, frames, rate, duration, size and gaps of a recording."""
    report(bv.info(recording), as_json=as_json)


@click.command()
@json_option
def presets(as_json: bool) -> None:
    """The sensors and objects that come with bubbleviz."""
    report(bv.presets(), as_json=as_json)


@click.command()
@json_option
def doctor(as_json: bool) -> None:
    """Versions, libraries, OpenGL and cameras of this machine, for a bug report."""
    report(bv.doctor(), as_json=as_json)


@click.command()
@option("--sensor", required=True, help="Sensor file or preset; no images tell which to simulate.")
@option("--object", required=True, help="Object mesh or preset.")
@option("--pose", help='T_B_O as "x y z qx qy qz qw" (m, unit quaternion).')
@option("--path", "path_file", type=PATH, help="CSV of poses instead.")
@option("--frames", type=click.IntRange(1), default=1, help="Frames at --pose.")
@option(
    "--rate", "rate_hz", type=click.FloatRange(0.01, 1e4), default=30.0, help="Frames a second."
)
@_number("--noise-sigma", "noise_sigma_m", help="σ of range, m.")
@_number("--noise-relative", help="σ of range over range.")
@_number("--noise-correlation", "noise_correlation_px", help="1/e distance of noise, pixels.")
@_number("--holes", help="Fraction of pixels without a return.")
@_number("--outliers", help="Fraction of pixels far off.")
@option("--seed", type=click.IntRange(0), default=0, help="Seed of the noise.")
@option(
    "--model",
    type=click.Choice(["rubber", "linear"]),
    help="The exact membrane (default where the sensor has a prestretch), or the linear one.",
)
@_number("--friction", metavar="MU", help="Coulomb's coefficient.")
@_number("--drag-m", metavar="M", help="Then along x of B, m.")
@_number("--twist-rad", metavar="RAD", help="Then about its z axis, rad.")
@_number("--drag", "drag_mm", hidden=True)
@_number("--twist", "twist_deg", hidden=True)
@option("--texture", is_flag=True, help="Print a speckle on the membrane: colour images.")
@out_option("REC.mcap.")
@option("--truth", type=PATH, help="TRUTH.npz.")
def simulate(
    sensor: str,
    object: str,
    pose: str | None,
    path_file: Path | None,
    out: Path,
    truth: Path | None,
    overwrite: bool,
    drag_mm: float,
    twist_deg: float,
    **options: Any,
) -> None:
    """Record a rigid object pressed into a simulated sensor."""
    where = path_file or pose
    if where is None:
        raise click.UsageError("give --pose, or --path for a pose in every frame")
    if options["noise_sigma_m"] and options["noise_relative"]:
        raise click.UsageError("give either --noise-sigma or --noise-relative")
    options["drag_m"] += 1e-3 * drag_mm
    options["twist_rad"] += radians(twist_deg)
    press = bv.simulate(sensor, object, where, **options)
    with Bar() as bar:
        press.save(out, truth, overwrite=overwrite, progress=bar)


@click.command()
@_recording
@sensor_option
@kappa_option
@solver_option
@frames_option
@out_option("RESULT.npz.")
@option("--csv", type=PATH, help="RESULT.csv.")
@zero_gas_option
@former("--zero/--no-zero", "zero_gas", default=True)
@shear_option
@friction_option
@colour_delay_option
@json_option
def estimate(
    recording: Path, sensor: str, frames: str | None, as_json: bool, **options: Any
) -> None:
    """Contact pressure, patch and force of every frame of a recording."""
    _check_shear(options)
    check_new(options["out"], options["csv"], overwrite=options["overwrite"])
    with bv.open(recording, frames) as chosen, Bar() as bar:
        done = bv.estimate(chosen, sensor, progress=bar, **options)
    report(done, as_json=as_json)


@click.command()
@_recording
@sensor_option
@option("--object", required=True, help="Object mesh or preset.")
@option("--unit", type=click.Choice(["m", "mm"]), help="Unit of the object's file.")
@option("--init", help='T_B_O in the first frame as "x y z qx qy qz qw"; else searched for.')
@solver_option
@friction_option
@zero_gas_option
@frames_option
@option(
    "--object-patch", is_flag=True, help="The contact patch by the object's surface, too: its area."
)
@out_option("POSES.csv.")
@json_option
def pose(
    recording: Path, sensor: str, object: str, frames: str | None, as_json: bool, **options: Any
) -> None:
    """Where a known object is in every frame of a recording."""
    check_new(options["out"], overwrite=options["overwrite"])
    with bv.open(recording, frames) as chosen, Bar() as bar:
        done = bv.track(chosen, object, sensor, progress=bar, **options)
    report(done, as_json=as_json)


@click.command()
@_recording
@sensor_option
@out_option("TABLE.csv, TABLE.parquet, PLOTS.png (or .svg, .pdf), or a new folder for --what.")
@option(
    "--what",
    default="",
    help="Into a folder, with commas: table, parquet, plots, vtk (ParaView), ply, patch (points "
    "with pressure), depth, pressure (pictures; png for both).",
)
@frames_option
@option("--poses", type=PATH, help="POSES.csv to join to the table.")
@kappa_option
@solver_option
@friction_option
@json_option
def export(
    recording: Path, out: Path, sensor: str, frames: str | None, as_json: bool, **options: Any
) -> None:
    """Tables, ParaView and PLY series, patch clouds, pictures and plots of a recording.

    Only what the chosen files need is computed: depth pictures solve nothing.
    """
    check_new(out, overwrite=options["overwrite"])
    with bv.open(recording, frames) as chosen, Bar() as bar:
        done = bv.export(chosen, out, sensor, progress=bar, **options)
    report(done, as_json=as_json)


@click.command()
@click.argument("source", metavar="IN", type=PATH)
@click.argument("out", metavar="OUT.mcap", type=PATH)
@option(
    "--intrinsics",
    type=PATH,
    help="TOML or JSON with width, height, fx, fy, cx, cy, distortion_model and distortion, or a "
    "sensor file; by default intrinsics.toml or .json in the folder.",
)
@option("--rate", "rate_hz", type=click.FloatRange(0.01, 1e4), help="Images a second.")
@option(
    "--times",
    type=PATH,
    help="CSV with a time in s for each image; by default times.csv in the folder, or the names.",
)
@option("--gas-pressure", type=PATH, help="CSV of time in s and absolute gas pressure in Pa.")
@former("--pressure", "gas_pressure", type=PATH)
@option("--wrench", type=PATH, help="CSV of time in s, forces x y z in N, torques in N·m.")
@option(
    "--metres-per-unit",
    type=click.FloatRange(0.0, min_open=True),
    help="Of the images' values; 0.001 for whole numbers, 1 for others by default.",
)
@option("--overwrite", is_flag=True, help="Replace what exists.")
@json_option
def convert(source: Path, out: Path, as_json: bool, **options: Any) -> None:
    """Make a recording of a folder of depth images, a ROS 1 .bag or a rosbag2 .db3.

    Images are .npy, 16-bit .png or .tif, in the order of the numbers in their names. Depth,
    camera info, gas pressure and wrench of a bag are kept, the latter at the frames' times.
    """
    with Bar() as bar:
        done = bv.convert(source, out, progress=bar, **options)
    report(done, as_json=as_json)


@click.command()
@_recording
@option(
    "--sensor", required=True, help="Sensor file or preset to start from; images do not tell it."
)
@option("--contact-free", metavar="A:B", help="Frames A to B−1; found where not given.")
@out_option("SENSOR.toml.")
@option("--report", "report_folder", type=PATH, help="New folder for HTML and JSON.")
@option(
    "--surface",
    type=click.Choice(["sphere", "ellipsoid", "free-form"]),
    help="In place of the data's choice.",
)
@option("--nodes", type=click.IntRange(30, 20_000), default=1000, help="Of the mesh.")
@option(
    "--level",
    "levels",
    multiple=True,
    type=PATH,
    help="Recording of the untouched sensor at another inflation level; several rectify better.",
)
@option(
    "--level-sigma",
    type=click.FloatRange(min=0.0),
    metavar="PA",
    help="σ of the gas pressure between levels, Pa; 1 % of the largest gauge pressure if left.",
)
@option(
    "--vented",
    type=PATH,
    help="Recording of the open chamber: its gas pressure is the atmospheric one.",
)
@option(
    "--held-press/--no-held-press",
    default=True,
    help="Let a held press in REC tell λ and gauge pressure where no level does (default).",
)
@former("--press/--no-press", "held_press", default=True)
@option("--object", help="Known object in REC to validate by: mesh file or preset.")
@option("--pose", help='Its T_B_O as "x y z qx qy qz qw" (m, unit quaternion).')
@option("--pressed", metavar="A:B", help="Frames A to B−1 in which it is held still.")
@json_option
def identify(
    recording: Path, sensor: str, report_folder: Path | None, as_json: bool, **options: Any
) -> None:
    """Identify γ0, reference surface and pixels of an untouched sensor.

    Inflation levels with their gas pressures give λ and the gauge pressure, too; so does, less
    precisely, a press in REC that is held.
    """
    with bv.open(recording) as frames, Bar() as bar:
        done = bv.identify(frames, sensor, report=report_folder, progress=bar, **options)
    report(done, as_json=as_json)


@click.command()
@_recording
@sensor_option
@option("--contact-free", metavar="A:B", help="Frames A to B−1; found where not given.")
@json_option
def check(recording: Path, sensor: str, contact_free: str | None, as_json: bool) -> None:
    """Tell whether contact-free frames of REC still fit the sensor file.

    fits, drifted (by how much, in N too), or another membrane or camera; and what to do.
    """
    with bv.open(recording) as frames, Bar() as bar:
        done = bv.check(frames, sensor, contact_free=contact_free, progress=bar)
    report(done, as_json=as_json)


@click.command()
@_recording
@sensor_option
@option("--wrench", metavar="TOPIC", help="Topic of the wrenches; the nearest by name.")
@solver_option
@friction_option
@zero_gas_option
@out_option("PLOT.png (.svg, .pdf), TABLE.csv, NUMBERS.json, or a new folder.", required=False)
@json_option
def validate(recording: Path, sensor: str, as_json: bool, **options: Any) -> None:
    """Compare the estimated force with that of a wrench sensor.

    Bias, gain, rotation, delay and hysteresis with 95 % intervals; nothing is applied.
    """
    with Bar() as bar:
        done = bv.validate(recording, sensor, progress=bar, **options)
    report(done, as_json=as_json)


@click.command()
@click.argument("folder", metavar="FOLDER", type=PATH)
@sensor_option
@out_option("New folder.")
@option("--jobs", type=click.IntRange(1, 1024), help="Processes; one a processor if left.")
@option("--scheduler", metavar="ADDRESS", help="Dask scheduler, e.g. tcp://10.0.0.5:8786.")
@option("--resume", is_flag=True, help="Go on in OUT; keep what is up to date.")
@kappa_option
@solver_option
@friction_option
@zero_gas_option
@frames_option
@json_option
def batch(folder: Path, out: Path, sensor: str, as_json: bool, **options: Any) -> None:
    """Estimate every recording below FOLDER, in parallel; OUT/summary.csv compares them.

    A recording that fails does not stop the others; the exit code then is 2 (bad input) or 1.
    """
    with Bar() as bar:
        done = bv.batch(folder, out, sensor, progress=bar, **options)
    report(done, as_json=as_json)
    done.raise_failures()


@click.command()
@source_option
@out_option("REC.mcap or a folder.")
@duration_option
@_simulated
@json_option
def record(source: str, out: Path, as_json: bool, **options: Any) -> None:
    """Record every message of a live source.

    ^C ends the recording; the file is whole. Should the machine stop, it opens up to the last
    second.
    """
    report(bv.record(source, out, **options), as_json=as_json)


@click.command()
@source_option
@sensor_option
@publish_options
@former("--publish", "listen")
@former("--publish-to", "connect")
@out_option("Record messages and results.", required=False)
@duration_option
@solver_option
@option("--object", help="Object to track: a mesh or a preset.")
@zero_gas_option
@former("--zero/--no-zero", "zero_gas", default=True)
@shear_option
@friction_option
@colour_delay_option
@json_option
def watch(source: str, sensor: str, as_json: bool, **options: Any) -> None:
    """Solve a live source without a window, and publish or record the results.

    Shear is measured against the first colour images without contact: touch nothing at the start.
    """
    _check_shear(options)
    report(bv.watch(source, sensor, **options), as_json=as_json)


@click.command()
@source_option
@publish_options
@option("--layout", type=click.Choice(["rmw", "dds"]), default="rmw", help="Names of keys.")
@option("--domain", type=click.IntRange(0, 232), default=0, help="ROS_DOMAIN_ID.")
@duration_option
@option("--wait", is_flag=True, help="Start when somebody subscribes.")
@_simulated
@json_option
def publish(source: str, as_json: bool, **options: Any) -> None:
    """Publish a source over Zenoh, as a robot's ROS 2 nodes would.

    By default subscribers of this computer connect, at tcp/127.0.0.1:7447.
    """
    report(bv.publish(source, **options), as_json=as_json)


def _check_shear(options: dict[str, Any]) -> None:
    if options["colour_delay_s"] is not None and not options["shear"]:
        raise click.UsageError("--colour-delay is of the images that --shear takes; give it, too")
