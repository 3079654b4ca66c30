"""What several commands have: options, and how they end."""

from __future__ import annotations

import click

from bubbleviz.commands.summary import Summary

solver_option = click.option(
    "--solver",
    help="rubber: the exact membrane, default where the sensor has a prestretch; linear, and the "
    "paper's osqp and clarabel: constant tension; rubber-base, linear-base: without the finer "
    "mesh at the contact; fast: linear on a coarse mesh.",
)


def report(summary: Summary, warning: str | None, *, as_json: bool) -> None:
    """Print a summary and, on standard error, what it warns of."""
    click.echo(summary.to_json() if as_json else summary.to_text())
    if warning:
        click.echo(f"bubbleviz: warning: {warning}", err=True)
