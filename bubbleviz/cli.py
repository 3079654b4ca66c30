"""The command line: one thin function per command; imports nothing heavy until it is needed."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

import click

import bubbleviz
from bubbleviz.errors import InputError, SolveError


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
            _fail(f"{error.format_message().rstrip('.')}; see {command} --help", 2)
        except click.ClickException as error:
            _fail(error.format_message(), error.exit_code)
        except click.Abort:
            _fail("stopped", 130)
        sys.exit(code if isinstance(code, int) else 0)


def _fail(message: str, code: int) -> NoReturn:
    click.echo(f"bubbleviz: {' '.join(message.split())}", err=True)
    sys.exit(code)


@click.group(cls=OneLineErrors, invoke_without_command=True)
@click.version_option(bubbleviz.__version__)
@click.pass_context
def main(context: click.Context) -> None:
    """Calibrate, watch and debug Soft-bubble tactile sensors.

    Without a command: the window on a live synthetic sensor.
    """


# -- the window: open ---------------------------------------------------------------------------


# -- recordings: info, simulate -----------------------------------------------------------------


@main.command()
@click.argument("recording", metavar="REC", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print JSON, SI units.")
def info(recording: Path, as_json: bool) -> None:
    """Show topics, frames, rate, duration, size and gaps of a recording."""
    from bubbleviz.frames.info import recording_info

    facts = recording_info(recording)
    click.echo(facts.to_json() if as_json else facts.to_text())


# -- the inverse problem: estimate --------------------------------------------------------------
