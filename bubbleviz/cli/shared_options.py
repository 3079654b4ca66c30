"""What several commands have: options, a progress bar, and how they end; heavy imports inside."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from bubbleviz.files import MOST_COLOUR_DELAY_S
from bubbleviz.wording import encodable

if TYPE_CHECKING:
    from bubbleviz.api.summary import Summary

_F = TypeVar("_F", bound=Callable[..., Any])
PATH = click.Path(path_type=Path)
former = partial(click.option, hidden=True)
"""A name that an option had: the parameter, type and default of the present one, and no help."""

sensor_option = click.option(
    "--sensor", default="auto", help="Sensor file, preset, or auto (default): the one that fits."
)
solver_option = click.option(
    "--solver",
    help="rubber: the exact membrane, default where the sensor has a prestretch; linear, and "
    "paper, the paper's QP by OSQP: constant tension; rubber-base, linear-base: without the finer "
    "mesh at the contact; fast: linear on a coarse mesh.",
)
friction_option = click.option(
    "--friction",
    metavar="MU",
    type=click.FloatRange(0.0),
    help="Coefficient of friction to expect, 1 by default; 0: contacts have none. With --shear "
    "it also bounds the shear.",
)
kappa_option = click.option(
    "--kappa", type=float, help="Patch threshold over the mean contact pressure."
)
frames_option = click.option("--frames", help="A:B[:STEP], B left out; all by default.")
zero_gas_option = click.option(
    "--zero-gas/--no-zero-gas",
    default=True,
    help="Zero the gas pressure on contact-free frames (default), or believe it as it is.",
)
shear_option = click.option(
    "--shear", is_flag=True, help="Friction and slip, too, from the colour images."
)
colour_delay_option = click.option(
    "--colour-delay",
    "colour_delay_s",
    metavar="S",
    type=click.FloatRange(-MOST_COLOUR_DELAY_S, MOST_COLOUR_DELAY_S),
    help="Stamp of a colour image minus that of the depth image of the same moment, s: negative "
    "where colour leads depth. The sensor file's by default, else 0.",
)
source_option = click.option(
    "--source", required=True, help="synthetic:, replay:REC, zenoh:, realsense:"
)
duration_option = click.option(
    "--duration",
    "duration_s",
    type=click.FloatRange(0.0, min_open=True),
    help="Seconds; or until ^C.",
)
overwrite_option = click.option("--overwrite", is_flag=True, help="Replace files that exist.")
json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print JSON, SI units, times in ms."
)


def out_option(says: str, *, required: bool = True) -> Callable[[_F], _F]:
    """Where a command writes, and whether over what is there."""

    def both(function: _F) -> _F:
        return click.option("--out", required=required, type=PATH, help=says)(
            overwrite_option(function)
        )

    return both


def publish_options(command: _F) -> _F:
    """Where to publish over Zenoh, and the files of its `Credentials`."""
    for name, metavar, says in (
        ("login", "FILE", "File with user:password, to be let in by or to let in."),
        ("key", "FILE", "Private key of --cert."),
        ("cert", "FILE", "Own certificate, for tls/HOST:PORT."),
        ("ca", "FILE", "Certificate of the authority of the other side's, for tls/HOST:PORT."),
        ("connect", "ENDPOINT", "Publish through this router."),
        ("listen", "ENDPOINT", "Publish here, where subscribers connect: tcp/127.0.0.1:7448"),
    ):
        command = click.option(f"--{name}", metavar=metavar, help=says)(command)
    return command


def check_new(*paths: Path | None, overwrite: bool) -> None:
    """Refuse what could not be written, before anything is opened."""
    from bubbleviz.files import refuse_existing

    for path in filter(None, paths):
        refuse_existing(path, overwrite=overwrite)


def report(done: Summary, *, as_json: bool) -> None:
    """Print a summary and, on standard error, what it warns of."""
    click.echo(encodable(done.to_json() if as_json else done.to_text()))
    warning = getattr(done, "warning", None)
    if warning:
        click.echo(f"bubbleviz: warning: {warning}", err=True)


class Bar:
    def __enter__(self) -> Bar:
        from tqdm import tqdm

        self._bar = tqdm(total=100, unit="%", leave=False, disable=None)
        self._step = ""
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    def __call__(self, step: str, done: float) -> None:
        if self._step != step:
            self._step = step
            self._bar.reset()
            self._bar.set_description(step)
        self._bar.update(100.0 * done - self._bar.n)
