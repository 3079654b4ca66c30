"""The command `convert`: other recordings and folders of images to MCAP; heavy imports inside."""

from __future__ import annotations

from pathlib import Path

import click

_FILE = click.Path(path_type=Path)


@click.command()
@click.argument("source", metavar="IN", type=_FILE)
@click.argument("out", metavar="OUT.mcap", type=_FILE)
@click.option(
    "--intrinsics",
    type=_FILE,
    help="TOML or JSON with width, height, fx, fy, cx, cy, distortion_model and distortion, or a "
    "sensor file; by default intrinsics.toml or .json in the folder.",
)
@click.option("--rate", type=click.FloatRange(0.01, 1e4), help="Images a second.")
@click.option(
    "--times",
    type=_FILE,
    help="CSV with a time in s for each image; by default times.csv in the folder, or the names.",
)
@click.option("--pressure", type=_FILE, help="CSV of time in s and absolute gas pressure in Pa.")
@click.option("--wrench", type=_FILE, help="CSV of time in s, forces x y z in N, torques in N·m.")
@click.option(
    "--metres-per-unit",
    type=click.FloatRange(0.0, min_open=True),
    help="Of the images' values; 0.001 for whole numbers, 1 for others by default.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON, SI units.")
def convert(
    source: Path,
    out: Path,
    intrinsics: Path | None,
    rate: float | None,
    times: Path | None,
    pressure: Path | None,
    wrench: Path | None,
    metres_per_unit: float | None,
    as_json: bool,
) -> None:
    """Make a recording of a folder of depth images, a ROS 1 .bag or a rosbag2 .db3.

    Images are .npy, 16-bit .png or .tif, in the order of the numbers in their names. Depth,
    camera info, gas pressure and wrench of a bag are kept, the latter at the frames' times.
    """
    from tqdm import tqdm

    from bubbleviz.commands.convert import Beside
    from bubbleviz.commands.convert import convert as written

    if rate is not None and times is not None:
        raise click.UsageError("give either --rate or --times")
    beside = Beside(intrinsics, times, pressure, wrench, rate, metres_per_unit)
    with tqdm(total=100, unit="%", leave=False, disable=None) as bar:  # only on a terminal

        def advance(step: str, done: float) -> None:
            bar.update(100.0 * done - bar.n)

        summary = written(source, out, beside, advance)
    click.echo(summary.to_json() if as_json else summary.to_text())
