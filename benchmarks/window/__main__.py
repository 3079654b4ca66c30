"""`python -m benchmarks.window …`: one function per command, with imports inside."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from bubbleviz.cli.binding import PATH, json_option, report
from bubbleviz.cli.command_line import OneLineErrors
from bubbleviz.files import SYNTHETIC_SENSOR, to_json

if TYPE_CHECKING:
    from bubbleviz.sensor import Sensor


@click.group(cls=OneLineErrors)
def bench() -> None:
    """Measure the speed of the window on this machine."""


_sensor = click.option("--sensor", help="Sensor file or preset; by default the preset that fits.")
_recording = click.argument("recording", metavar="REC", type=PATH)
_perhaps = click.argument("recording", metavar="[REC]", required=False, type=PATH)


@bench.command("window")
@_perhaps
@click.option("--synthetic", is_flag=True, help="The built-in press in place of a recording.")
@_sensor
@click.option("--seconds", type=click.FloatRange(1.0, 600.0), default=8.0, help="How long.")
@json_option
def bench_window(
    recording: Path | None, synthetic: bool, sensor: str | None, seconds: float, as_json: bool
) -> None:
    """Replay with membrane and cloud shown, and count the rendered frames."""
    if synthetic == (recording is not None):
        raise click.UsageError("give either REC or --synthetic")
    from benchmarks.window.replay_rate import replay_fps

    _print_measured(replay_fps(_sensor_for(recording, sensor), recording, seconds), as_json)


@bench.command("start")
@_recording
@_sensor
@click.option("--runs", type=click.IntRange(1, 100), default=5, help="Processes to start.")
@json_option
def bench_start(recording: Path, sensor: str | None, runs: int, as_json: bool) -> None:
    """Time from starting a process to its first picture of a recording."""
    from benchmarks.window.start_times import start_times
    from bubbleviz.recordings import checked_sensor

    checked_sensor(recording, sensor)
    _print_measured(start_times(recording, sensor, runs), as_json)


@bench.command("seek")
@_recording
@_sensor
@click.option("--seeks", type=click.IntRange(1, 10_000), default=60, help="How many.")
@json_option
def bench_seek(recording: Path, sensor: str | None, seeks: int, as_json: bool) -> None:
    """Time from a seek anywhere in a recording to the new picture."""
    from benchmarks.window.start_times import seek_times

    _print_measured(seek_times(_sensor_for(recording, sensor), recording, seeks), as_json)


@bench.command("monkey")
@_perhaps
@_sensor
@click.option("--minutes", type=click.FloatRange(0.02, 600.0), default=10.0, help="How long.")
@click.option("--seed", type=click.IntRange(0), default=0, help="Seed of the clicks.")
@json_option
def bench_monkey(
    recording: Path | None, sensor: str | None, minutes: float, seed: int, as_json: bool
) -> int:
    """Click and type at random; exit code 1 after an exception or with 100 MiB more memory.

    Memory is compared in runs of at least a minute.
    """
    from benchmarks.window.monkey import REST_EVERY_S, monkey_run

    seconds = 60.0 * minutes
    with_memory = seconds >= REST_EVERY_S
    seen = monkey_run(_sensor_for(recording, sensor), recording, seconds, seed, memory=with_memory)
    _print_measured(seen.measured, as_json)
    if seen.longest:
        click.echo(f"blocked longest by {seen.longest}", err=True)
    for problem in seen.problems:
        click.echo(problem, err=True)
    return int(not seen.passed)


@bench.command("pair")
@click.option("--session", default="dual_nut", help="Session of two synthetic sensors.")
@click.option("--seconds", type=click.FloatRange(1.0, 600.0), default=20.0, help="How long.")
@click.option("--rate", type=click.FloatRange(1.0, 1000.0), default=30.0, help="Frames a second.")
@json_option
def bench_pair(session: str, seconds: float, rate: float, as_json: bool) -> int:
    """Two 640×480 cameras over Zenoh into one window: rates of solved and drawn frames.

    The window also records them; exit code 1 when a frame is missing in the file.
    """
    from benchmarks.window.live_pair import pair_bench
    from bubbleviz.live import load_session

    measured = pair_bench(load_session(session), seconds, rate)
    report(measured, as_json=as_json)
    return measured.exit_code


def _sensor_for(recording: Path | None, sensor: str | None) -> Sensor:
    """The named sensor, else the preset that fits the recording or is simulated."""
    from bubbleviz.recordings import checked_sensor
    from bubbleviz.sensor import load_sensor

    if recording is None:
        return load_sensor(sensor or SYNTHETIC_SENSOR)
    return checked_sensor(recording, sensor)[1]


def _print_measured(measured: dict[str, float], as_json: bool) -> None:
    """Print numbers by name; NaN as null in JSON."""
    lines = (f"{key:<16} {value:.4g}" for key, value in measured.items())
    click.echo(to_json(measured) if as_json else "\n".join(lines))


if __name__ == "__main__":
    bench(prog_name="python -m benchmarks.window")
