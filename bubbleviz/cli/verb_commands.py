"""Commands, one for each function of `bubbleviz.api`; their options are its parameters."""

from __future__ import annotations

from contextlib import ExitStack
from math import radians
from pathlib import Path
from typing import Any

import click

import bubbleviz as bv
from bubbleviz.cli.binding import PATH, Bar, Verb, report, run, run_on_frames

_OUT, _REC = ("out",), ("depth_topic", "frames")  # arguments of Verb that several commands share
_ZERO = {"--zero/--no-zero": "zero_gas"}
_CREDENTIALS = tuple(
    click.Option([f"--{name}"], metavar="FILE", help=text)
    for name, text in {
        "ca": "Certificate of the authority that signed the peer's certificate, for tls/HOST:PORT.",
        "cert": "Certificate of this computer, for tls/HOST:PORT.",
        "key": "Private key of --cert.",
        "login": "File with lines user:password. With --listen all of them may connect; with "
        "--connect the first is used to log in.",
    }.items()
)


def _simulate(
    *,
    sensor: str,
    object: str,
    pose: str | None,
    path: Path | None,
    out: Path,
    truth: Path | None,
    overwrite: bool,
    drag_mm: float,
    twist_deg: float,
    as_json: bool,
    **options: Any,
) -> None:
    poses = path or pose
    if poses is None:
        raise click.UsageError("give --pose, or --path for a pose in every frame")
    options["drag_m"] += 1e-3 * drag_mm
    options["twist_rad"] += radians(twist_deg)
    press = bv.simulate(sensor, object, poses, **options)
    with Bar() as bar:
        written = press.save(out, truth, overwrite=overwrite, progress=bar)
    report(written, as_json=as_json)


def _identify(*, levels: Any, vented: Any, **options: Any) -> None:
    with ExitStack() as files:
        if topic := options["depth_topic"]:  # else they are opened one at a time
            levels = [files.enter_context(bv.open(each, depth_topic=topic)) for each in levels]
            vented = vented and files.enter_context(bv.open(vented, depth_topic=topic))
        run_on_frames("identify", levels=levels, vented=vented, **options)


def _batch(**options: Any) -> None:
    run("batch", **options).raise_failures()


VERBS = {
    "info": Verb("info", {"recording": "REC"}),
    "presets": Verb("presets"),
    "doctor": Verb("doctor"),
    "simulate": Verb(
        "simulate",
        call=_simulate,
        without=("pose",),
        extra=(
            click.Option(
                ["--pose"],
                help='Pose T_B_O of the object, "x y z qx qy qz qw" (m, unit quaternion).',
            ),
            click.Option(
                ["--path"],
                type=PATH,
                help="CSV with a pose for each frame (columns x_m,y_m,z_m,qx,qy,qz,qw), "
                "instead of --pose.",
            ),
            click.Option(["--drag", "drag_mm"], type=float, default=0.0, hidden=True),
            click.Option(["--twist", "twist_deg"], type=float, default=0.0, hidden=True),
            click.Option(["--out"], type=PATH, required=True, help="Recording, REC.mcap."),
            click.Option(["--truth"], type=PATH, help="Ground truth, TRUTH.npz."),
            click.Option(["--overwrite"], is_flag=True, help="Replace existing files."),
        ),
    ),
    "estimate": Verb("estimate", opening=_REC, required=_OUT, former=_ZERO),
    "pose": Verb("track", opening=_REC, required=_OUT),
    "export": Verb("export", opening=_REC),
    "convert": Verb(
        "convert", {"source": "IN", "out": "OUT.mcap"}, former={"--pressure": "gas_pressure"}
    ),
    "identify": Verb(
        "identify",
        opening=("depth_topic",),
        required=_OUT,
        former={"--press/--no-press": "held_press"},
        call=_identify,
    ),
    "check": Verb("check", opening=("depth_topic",)),
    "validate": Verb("validate", opening=("depth_topic",)),
    "compare": Verb("compare", {"first": "A", "other": "B"}),
    "batch": Verb(
        "batch",
        {"folder": "FOLDER"},
        more={"estimate": ("kappa", "solver", "friction", "zero_gas"), "open": _REC},
        call=_batch,
    ),
    "record": Verb("record"),
    "watch": Verb(
        "watch",
        former={**_ZERO, "--publish": "listen", "--publish-to": "connect"},
        extra=_CREDENTIALS,
    ),
    "publish": Verb("publish", extra=_CREDENTIALS),
}
