"""The command line: one thin function per command; imports nothing heavy until it is needed."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, NoReturn

import click

import bubbleviz
from bubbleviz.batch.command import batch
from bubbleviz.calibration.command import identify
from bubbleviz.errors import InputError, SolveError
from bubbleviz.export.command import export
from bubbleviz.study.command import study

# The solver's matrices are small: BLAS threads that wait for each other cost more than they save.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

SYNTHETIC_SENSOR = "pico_flexx_75mm"
"""Preset of the built-in live sensor."""


class OneLineErrors(click.Group):
    """A command group whose errors are one line on stderr.

    Exit code 2 for wrong usage and bad input, 1 for a problem without an answer, 130 for ^C.
    """

    def main(  # type: ignore[override]
        self, args: Sequence[str] | None = None, standalone_mode: bool = True, **extra: Any
    ) -> Any:
        """Run as `click.Group.main` does, with our own way of reporting errors."""
        if not standalone_mode:
            return super().main(args, standalone_mode=False, **extra)
        try:
            code = super().main(args, standalone_mode=False, **extra)
        except InputError as error:
            _fail(str(error), 2)
        except SolveError as error:
            _fail(str(error), 1)
        except click.UsageError as error:
            command = error.ctx.command_path if error.ctx else "bubbleviz"
            _fail(f"{_in_one_line(error)}; see {command} --help", 2)
        except click.ClickException as error:
            _fail(error.format_message(), error.exit_code)
        except click.Abort:
            _fail("stopped", 130)
        sys.exit(code if isinstance(code, int) else 0)


def _in_one_line(error: click.UsageError) -> str:
    """What was wrong; click's own text for a group without a command is its whole help."""
    if isinstance(error, getattr(click.exceptions, "NoArgsIsHelpError", ())):
        return "Missing command"
    return error.format_message().rstrip(".")


def _fail(message: str, code: int) -> NoReturn:
    click.echo(f"bubbleviz: {' '.join(message.split())}", err=True)
    sys.exit(code)


def _print_measured(measured: dict[str, float], as_json: bool) -> None:
    """Numbers by name; a NaN is null in JSON, which has none."""
    if as_json:
        import json
        import math

        finite = {key: value if math.isfinite(value) else None for key, value in measured.items()}
        click.echo(json.dumps(finite, indent=2, allow_nan=False))
        return
    for key, value in measured.items():
        click.echo(f"{key:<16} {value:.4g}")


@click.group(cls=OneLineErrors, invoke_without_command=True)
@click.version_option(bubbleviz.__version__)
@click.option("--fresh", is_flag=True, help="Leave the window's last session alone.")
@click.pass_context
def main(context: click.Context, fresh: bool) -> int:
    """Calibrate, watch and debug Soft-bubble tactile sensors.

    Without a command: the window as it was left, at first on a live synthetic sensor.
    """
    if context.invoked_subcommand is not None:
        return 0
    from bubbleviz.sensor import load_sensor
    from ui.app import run_window

    return run_window(load_sensor(SYNTHETIC_SENSOR), fresh=fresh)


# -- the window: open, bench --------------------------------------------------------------------


@main.command("open")
@click.argument("recording", metavar="[REC]", required=False, type=click.Path(path_type=Path))
@click.option("--source", help="A live source: synthetic:, replay:REC, zenoh:, realsense:")
@click.option("--session", help="Live sensors together: a session preset or TOML file.")
@click.option("--sensor", help="Sensor file or preset; by default the preset that fits.")
@click.option("--scene", help="Scene preset: press, cloud, residual, dual_nut.")
@click.option("--frame", type=click.IntRange(0), help="Stay at this frame.")
@click.option("--screenshot", type=click.Path(path_type=Path), help="Write OUT.png and exit.")
@click.option("--fresh", is_flag=True, help="Leave the window's last session alone.")
def open_recording(
    recording: Path | None,
    source: str | None,
    session: str | None,
    sensor: str | None,
    scene: str | None,
    frame: int | None,
    screenshot: Path | None,
    fresh: bool,
) -> int:
    """Show a recording or a live source in the window."""
    if sum(given is not None for given in (recording, source, session)) != 1:
        raise click.UsageError("give one of REC, --source and --session")
    if recording is None:
        if frame is not None or screenshot is not None:
            raise click.UsageError("--frame and --screenshot are for recordings")
        return _open_live(source, session, sensor, scene, fresh=fresh)
    from bubbleviz.matching import checked_sensor
    from ui.presets import load_scene

    if screenshot is not None:
        from bubbleviz.outputs import refuse_existing

        refuse_existing(screenshot)
    preset = None if scene is None else load_scene(scene)
    name, chosen = checked_sensor(recording, sensor)
    if sensor is None:
        click.echo(f"sensor: preset {name}, whose camera has the image size of {recording}")
    from ui import app

    if screenshot is None:
        return app.run_window(chosen, recording, frame, preset, fresh=fresh)
    app.screenshot(chosen, recording, frame or 0, screenshot, preset)
    click.echo(f"wrote {screenshot}")
    return 0


def _open_live(
    source: str | None,
    session: str | None,
    sensor: str | None,
    scene: str | None,
    *,
    fresh: bool,
) -> int:
    """The window on live sensors."""
    from bubbleviz.live.session_file import load_session
    from bubbleviz.sensor import load_sensor
    from ui.app import run_window
    from ui.live.connection import single
    from ui.presets import load_scene

    if session is not None and sensor is not None:
        raise click.UsageError("the sensors are named in the session file; leave --sensor out")
    name = sensor or SYNTHETIC_SENSOR
    live = single(source, name) if source is not None else load_session(session or "")
    preset = None if scene is None else load_scene(scene)
    return run_window(
        load_sensor(live.sensors[0].sensor), None, None, preset, fresh=fresh, live=live
    )


@main.group()
def bench() -> None:
    """Measure how fast this machine is."""


@bench.command("window")
@click.argument("recording", metavar="[REC]", required=False, type=click.Path(path_type=Path))
@click.option("--synthetic", is_flag=True, help="The built-in press in place of a recording.")
@click.option("--sensor", help="Sensor file or preset; by default the preset that fits.")
@click.option("--seconds", type=click.FloatRange(1.0, 600.0), default=8.0, help="How long.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def bench_window(
    recording: Path | None, synthetic: bool, sensor: str | None, seconds: float, as_json: bool
) -> None:
    """Replay with membrane and cloud shown, and count the rendered frames."""
    if synthetic == (recording is not None):
        raise click.UsageError("give either REC or --synthetic")
    from bubbleviz.matching import checked_sensor
    from bubbleviz.sensor import load_sensor

    if recording is None:
        chosen = load_sensor(sensor or SYNTHETIC_SENSOR)
    else:
        _, chosen = checked_sensor(recording, sensor)
    from ui.benchmark import replay_fps

    measured = replay_fps(chosen, recording, seconds)
    _print_measured(measured, as_json)


@bench.command("start")
@click.argument("recording", metavar="REC", type=click.Path(path_type=Path))
@click.option("--sensor", help="Sensor file or preset; by default the preset that fits.")
@click.option("--runs", type=click.IntRange(1, 100), default=5, help="Processes to start.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def bench_start(recording: Path, sensor: str | None, runs: int, as_json: bool) -> None:
    """Time from starting a process to its first picture of a recording."""
    from bubbleviz.matching import checked_sensor
    from ui.benchmark_start import start_times

    checked_sensor(recording, sensor)
    _print_measured(start_times(recording, sensor, runs), as_json)


@bench.command("seek")
@click.argument("recording", metavar="REC", type=click.Path(path_type=Path))
@click.option("--sensor", help="Sensor file or preset; by default the preset that fits.")
@click.option("--seeks", type=click.IntRange(1, 10_000), default=60, help="How many.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def bench_seek(recording: Path, sensor: str | None, seeks: int, as_json: bool) -> None:
    """Time from a seek anywhere in a recording to the new picture."""
    from bubbleviz.matching import checked_sensor
    from ui.benchmark_start import seek_times

    _, chosen = checked_sensor(recording, sensor)
    _print_measured(seek_times(chosen, recording, seeks), as_json)


@bench.command("monkey")
@click.argument("recording", metavar="[REC]", required=False, type=click.Path(path_type=Path))
@click.option("--sensor", help="Sensor file or preset; by default the preset that fits.")
@click.option("--minutes", type=click.FloatRange(0.02, 600.0), default=10.0, help="How long.")
@click.option("--seed", type=click.IntRange(0), default=0, help="Seed of the clicks.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def bench_monkey(
    recording: Path | None, sensor: str | None, minutes: float, seed: int, as_json: bool
) -> int:
    """Click and type at random; exit code 1 after an exception or with 100 MiB more memory."""
    from bubbleviz.matching import checked_sensor
    from bubbleviz.sensor import load_sensor
    from ui.benchmark_monkey import monkey_run

    if recording is None:
        chosen = load_sensor(sensor or SYNTHETIC_SENSOR)
    else:
        _, chosen = checked_sensor(recording, sensor)
    report = monkey_run(chosen, recording, 60.0 * minutes, seed)
    _print_measured(report.measured, as_json)
    for problem in report.problems:
        click.echo(problem, err=True)
    return int(not report.passed)


@bench.command("live")
@click.option("--minutes", type=click.FloatRange(0.05, 600.0), default=1.0, help="How long.")
@click.option("--rate", type=click.FloatRange(1.0, 1000.0), default=60.0, help="Frames a second.")
@click.option("--sensor", default=SYNTHETIC_SENSOR, help="Sensor simulated and solved.")
@click.option("--out", type=click.Path(path_type=Path), help="Keep the recording here.")
@click.option("--window", is_flag=True, help="With the window open, on a screen nobody sees.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON, SI units.")
def bench_live(
    minutes: float, rate: float, sensor: str, out: Path | None, window: bool, as_json: bool
) -> int:
    """Stream over Zenoh, record and solve; exit code 1 when a frame is missing in the file."""
    if window:
        from ui.live.bench_soak import window_soak

        whole = window_soak(sensor, 60.0 * minutes, rate, out)
        click.echo(whole.to_json() if as_json else whole.to_text())
        return whole.soak.exit_code
    from bubbleviz.live.soak import soak

    report = soak(sensor, 60.0 * minutes, rate, out)
    click.echo(report.to_json() if as_json else report.to_text())
    return report.exit_code


@bench.command("pair")
@click.option("--session", default="dual_nut", help="Session of two synthetic sensors.")
@click.option("--seconds", type=click.FloatRange(1.0, 600.0), default=20.0, help="How long.")
@click.option("--rate", type=click.FloatRange(1.0, 1000.0), default=30.0, help="Frames a second.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON, SI units.")
def bench_pair(session: str, seconds: float, rate: float, as_json: bool) -> None:
    """Two 640×480 cameras over Zenoh into one window: what is solved and drawn a second."""
    from bubbleviz.live.session_file import load_session
    from ui.live.bench_pair import pair_bench

    report = pair_bench(load_session(session), seconds, rate)
    click.echo(report.to_json() if as_json else report.to_text())


@bench.command("restarts")
@click.option("--times", type=click.IntRange(1, 1000), default=20, help="How often.")
@click.option("--seed", type=click.IntRange(0), default=0, help="Seed of the moments.")
@click.option("--sensor", default=SYNTHETIC_SENSOR, help="Sensor simulated and solved.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON, SI units.")
def bench_restarts(times: int, seed: int, sensor: str, as_json: bool) -> int:
    """Kill and restart a publisher under a recording window; exit code 1 after a loss."""
    from ui.live.bench_restarts import restart_bench

    report = restart_bench(sensor, times, seed)
    click.echo(report.to_json() if as_json else report.to_text())
    return int(not report.passed)


# -- recordings: info, simulate -----------------------------------------------------------------


@main.command()
@click.argument("recording", metavar="REC", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print JSON, SI units.")
def info(recording: Path, as_json: bool) -> None:
    """Show topics, frames, rate, duration, size and gaps of a recording."""
    from bubbleviz.frames.info import recording_info

    facts = recording_info(recording)
    click.echo(facts.to_json() if as_json else facts.to_text())


@main.command()
@click.option("--sensor", required=True, help="Sensor file or preset.")
@click.option("--object", "object_name", required=True, help="Object mesh or preset.")
@click.option("--pose", help='T_B_O as "x y z qx qy qz qw" (m, unit quaternion).')
@click.option("--path", "path_file", type=click.Path(path_type=Path), help="CSV of poses.")
@click.option("--frames", type=click.IntRange(1), default=1, help="Frames at --pose.")
@click.option("--rate", type=click.FloatRange(0.01, 1e4), default=30.0, help="Frames a second.")
@click.option("--noise-sigma", type=float, default=0.0, help="σ of range, m.")
@click.option("--noise-relative", type=float, default=0.0, help="σ of range over range.")
@click.option("--noise-correlation", type=float, default=0.0, help="1/e distance of noise, pixels.")
@click.option("--holes", type=float, default=0.0, help="Fraction of pixels without a return.")
@click.option("--outliers", type=float, default=0.0, help="Fraction of pixels far off.")
@click.option("--seed", type=click.IntRange(0), default=0, help="Seed of the noise.")
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
    out: Path,
    truth: Path | None,
) -> None:
    """Record a rigid object pressed into a simulated sensor."""
    where = pose or path_file
    if where is None or (pose and path_file):
        raise click.UsageError("give either --pose or --path")
    if noise_sigma and noise_relative:
        raise click.UsageError("give either --noise-sigma or --noise-relative")
    from bubbleviz.frames.noise import DepthNoise
    from bubbleviz.simulate import simulated_press, write_simulation

    noise = DepthNoise(
        relative=noise_relative,
        absolute_m=noise_sigma,
        correlation_px=noise_correlation,
        holes=holes,
        outliers=outliers,
    )
    source = simulated_press(
        sensor, object_name, where, noise, frames=frames, rate_hz=rate, seed=seed
    )
    write_simulation(source, out, truth)


@main.command()
@click.option("--source", required=True, help="synthetic:, replay:REC, zenoh:, realsense:")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="REC.mcap or a folder.")
@click.option("--duration", type=click.FloatRange(0.0, min_open=True), help="Seconds; or until ^C.")
@click.option("--sensor", default=SYNTHETIC_SENSOR, help="Sensor that synthetic: simulates.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON, SI units.")
def record(source: str, out: Path, duration: float | None, sensor: str, as_json: bool) -> None:
    """Record every message of a live source.

    ^C ends the recording; the file is whole. Should the machine stop, it opens up to the last
    second.
    """
    from bubbleviz.live.record import record_source
    from bubbleviz.sensor import load_sensor

    summary = record_source(source, load_sensor(sensor), out, duration)
    click.echo(summary.to_json() if as_json else summary.to_text())


@main.command()
@click.option("--source", required=True, help="synthetic:, replay:REC, zenoh:, realsense:")
@click.option("--sensor", required=True, help="Sensor file or preset.")
@click.option("--publish", metavar="ENDPOINT", help="Publish results here: tcp/127.0.0.1:7448")
@click.option("--publish-to", metavar="ENDPOINT", help="Publish results through this router.")
@click.option("--out", type=click.Path(path_type=Path), help="Record messages and results.")
@click.option("--duration", type=click.FloatRange(0.0, min_open=True), help="Seconds; or until ^C.")
@click.option("--solver", help="Solver of the inverse problem.")
@click.option("--object", "object_name", help="Object to track: a mesh or a preset.")
@click.option("--zero/--no-zero", default=True, help="Zero the gas pressure at the start.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON, SI units.")
def watch(source: str, sensor: str, zero: bool, as_json: bool, **choices: Any) -> None:
    """Solve a live source without a window, and publish or record the results."""
    from bubbleviz.live.watch import WatchOptions, watch_source
    from bubbleviz.sensor import load_sensor

    options = WatchOptions(
        out=choices["out"],
        publish=_zenoh_place("--publish", choices["publish"], choices["publish_to"]),
        duration_s=choices["duration"],
        solver=choices["solver"],
        object_name=choices["object_name"],
        zero=zero,
    )
    summary = watch_source(source, load_sensor(sensor), options)
    click.echo(summary.to_json() if as_json else summary.to_text())


@main.command()
@click.option("--source", required=True, help="synthetic:, replay:REC, zenoh:, realsense:")
@click.option("--listen", metavar="ENDPOINT", help="Subscribers connect here; loopback, 7447.")
@click.option("--connect", metavar="ENDPOINT", help="Publish through this router instead.")
@click.option("--layout", type=click.Choice(["rmw", "dds"]), default="rmw", help="Names of keys.")
@click.option("--domain", type=click.IntRange(0, 232), default=0, help="ROS_DOMAIN_ID.")
@click.option("--duration", type=click.FloatRange(0.0, min_open=True), help="Seconds; or until ^C.")
@click.option("--sensor", default=SYNTHETIC_SENSOR, help="Sensor that synthetic: simulates.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def publish(
    source: str,
    listen: str | None,
    connect: str | None,
    layout: Any,
    domain: int,
    duration: float | None,
    sensor: str,
    as_json: bool,
) -> None:
    """Publish a source over Zenoh, as a robot's ROS 2 nodes would."""
    from bubbleviz.live.publish import publish_source
    from bubbleviz.sensor import load_sensor

    if listen is None and connect is None:
        listen = "tcp/127.0.0.1:7447"
    place = _zenoh_place("--listen", listen, connect)
    summary = publish_source(
        source, load_sensor(sensor), place, layout=layout, domain=domain, duration_s=duration
    )
    click.echo(summary.to_json() if as_json else summary.to_text())


def _zenoh_place(option: str, listen: str | None, connect: str | None) -> Any:
    """Where to publish; None for nowhere."""
    from bubbleviz.live.zenoh_session import SessionOptions

    if listen is not None and connect is not None:
        raise click.UsageError("publish at a place or through a router, not both")
    if listen is None and connect is None:
        return None
    return SessionOptions(f"{option} {listen or connect}", connect, listen)


# -- the inverse problem: estimate --------------------------------------------------------------


@main.command()
@click.argument("recording", metavar="REC", type=click.Path(path_type=Path))
@click.option("--sensor", required=True, help="Sensor file or preset.")
@click.option("--kappa", type=float, help="Patch threshold over the mean contact pressure.")
@click.option("--solver", help="Solver of the inverse problem.")
@click.option("--frames", help="A:B[:STEP], B left out; all by default.")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="RESULT.npz.")
@click.option("--csv", "csv_file", type=click.Path(path_type=Path), help="RESULT.csv.")
@click.option("--zero-gas", is_flag=True, help="Zero the gas pressure on the first rest.")
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
    as_json: bool,
) -> None:
    """Contact pressure, patch and force of every frame of a recording."""
    from bubbleviz.estimate import estimate_recording

    summary = estimate_recording(
        recording,
        sensor,
        out,
        csv_file,
        kappa=kappa,
        solver=solver,
        frames=frames,
        zero_gas=zero_gas,
    )
    click.echo(summary.to_json() if as_json else summary.to_text())


# -- pose of a known object ---------------------------------------------------------------------


@main.command()
@click.argument("recording", metavar="REC", type=click.Path(path_type=Path))
@click.option("--sensor", required=True, help="Sensor file or preset.")
@click.option("--object", "object_name", required=True, help="Object mesh or preset.")
@click.option("--unit", type=click.Choice(["m", "mm"]), help="Unit of the object's file.")
@click.option("--init", help='T_B_O in the first frame as "x y z qx qy qz qw"; else searched for.')
@click.option("--solver", help="Solver of the inverse problem.")
@click.option("--frames", help="A:B[:STEP], B left out; all by default.")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="POSES.csv.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON, SI units, times in ms.")
def pose(
    recording: Path,
    sensor: str,
    object_name: str,
    unit: Literal["m", "mm"] | None,
    init: str | None,
    solver: str | None,
    frames: str | None,
    out: Path,
    as_json: bool,
) -> None:
    """Where a known object is in every frame of a recording."""
    from bubbleviz.pose.record import pose_recording

    summary = pose_recording(
        recording, sensor, object_name, out, init=init, unit=unit, solver=solver, frames=frames
    )
    click.echo(summary.to_json() if as_json else summary.to_text())


# -- calibration and studies, which live beside what they do ------------------------------------

main.add_command(batch)
main.add_command(identify)
main.add_command(export)
main.add_command(study)
