"""Commands that open the window; heavy imports are inside the functions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from bubbleviz.files import MAX_COLOUR_DELAY_S, SESSION_SUFFIX, SYNTHETIC_SENSOR, preset_names

_fresh = click.option(
    "--fresh", is_flag=True, help="Neither restore the last session nor save this one."
)


@click.command(hidden=True)
@_fresh
def window(fresh: bool) -> int:
    """Open the window with the last session, the first time with a synthetic live sensor."""
    from bubbleviz_ui.startup_imports import import_the_backend

    import_the_backend()
    from bubbleviz.sensor import load_sensor

    return _show(None, fresh=fresh, sensor=load_sensor(SYNTHETIC_SENSOR))


@click.command("open")
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
    help="TRUTH.npz of a simulated REC; by default the one next to it with the same name.",
)
@click.option("--depth-topic", help="Topic of the depth images; by default the first.")
@click.option(
    "--colour-delay",
    "colour_delay_s",
    type=click.FloatRange(-MAX_COLOUR_DELAY_S, MAX_COLOUR_DELAY_S),
    help="Stamp of a colour image minus that of the depth image of the same scene, s; negative "
    "if colour leads depth. By default the sensor file's, else 0.",
)
@click.option(
    "--frame", type=click.IntRange(0), help="Show this frame, counted from 0, and do not play."
)
@click.option(
    "--screenshot",
    type=click.Path(path_type=Path),
    help="Write a PNG picture of the window and exit.",
)
@click.option("--overwrite", is_flag=True, help="Replace existing files.")
@_fresh
def open_recording(
    recording: Path | None,
    source: str | None,
    session: str | None,
    sensor: str | None,
    scene: str | None,
    truth: Path | None,
    depth_topic: str | None,
    colour_delay_s: float | None,
    frame: int | None,
    screenshot: Path | None,
    overwrite: bool,
    fresh: bool,
) -> int:
    """Show a recording, a saved session or a live source in the window."""
    if sum(given is not None for given in (recording, source, session)) != 1:
        raise click.UsageError("give exactly one of REC (or X.bubbleviz), --source and --session")
    if recording is None:
        if any(given is not None for given in (truth, depth_topic, frame, screenshot)):
            raise click.UsageError(
                "--truth, --depth-topic, --frame and --screenshot need a recording; leave them "
                "out, or give REC in place of --source or --session"
            )
        return _open_live(source, session, sensor, scene, colour_delay_s, fresh=fresh)
    if recording.suffix.lower() == SESSION_SUFFIX:
        of_recording = sensor, truth, depth_topic, colour_delay_s, frame, screenshot
        if any(given is not None for given in of_recording):
            raise click.UsageError(
                "a saved session takes no --sensor, --truth, --depth-topic, --colour-delay, "
                "--frame or --screenshot; leave them out"
            )
        from bubbleviz.sensor import load_sensor

        return _show(scene, fresh=fresh, sensor=load_sensor(SYNTHETIC_SENSOR), saved=recording)
    from bubbleviz_ui.startup_imports import import_the_backend

    import_the_backend()
    from bubbleviz.recordings import AUTO, checked_sensor
    from bubbleviz.sensor import with_colour_delay
    from bubbleviz_ui.model.scene_presets import load_scene

    if screenshot is not None:
        from bubbleviz.files import refuse_existing

        refuse_existing(screenshot, ".png", overwrite=overwrite)
    preset = None if scene is None else load_scene(scene)
    name, chosen = checked_sensor(recording, sensor, depth_topic)
    chosen = with_colour_delay(chosen, colour_delay_s)
    from bubbleviz_ui import app
    from bubbleviz_ui.window_session import Startup

    startup = Startup(chosen, recording, frame, preset, truth=truth, depth_topic=depth_topic)
    if screenshot is not None:
        app.screenshot(replace(startup, frame=frame or 0), screenshot, overwrite=overwrite)
    if sensor in (None, AUTO):
        click.echo(f"sensor: preset {name}, whose camera has the image size of {recording}")
    if screenshot is None:
        return app.run_window(startup, fresh=fresh)
    click.echo(f"wrote {screenshot}")
    return 0


def _show(scene: str | None, *, fresh: bool, **first: Any) -> int:
    """Open the window; `first`: fields of `Startup`."""
    from bubbleviz_ui.app import run_window
    from bubbleviz_ui.model.scene_presets import load_scene
    from bubbleviz_ui.window_session import Startup

    preset = None if scene is None else load_scene(scene)
    return run_window(Startup(scene=preset, **first), fresh=fresh)


def _open_live(
    source: str | None,
    session: str | None,
    sensor: str | None,
    scene: str | None,
    colour_delay_s: float | None,
    *,
    fresh: bool,
) -> int:
    """Open the window with live sensors."""
    from bubbleviz.live import load_session
    from bubbleviz.recordings import AUTO
    from bubbleviz.sensor import load_sensor
    from bubbleviz_ui.live.connection import single

    if session is not None and sensor is not None:
        raise click.UsageError("--session names the sensor files; leave --sensor out")
    if session is not None and colour_delay_s is not None:
        raise click.UsageError(
            "each sensor of a session has its own colour delay; set colour_delay_s in the session "
            "file instead of --colour-delay"
        )
    if source is not None:
        live = single(source, sensor or AUTO, colour_delay_s)
    else:
        live = load_session(session or "")
    name = live.sensors[0].sensor  # a missing file is reported before the window opens
    first = load_sensor(SYNTHETIC_SENSOR if name == AUTO else name)
    return _show(scene, fresh=fresh, sensor=first, live=live)
