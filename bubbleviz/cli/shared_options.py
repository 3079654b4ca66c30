"""What several commands have: options, and how they end."""

from __future__ import annotations

import click

from bubbleviz.commands.summary import Summary
from bubbleviz.files.defaults import MOST_COLOUR_DELAY_S

solver_option = click.option(
    "--solver",
    help="rubber: the exact membrane, default where the sensor has a prestretch; linear, and "
    "paper, the paper's QP by OSQP: constant tension; rubber-base, linear-base: without the finer "
    "mesh at the contact; fast: linear on a coarse mesh.",
)
colour_delay_option = click.option(
    "--colour-delay",
    "colour_delay_s",
    metavar="S",
    type=click.FloatRange(-MOST_COLOUR_DELAY_S, MOST_COLOUR_DELAY_S),
    help="Stamp of a colour image minus that of the depth image of the same moment, s: negative "
    "where colour leads depth. The sensor file's by default, else 0.",
)

friction_option = click.option(
    "--friction",
    metavar="MU",
    type=click.FloatRange(0.0),
    help="Coefficient of friction to expect, 1 by default; 0: contacts have none. With --shear "
    "it also bounds the shear.",
)


def report(summary: Summary, warning: str | None, *, as_json: bool) -> None:
    """Print a summary and, on standard error, what it warns of."""
    click.echo(summary.to_json() if as_json else summary.to_text())
    if warning:
        click.echo(f"bubbleviz: warning: {warning}", err=True)
