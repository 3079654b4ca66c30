"""Options, progress bar and output shared by several commands; imports inside functions."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

import bubbleviz as bv
from bubbleviz.files import MAX_COLOUR_DELAY_S
from bubbleviz.wording import encodable

if TYPE_CHECKING:
    from bubbleviz.api.summary import Summary

_F = TypeVar("_F", bound=Callable[..., Any])


class _Path(click.Path):
    """A path that is not empty: `Path("")`, as of an unset variable, is the current folder."""

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if value == "":
            self.fail("the path is empty; give one", param, ctx)
        return super().convert(value, param, ctx)


PATH = _Path(path_type=Path)
hidden_alias = partial(click.option, hidden=True)
"""Hidden old name of an option; give parameter, type and default of the present one."""

sensor_option = click.option(
    "--sensor",
    default="auto",
    help="Sensor file or preset; auto (default): the preset whose camera has the images' size.",
)
solver_option = click.option(
    "--solver",
    help="rubber: exact membrane (default if the sensor file has a prestretch); linear: constant "
    "tension (default otherwise); fast: linear on a coarse mesh; paper: the paper's QP by OSQP; "
    "rubber-base, linear-base: without the finer mesh at the contact.",
)
friction_option = click.option(
    "--friction",
    metavar="MU",
    type=click.FloatRange(0.0),
    help="Expected coefficient of friction on the exact membrane (default 1); 0: no friction.",
)
kappa_option = click.option(
    "--kappa",
    type=float,
    help="Threshold of the patch relative to the mean contact pressure; automatic by default.",
)
frames_option = click.option(
    "--frames", help="Frames A to B−1, counted from 0, as A:B or A:B:STEP; all by default."
)
depth_topic_option = click.option(
    "--depth-topic",
    metavar="TOPIC",
    help="Topic of the depth images, where REC has several; by default the first.",
)
zero_gas_option = click.option(
    "--zero-gas/--no-zero-gas",
    default=True,
    help="Shift the gas pressure so that contact-free frames have the sensor file's (default), or "
    "use it as measured.",
)
shear_option = click.option(
    "--shear",
    is_flag=True,
    help="Force by depth and colour images together, with friction at every node, and slip.",
)
colour_delay_option = click.option(
    "--colour-delay",
    "colour_delay_s",
    metavar="S",
    type=click.FloatRange(-MAX_COLOUR_DELAY_S, MAX_COLOUR_DELAY_S),
    help="Stamp of a colour image minus that of the depth image of the same scene, s; negative "
    "if colour leads depth. By default the sensor file's, else 0.",
)
source_option = click.option(
    "--source",
    required=True,
    help="Live source: zenoh:[tcp/HOST:PORT], realsense:[SERIAL], replay:REC or synthetic:.",
)
duration_option = click.option(
    "--duration",
    "duration_s",
    type=click.FloatRange(0.0, min_open=True),
    help="Duration from the first message on, s; by default until ^C or the end of the source.",
)
overwrite_option = click.option("--overwrite", is_flag=True, help="Replace existing files.")
json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print JSON: SI units, times in ms."
)


def out_option(text: str, *, required: bool = True) -> Callable[[_F], _F]:
    """Options --out and --overwrite."""

    def both(function: _F) -> _F:
        return click.option("--out", required=required, type=PATH, help=text)(
            overwrite_option(function)
        )

    return both


def publish_options(command: _F) -> _F:
    """Options for publishing over Zenoh, with the files of its `Credentials`."""
    for name, metavar, text in (
        (
            "login",
            "FILE",
            "File with lines user:password: the accounts that may connect (--listen), or first "
            "the one to log in with (--connect).",
        ),
        ("key", "FILE", "Private key of --cert."),
        ("cert", "FILE", "Own certificate, for tls/HOST:PORT."),
        (
            "ca",
            "FILE",
            "Certificate of the authority that signed the peer's certificate, for tls/HOST:PORT.",
        ),
        ("connect", "ENDPOINT", "Publish through this router, such as tcp/HOST:7447."),
        (
            "listen",
            "ENDPOINT",
            "Publish here for subscribers that connect, such as tcp/127.0.0.1:7448.",
        ),
    ):
        command = click.option(f"--{name}", metavar=metavar, help=text)(command)
    return command


def run(verb: str, *arguments: Any, as_json: bool, **options: Any) -> Any:
    """Call a function of the library with a progress bar, and print its result."""
    with Bar() as bar:
        result = getattr(bv, verb)(*arguments, progress=bar, **options)
    report(result, as_json=as_json)
    return result


def run_on_frames(
    verb: str,
    recording: Path,
    frames: str | None = None,
    depth_topic: str | None = None,
    wrench: str | None = None,
    **options: Any,
) -> None:
    """Call a function with frames of a recording, after a check for existing outputs."""
    from bubbleviz.files import refuse_existing

    for path in filter(None, (options.get("out"), options.get("csv"))):
        refuse_existing(path, overwrite=options["overwrite"])
    with bv.open(recording, frames, depth_topic=depth_topic, wrench_topic=wrench) as chosen:
        run(verb, chosen, **options)


def report(result: Summary, *, as_json: bool) -> None:
    """Print a summary, and its warning on standard error."""
    click.echo(encodable(result.to_json() if as_json else result.to_text()))
    warning = getattr(result, "warning", None)
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
