"""The commands record, watch and publish: one thin function each, heavy imports inside."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from bubbleviz.cli.shared_options import colour_delay_option, friction_option, report, solver_option
from bubbleviz.files.defaults import SYNTHETIC_SENSOR


def _credentials_options(command: Any) -> Any:
    """The options of `Credentials`."""
    for name, says in (
        ("login", "File with user:password, to be let in by or to let in."),
        ("key", "Private key of --cert."),
        ("cert", "Own certificate, for tls/HOST:PORT."),
        ("ca", "Certificate of the authority of the other side's, for tls/HOST:PORT."),
    ):
        command = click.option(f"--{name}", metavar="FILE", help=says)(command)
    return command


@click.command()
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
    from bubbleviz.commands.record import record_source
    from bubbleviz.sensor import load_sensor

    summary = record_source(source, load_sensor(sensor), out, duration)
    click.echo(summary.to_json() if as_json else summary.to_text())


@click.command()
@click.option("--source", required=True, help="synthetic:, replay:REC, zenoh:, realsense:")
@click.option("--sensor", required=True, help="Sensor file, preset, or auto: the preset that fits.")
@click.option("--publish", metavar="ENDPOINT", help="Publish results here: tcp/127.0.0.1:7448")
@click.option("--publish-to", metavar="ENDPOINT", help="Publish results through this router.")
@_credentials_options
@click.option("--out", type=click.Path(path_type=Path), help="Record messages and results.")
@click.option("--duration", type=click.FloatRange(0.0, min_open=True), help="Seconds; or until ^C.")
@solver_option
@click.option("--object", "object_name", help="Object to track: a mesh or a preset.")
@click.option("--zero/--no-zero", default=True, help="Zero the gas pressure at the start.")
@click.option("--shear", is_flag=True, help="Friction and slip, too, from the colour images.")
@friction_option
@colour_delay_option
@click.option("--json", "as_json", is_flag=True, help="Print JSON, SI units.")
def watch(source: str, sensor: str, zero: bool, as_json: bool, **choices: Any) -> None:
    """Solve a live source without a window, and publish or record the results.

    Shear is measured against the first colour images without contact: touch nothing at the start.
    """
    from bubbleviz.commands.watch import WatchOptions, watch_source
    from bubbleviz.live.sources.auto_sensor import sensor_for_source
    from bubbleviz.live.sources.open_stream import patience_s
    from bubbleviz.sensor import load_sensor, with_colour_delay

    delay_s = choices["colour_delay_s"]
    if delay_s is not None and not choices["shear"]:
        raise click.UsageError("--colour-delay is of the images that --shear takes; give it, too")
    options = WatchOptions(
        out=choices["out"],
        publish=_zenoh_place("--publish", choices["publish"], choices["publish_to"], choices),
        duration_s=choices["duration"],
        solver=choices["solver"],
        object_name=choices["object_name"],
        zero=zero,
        shear=choices["shear"],
        friction=choices["friction"],
    )
    name = sensor_for_source(source, sensor, patience_s(source))
    summary = watch_source(source, with_colour_delay(load_sensor(name), delay_s), options)
    report(summary, summary.warning, as_json=as_json)


@click.command()
@click.option("--source", required=True, help="synthetic:, replay:REC, zenoh:, realsense:")
@click.option("--listen", metavar="ENDPOINT", help="Subscribers connect here; loopback, 7447.")
@click.option("--connect", metavar="ENDPOINT", help="Publish through this router instead.")
@_credentials_options
@click.option("--layout", type=click.Choice(["rmw", "dds"]), default="rmw", help="Names of keys.")
@click.option("--domain", type=click.IntRange(0, 232), default=0, help="ROS_DOMAIN_ID.")
@click.option("--duration", type=click.FloatRange(0.0, min_open=True), help="Seconds; or until ^C.")
@click.option("--wait", is_flag=True, help="Start when somebody subscribes.")
@click.option("--sensor", default=SYNTHETIC_SENSOR, help="Sensor that synthetic: simulates.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def publish(
    source: str,
    listen: str | None,
    connect: str | None,
    layout: Any,
    domain: int,
    duration: float | None,
    wait: bool,
    sensor: str,
    as_json: bool,
    **files: str | None,
) -> None:
    """Publish a source over Zenoh, as a robot's ROS 2 nodes would."""
    from bubbleviz.commands.publish import publish_source
    from bubbleviz.sensor import load_sensor

    if listen is None and connect is None:
        listen = "tcp/127.0.0.1:7447"
    place = _zenoh_place("--listen", listen, connect, files)
    summary = publish_source(
        source,
        load_sensor(sensor),
        place,
        layout=layout,
        domain=domain,
        duration_s=duration,
        wait=wait,
    )
    click.echo(summary.to_json() if as_json else summary.to_text())


def _zenoh_place(
    option: str, listen: str | None, connect: str | None, files: Mapping[str, Any]
) -> Any:
    """Where to publish, with the files of `Credentials`; None for nowhere."""
    from bubbleviz.live.sources.zenoh_credentials import Credentials
    from bubbleviz.live.sources.zenoh_session import SessionOptions

    if listen is not None and connect is not None:
        raise click.UsageError("publish at a place or through a router, not both")
    if listen is None and connect is None:
        return None
    credentials = Credentials(files["ca"], files["cert"], files["key"], files["login"])
    return SessionOptions(f"{option} {listen or connect}", connect, listen, credentials)
