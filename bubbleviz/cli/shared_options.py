"""Options that several commands have."""

from __future__ import annotations

import click

solver_option = click.option(
    "--solver",
    help="rubber: the exact membrane, default where the sensor has a prestretch; linear, and the "
    "paper's osqp and clarabel: constant tension; fast: linear on a coarse mesh.",
)
