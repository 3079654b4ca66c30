"""The command line: one thin function per command; imports nothing heavy until it is needed."""

from __future__ import annotations

import click

import bubbleviz


@click.group(invoke_without_command=True)
@click.version_option(bubbleviz.__version__)
@click.pass_context
def main(context: click.Context) -> None:
    """Calibrate, watch and debug Soft-bubble tactile sensors."""
