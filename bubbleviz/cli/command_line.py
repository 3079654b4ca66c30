"""Command line: commands loaded on demand, errors printed on one line."""

from __future__ import annotations

import errno
import logging
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import entry_points
from typing import Any, NoReturn

import click

import bubbleviz
from bubbleviz.cli.study_commands import study
from bubbleviz.cli.verb_commands import VERBS
from bubbleviz.errors import InputError, SolveError
from bubbleviz.wording import encodable, how_to_install

WINDOW_GROUP = "bubbleviz.commands"
"""Entry points of the window's commands."""
WINDOW_COMMANDS = ("open", "window")
ALIASES = {"track": "pose"}
"""Names of Python functions as aliases of commands."""
WINDOW_LIBRARIES = ("PySide6", "pyqtgraph", "pyvista", "pyvistaqt", "vtkmodules")
NOT_INSTALLED = f"is not installed; run {how_to_install('window')}"

# The solver's matrices are small, so synchronising BLAS threads costs more than they save.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# No messages about Matplotlib's font cache and folders.
logging.getLogger("matplotlib").setLevel(logging.ERROR)


class OneLineErrors(click.Group):
    """A command group whose errors are one line on stderr.

    Exit code 2 for wrong usage and bad input, 1 for a problem without solution, 130 for ^C.
    """

    def main(  # type: ignore[override]
        self, args: Sequence[str] | None = None, standalone_mode: bool = True, **extra: Any
    ) -> Any:
        """As `click.Group.main`, with errors on one line."""
        if not standalone_mode:
            return super().main(args, standalone_mode=False, **extra)
        try:
            with _clean_exit_on_sigterm():
                code = super().main(args, standalone_mode=False, **extra)
        except InputError as error:
            _fail(str(error), 2)
        except SolveError as error:
            _fail(str(error), 1)
        except OSError as error:
            if error.errno != errno.ENOSPC:
                raise
            # what stdout still holds would fail again at the end of the program
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            _fail("output cannot be written, the disk is full; free some space", 2)
        except ModuleNotFoundError as error:
            library = (error.name or "").split(".")[0]
            if library not in WINDOW_LIBRARIES:
                raise
            _fail(f"{library}, which the window and VTK meshes need, {NOT_INSTALLED}", 2)
        except click.UsageError as error:
            command = error.ctx.command_path if error.ctx else "bubbleviz"
            _fail(f"{_usage_problem(error)}; see {command} --help", 2)
        except click.ClickException as error:
            _fail(error.format_message(), error.exit_code)
        except click.Abort:
            _fail("stopped", 130)
        except ImportError as error:
            if "shared object file" not in str(error):
                raise
            library = str(error).partition(":")[0]
            _fail(
                f"the system library {library} is not installed; install its package, which make "
                "setup names in a checkout",
                1,
            )
        sys.exit(code if isinstance(code, int) else 0)


@contextmanager
def _clean_exit_on_sigterm() -> Iterator[None]:
    """Make SIGTERM raise SystemExit, as ^C does, so that unfinished files are removed."""
    terminated, leaving = False, SystemExit(128 + signal.SIGTERM)

    def end(*_: object) -> None:
        nonlocal terminated
        terminated = True
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # `timeout` and systemd may send it twice
        if hasattr(signal, "setitimer"):  # not on Windows
            signal.signal(signal.SIGALRM, end)
            signal.setitimer(signal.ITIMER_REAL, 1.0)
        handled = sys.exc_info()[1]
        while handled is not None and handled is not leaving:
            handled = handled.__context__
        if handled is None:  # the first time, or a library has caught it, as trimesh does
            raise leaving

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    except BaseException:
        if terminated:  # exit at once: a half-loaded library may change the exit code
            sys.stdout.flush()
            os._exit(128 + signal.SIGTERM)
        raise
    finally:
        signal.signal(signal.SIGTERM, before)


def _usage_problem(error: click.UsageError) -> str:
    """The problem; for a group without a command click would give its full help."""
    if isinstance(error, getattr(click.exceptions, "NoArgsIsHelpError", ())):
        return "Missing command"
    return error.format_message().rstrip(".")


def _fail(message: str, code: int) -> NoReturn:
    click.echo(f"bubbleviz: {encodable(' '.join(message.split()))}", err=True)
    sys.exit(code)


class AllCommands(OneLineErrors):
    """Commands of the backend, and commands of the window, which are imported on use."""

    def list_commands(self, context: click.Context) -> list[str]:
        return sorted({*self.commands, *VERBS, *entry_points(group=WINDOW_GROUP).names})

    def get_command(self, context: click.Context, name: str) -> click.Command | None:
        """Load a command; None if it does not exist.

        Raises InputError: it is a command of the window, which is not installed.
        """
        name = ALIASES.get(name, name)
        if name in VERBS and name not in self.commands:
            self.add_command(VERBS[name].command(name))
        if name in self.commands:
            return self.commands[name]
        for entry in entry_points(group=WINDOW_GROUP, name=name):
            command: click.Command = entry.load()
            return command
        if name in WINDOW_COMMANDS:
            raise InputError(f"the window {NOT_INSTALLED}")
        return None


@click.group(
    cls=AllCommands,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(bubbleviz.__version__)
@click.option(
    "--fresh",
    is_flag=True,
    help="Open the window; neither restore its last session nor save this one.",
)
@click.pass_context
def main(context: click.Context, fresh: bool) -> Any:
    """Calibrate, watch and debug Soft-bubble tactile sensors.

    Without a command the window opens with its last session, at first with a simulated sensor.
    """
    if context.invoked_subcommand is not None:
        context.default_map = {"open": {"fresh": fresh}}
        return 0
    window = main.get_command(context, "window")
    assert window is not None  # else an InputError
    return context.invoke(window, fresh=fresh)


main.add_command(study)
