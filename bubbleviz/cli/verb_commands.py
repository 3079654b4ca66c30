"""Commands, one for each function of `bubbleviz.api`.

Options are named like its parameters, mostly without the unit.
"""

from __future__ import annotations

from contextlib import ExitStack
from functools import partial
from math import radians
from pathlib import Path
from typing import Any

import click

import bubbleviz as bv
from bubbleviz.cli.shared_options import (
    PATH,
    Bar,
    colour_delay_option,
    depth_topic_option,
    duration_option,
    frames_option,
    friction_option,
    hidden_alias,
    json_option,
    kappa_option,
    out_option,
    overwrite_option,
    publish_options,
    report,
    run,
    run_on_frames,
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
    "--sensor",
    default="auto",
    help="Sensor to simulate, only for --source synthetic:; auto (default): the built-in one.",
)


@click.command()
@_recording
@json_option
def info(recording: Path, as_json: bool) -> None:
    """List topics, frames, rate and gaps of a recording."""
    report(bv.info(recording), as_json=as_json)


@click.command()
@json_option
def presets(as_json: bool) -> None:
    """List the sensors and objects shipped with bubbleviz."""
    report(bv.presets(), as_json=as_json)


@click.command()
@json_option
def doctor(as_json: bool) -> None:
    """List versions, libraries, OpenGL and cameras, for bug reports."""
    report(bv.doctor(), as_json=as_json)


@click.command()
@option("--sensor", required=True, help="Sensor file or preset.")
@option(
    "--object",
    required=True,
    help="Preset or mesh file of the object, in m (in mm if its name ends in _mm).",
)
@option("--pose", help='Pose T_B_O of the object, "x y z qx qy qz qw" (m, unit quaternion).')
@option(
    "--path",
    "path_file",
    type=PATH,
    help="CSV with a pose for each frame (columns x_m,y_m,z_m,qx,qy,qz,qw), instead of --pose.",
)
@option("--frames", type=click.IntRange(1), default=1, help="Number of frames at --pose.")
@option(
    "--rate", "rate_hz", type=click.FloatRange(0.01, 1e4), default=30.0, help="Frames per second."
)
@_number("--noise-sigma", "noise_sigma_m", help="Noise: standard deviation of range, m.")
@_number("--noise-relative", help="Noise: standard deviation of range divided by range.")
@_number(
    "--noise-correlation",
    "noise_correlation_px",
    help="1/e distance of the noise's correlation, pixels; 0 (default): white noise.",
)
@_number("--holes", help="Fraction of pixels without a return, from 0 to below 1.")
@_number("--outliers", help="Fraction of pixels with a grossly wrong depth, 0 to below 1.")
@option("--seed", type=click.IntRange(0), default=0, help="Seed of the noise.")
@option(
    "--model",
    type=click.Choice(["rubber", "linear"]),
    help="rubber: exact membrane (default if the sensor file has a prestretch); linear: constant "
    "tension (default otherwise).",
)
@_number("--friction", metavar="MU", help="Coefficient of friction; needs the exact membrane.")
@_number(
    "--drag-m",
    metavar="M",
    help="After the press at --pose, drag the object along x of B, m; needs 10 --frames or more.",
)
@_number(
    "--twist-rad",
    metavar="RAD",
    help="After press and drag, twist the object about its z axis, rad; needs 10 --frames or more.",
)
@_number("--drag", "drag_mm", hidden=True)
@_number("--twist", "twist_deg", hidden=True)
@option("--texture", is_flag=True, help="Print a speckle on the membrane, and add colour images.")
@out_option("Recording, REC.mcap.")
@option("--truth", type=PATH, help="Ground truth, TRUTH.npz.")
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
    """Simulate a rigid object pressed into a sensor."""
    poses = path_file or pose
    if poses is None:
        raise click.UsageError("give --pose, or --path for a pose in every frame")
    if options["noise_sigma_m"] and options["noise_relative"]:
        raise click.UsageError("give either --noise-sigma or --noise-relative, not both")
    options["drag_m"] += 1e-3 * drag_mm
    options["twist_rad"] += radians(twist_deg)
    press = bv.simulate(sensor, object, poses, **options)
    with Bar() as bar:
        press.save(out, truth, overwrite=overwrite, progress=bar)


@click.command()
@_recording
@depth_topic_option
@sensor_option
@kappa_option
@solver_option
@frames_option
@out_option("Results of all frames, RESULT.npz.")
@option("--csv", type=PATH, help="Table with one row per frame, RESULT.csv.")
@zero_gas_option
@hidden_alias("--zero/--no-zero", "zero_gas", default=True)
@shear_option
@friction_option
@colour_delay_option
@json_option
def estimate(**options: Any) -> None:
    """Estimate contact pressure, patch and force in every frame."""
    _check_shear(options)
    run_on_frames("estimate", **options)


@click.command()
@_recording
@depth_topic_option
@sensor_option
@option("--object", required=True, help="Mesh file or preset of the object.")
@option(
    "--unit",
    type=click.Choice(["m", "mm"]),
    help="Unit of the mesh file; by default mm if its name ends in _mm, else m.",
)
@option("--init", help='Pose T_B_O in the first frame, "x y z qx qy qz qw"; searched by default.')
@solver_option
@friction_option
@zero_gas_option
@frames_option
@option(
    "--object-patch",
    is_flag=True,
    help="Also compute the patch area from the object at its pose.",
)
@out_option("Poses, POSES.csv.")
@json_option
def pose(**options: Any) -> None:
    """Find the pose of a known object in every frame."""
    run_on_frames("track", **options)


@click.command()
@_recording
@depth_topic_option
@sensor_option
@out_option("TABLE.csv, TABLE.parquet, PLOTS.png (or .svg, .pdf), or a new folder for --what.")
@option(
    "--what",
    default="",
    help="Files for the folder, separated by commas: table, parquet, plots, lerobot "
    "(dataset of one episode), vtk (ParaView), ply, "
    "patch (points with pressure), depth, pressure (pictures; png for both).",
)
@frames_option
@option("--poses", type=PATH, help="CSV that `bubbleviz pose` wrote, to add to the table.")
@kappa_option
@solver_option
@friction_option
@shear_option
@colour_delay_option
@json_option
def export(**options: Any) -> None:
    """Write tables, plots, meshes, points or pictures of a recording.

    Only products that the chosen files need are computed.
    """
    _check_shear(options)
    run_on_frames("export", **options)


@click.command()
@click.argument("source", metavar="IN", type=PATH)
@click.argument("out", metavar="OUT.mcap", type=PATH)
@option(
    "--intrinsics",
    type=PATH,
    help="Sensor file, or TOML or JSON with width, height, fx, fy, cx, cy, distortion_model and "
    "distortion; by default intrinsics.toml or .json in the folder.",
)
@option(
    "--rate",
    "rate_hz",
    type=click.FloatRange(0.01, 1e4),
    help="Images per second, instead of --times.",
)
@option(
    "--times",
    type=PATH,
    help="CSV with a time in s for each image; by default times.csv in the folder, or the file "
    "names.",
)
@option(
    "--gas-pressure",
    type=PATH,
    help="CSV of time in s and absolute gas pressure in Pa, to add to images.",
)
@hidden_alias("--pressure", "gas_pressure", type=PATH)
@option("--wrench", type=PATH, help="CSV of time in s, forces x y z in N, torques in N·m.")
@option(
    "--metres-per-unit",
    type=click.FloatRange(0.0, min_open=True),
    help="Depth of a pixel value of 1, m; by default 0.001 for integers, 1 for floats.",
)
@overwrite_option
@json_option
def convert(**options: Any) -> None:
    """Convert depth images or another recording to MCAP.

    IN is a folder of depth images (.npy, 16-bit .png or .tif, in the order of the numbers in their
    names), a ROS 1 or RealSense .bag, or a rosbag2 .db3. Depth, colour, camera info, gas pressure
    and wrench are kept, the last two at the times of the frames.
    """
    run("convert", **options)


@click.command()
@_recording
@depth_topic_option
@option("--sensor", required=True, help="Initial sensor file or preset.")
@option(
    "--contact-free", metavar="A:B", help="Frames A to B−1 without contact; searched by default."
)
@out_option("Sensor file, SENSOR.toml.")
@option("--report", type=PATH, help="New folder for the report, HTML and JSON.")
@option(
    "--surface",
    type=click.Choice(["sphere", "ellipsoid", "free-form"]),
    help="Shape of the membrane; the one that fits best by default.",
)
@option("--nodes", type=click.IntRange(30, 20_000), default=1000, help="Nodes of the mesh.")
@option(
    "--level",
    "levels",
    multiple=True,
    type=PATH,
    help="Recording of the untouched sensor at another inflation level; may be given repeatedly.",
)
@option(
    "--level-sigma",
    type=click.FloatRange(min=0.0),
    metavar="PA",
    help="Standard deviation of gas pressure differences between recordings, Pa; by default 1 % of "
    "the largest gauge pressure.",
)
@option(
    "--vented",
    type=PATH,
    help="Recording with the chamber open to the air, for the atmospheric pressure.",
)
@option(
    "--held-press/--no-held-press",
    default=True,
    help="Without --level, determine the pre-stretch λ and the gauge pressure from a press held "
    "still in REC (default).",
)
@hidden_alias("--press/--no-press", "held_press", default=True)
@option("--object", help="Known object pressed in REC, for validation: mesh file or preset.")
@option("--pose", help='Pose T_B_O of that object, "x y z qx qy qz qw" (m, unit quaternion).')
@option("--pressed", metavar="A:B", help="Frames A to B−1 in which that object is held still.")
@json_option
def identify(levels: Any, vented: Any, **options: Any) -> None:
    """Make a sensor file from contact-free frames.

    Determines the shape at rest, the tension γ0 and the error of each pixel. Inflation levels with
    gas pressures also give the pre-stretch λ and the gauge pressure; so does, less precisely, a
    press held still in REC.
    """
    with ExitStack() as files:
        if topic := options["depth_topic"]:  # else they are opened one at a time
            levels = [files.enter_context(bv.open(each, depth_topic=topic)) for each in levels]
            vented = vented and files.enter_context(bv.open(vented, depth_topic=topic))
        run_on_frames("identify", levels=levels, vented=vented, **options)


@click.command()
@_recording
@depth_topic_option
@sensor_option
@option(
    "--contact-free", metavar="A:B", help="Frames A to B−1 without contact; searched by default."
)
@json_option
def check(**options: Any) -> None:
    """Check whether the sensor file still fits.

    Compares contact-free frames of REC with the sensor file. The verdict is fits, drifted (by how
    many mm and N), or another membrane or camera, with the remedy.
    """
    run_on_frames("check", **options)


@click.command()
@_recording
@depth_topic_option
@sensor_option
@option(
    "--wrench",
    metavar="TOPIC",
    help="Topic of the wrench sensor; by default that most similar in name to the depth topic.",
)
@solver_option
@friction_option
@zero_gas_option
@out_option(
    "PLOT.png (.svg, .pdf), TABLE.csv, NUMBERS.json, or a new folder for all.", required=False
)
@json_option
def validate(**options: Any) -> None:
    """Compare the estimated force with a wrench sensor.

    Reports bias, gain, rotation, delay and hysteresis with 95 % intervals; corrects nothing.
    """
    run_on_frames("validate", **options)


@click.command()
@click.argument("first", metavar="A", type=PATH)
@click.argument("other", metavar="B", type=PATH)
@sensor_option
@option("--other-sensor", help="Sensor file or preset of B; by default the same as for A.")
@option(
    "--align",
    type=click.Choice(["time", "contact"]),
    default="time",
    help="time: since A and B began (default); contact: since their first frame with contact.",
)
@out_option(
    "PLOT.png (.svg, .pdf), TABLE.csv, NUMBERS.json, or a new folder for all.", required=False
)
@json_option
def compare(first: Path, other: Path, **options: Any) -> None:
    """Compare force and patch of two recordings.

    A and B are recordings, or RESULT.npz of estimate; give a recording twice to compare two sensor
    files. Reports the median, 95th percentile and maximum of the differences in contact.
    """
    run("compare", first, other, **options)


@click.command()
@click.argument("folder", metavar="FOLDER", type=PATH)
@sensor_option
@out_option("New folder for the results.")
@option(
    "--jobs",
    type=click.IntRange(1, 1024),
    help="Number of processes; one per processor by default.",
)
@option("--scheduler", metavar="ADDRESS", help="Dask scheduler, e.g. tcp://10.0.0.5:8786.")
@option(
    "--resume",
    is_flag=True,
    help="Continue in an existing folder; keep results that are up to date.",
)
@kappa_option
@solver_option
@friction_option
@zero_gas_option
@frames_option
@depth_topic_option
@json_option
def batch(**options: Any) -> None:
    """Estimate all recordings in a folder and its subfolders, in parallel.

    OUT/summary.csv compares them. If a recording fails, the others continue; the exit code is then
    2 (bad input) or 1.
    """
    run("batch", **options).raise_failures()


@click.command()
@source_option
@out_option("Recording: REC.mcap, or a folder (rosbag2).")
@duration_option
@_simulated
@json_option
def record(as_json: bool, **options: Any) -> None:
    """Record every message of a live source.

    ^C ends the recording. After a crash the file can be opened up to the last second.
    """
    report(bv.record(**options), as_json=as_json)


@click.command()
@source_option
@sensor_option
@publish_options
@hidden_alias("--publish", "listen")
@hidden_alias("--publish-to", "connect")
@out_option("Recording of messages and results.", required=False)
@duration_option
@solver_option
@option("--object", help="Object to track: preset, or mesh file in m (name ends in _mm: mm).")
@zero_gas_option
@hidden_alias("--zero/--no-zero", "zero_gas", default=True)
@shear_option
@friction_option
@colour_delay_option
@json_option
def watch(as_json: bool, **options: Any) -> None:
    """Estimate a live source without a window; publish or record.

    With --shear start without contact: the first colour images are the reference.
    """
    _check_shear(options)
    report(bv.watch(**options), as_json=as_json)


@click.command()
@source_option
@publish_options
@option("--domain", type=click.IntRange(0, 232), default=0, help="ROS_DOMAIN_ID.")
@duration_option
@option("--wait", is_flag=True, help="Start when a subscriber connects.")
@_simulated
@json_option
def publish(as_json: bool, **options: Any) -> None:
    """Publish a source over Zenoh, as ROS 2 nodes would.

    By default for subscribers on this computer, at tcp/127.0.0.1:7447.
    """
    report(bv.publish(**options), as_json=as_json)


def _check_shear(options: dict[str, Any]) -> None:
    if options["colour_delay_s"] is not None and not options["shear"]:
        raise click.UsageError(
            "--colour-delay needs --shear, which uses the colour images; give both"
        )
