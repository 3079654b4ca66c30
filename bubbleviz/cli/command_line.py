"""The command line: one thin function per command; imports nothing heavy until it is needed."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, NoReturn

import click

import bubbleviz
from bubbleviz.cli.batch_command import batch
from bubbleviz.cli.export_command import export
from bubbleviz.cli.identify_command import identify
from bubbleviz.cli.live_commands import publish, record, watch
from bubbleviz.cli.study_commands import study
from bubbleviz.errors import InputError, SolveError
from bubbleviz.files.defaults import SESSION_SUFFIX, SYNTHETIC_SENSOR
from bubbleviz.files.preset_files import preset_names
from bubbleviz_ui.bench.bench_commands import bench

# The solver's matrices are small: BLAS threads that wait for each other cost more than they save.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


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
    from bubbleviz_ui.app import run_window

    return run_window(load_sensor(SYNTHETIC_SENSOR), fresh=fresh)


# -- the window: open --------------------------------------------------------------------


@main.command("open")
@click.argument(
    "recording", metavar="[REC | X.bubbleviz]", required=False, type=click.Path(path_type=Path)
)
@click.option("--source", help="A live source: synthetic:, replay:REC, zenoh:, realsense:")
@click.option("--session", help="Live sensors together: a session preset or TOML file.")
@click.option("--sensor", help="Sensor file or preset; by default the preset that fits.")
@click.option("--scene", help=f"Scene preset: {', '.join(preset_names('scenes'))}.")
@click.option(
    "--truth",
    type=click.Path(path_type=Path),
    help="TRUTH.npz of a simulated REC; by default the one beside it of the same name.",
)
@click.option("--frame", type=click.IntRange(0), help="Stay at this frame.")
@click.option("--screenshot", type=click.Path(path_type=Path), help="Write OUT.png and exit.")
@click.option("--fresh", is_flag=True, help="Leave the window's last session alone.")
def open_recording(
    recording: Path | None,
    source: str | None,
    session: str | None,
    sensor: str | None,
    scene: str | None,
    truth: Path | None,
    frame: int | None,
    screenshot: Path | None,
    fresh: bool,
) -> int:
    """Show a recording, a saved session or a live source in the window."""
    if sum(given is not None for given in (recording, source, session)) != 1:
        raise click.UsageError("give one of REC, --source and --session")
    if recording is None:
        if any(given is not None for given in (truth, frame, screenshot)):
            raise click.UsageError("--truth, --frame and --screenshot are for recordings")
        return _open_live(source, session, sensor, scene, fresh=fresh)
    if recording.suffix.lower() == SESSION_SUFFIX:
        if any(given is not None for given in (sensor, truth, frame, screenshot)):
            raise click.UsageError("--sensor, --truth, --frame and --screenshot are for recordings")
        return _open_saved(recording, scene, fresh=fresh)
    from bubbleviz.frames.sensor_matching import checked_sensor
    from bubbleviz_ui.model.scene_presets import load_scene

    if screenshot is not None:
        from bubbleviz.files.output_files import refuse_existing

        refuse_existing(screenshot)
    preset = None if scene is None else load_scene(scene)
    name, chosen = checked_sensor(recording, sensor)
    if sensor is None:
        click.echo(f"sensor: preset {name}, whose camera has the image size of {recording}")
    from bubbleviz_ui import app

    if screenshot is None:
        return app.run_window(chosen, recording, frame, preset, fresh=fresh, truth=truth)
    app.screenshot(chosen, recording, frame or 0, screenshot, preset, truth=truth)
    click.echo(f"wrote {screenshot}")
    return 0


def _open_saved(saved: Path, scene: str | None, *, fresh: bool) -> int:
    """The window as it was when somebody saved a session."""
    from bubbleviz.sensor import load_sensor
    from bubbleviz_ui.app import run_window
    from bubbleviz_ui.model.scene_presets import load_scene

    preset = None if scene is None else load_scene(scene)
    return run_window(load_sensor(SYNTHETIC_SENSOR), scene=preset, fresh=fresh, saved=saved)


def _open_live(
    source: str | None,
    session: str | None,
    sensor: str | None,
    scene: str | None,
    *,
    fresh: bool,
) -> int:
    """The window on live sensors."""
    from bubbleviz.live.session_preset import load_session
    from bubbleviz.sensor import load_sensor
    from bubbleviz_ui.app import run_window
    from bubbleviz_ui.live.connection import single
    from bubbleviz_ui.model.scene_presets import load_scene

    if session is not None and sensor is not None:
        raise click.UsageError("the sensors are named in the session file; leave --sensor out")
    name = sensor or SYNTHETIC_SENSOR
    live = single(source, name) if source is not None else load_session(session or "")
    preset = None if scene is None else load_scene(scene)
    return run_window(
        load_sensor(live.sensors[0].sensor), None, None, preset, fresh=fresh, live=live
    )


# -- recordings: info, simulate -----------------------------------------------------------------


@main.command()
@click.argument("recording", metavar="REC", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print JSON, SI units.")
def info(recording: Path, as_json: bool) -> None:
    """Show topics, frames, rate, duration, size and gaps of a recording."""
    from bubbleviz.commands.info import recording_info

    facts = recording_info(recording)
    click.echo(facts.to_json() if as_json else facts.to_text())


@main.command()
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
    where = path_file or pose
    if where is None:
        raise click.UsageError("give --pose, or --path for a pose in every frame")
    if noise_sigma and noise_relative:
        raise click.UsageError("give either --noise-sigma or --noise-relative")
    from bubbleviz.commands.simulate import simulated_press, write_simulation
    from bubbleviz.simulation.depth_noise import DepthNoise

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
    from bubbleviz.commands.pose import pose_recording

    summary = pose_recording(
        recording, sensor, object_name, out, init=init, unit=unit, solver=solver, frames=frames
    )
    click.echo(summary.to_json() if as_json else summary.to_text())


# -- commands that live beside what they do ------------------------------------

for command in (batch, bench, export, identify, publish, record, study, watch):
    main.add_command(command)
