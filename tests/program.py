"""Commands of bubbleviz in the process of a test, their tables, and code in other processes."""

import csv
import json
import subprocess
import sys
import textwrap

from click.testing import CliRunner

from bubbleviz.cli.command_line import main

MAIN = "from bubbleviz.cli.command_line import main; main()"
COMMAND = [sys.executable, "-c", MAIN]
"""The program in a process of its own."""


def run(*words, **more):
    """A command, with words of any type: its exit code and what it wrote."""
    return CliRunner().invoke(main, [str(word) for word in words], prog_name="bubbleviz", **more)


def output_of(*words):
    """What a command wrote to stdout, which must do its work."""
    done = run(*words, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


def facts_of(*words):
    """What a command told with `--json`."""
    return json.loads(output_of(*words, "--json"))


def refusal(*words):
    """What a command wrote to stderr, which must refuse its work in one line."""
    done = run(*words)
    assert (done.exit_code, done.stdout) == (2, ""), done.output
    assert done.stderr.startswith("bubbleviz: ") and done.stderr.count("\n") == 1, done.stderr
    return done.stderr


def python(code, *words):
    """What code prints in a process of its own, which must end well and say nothing else."""
    command = [sys.executable, "-c", textwrap.dedent(code), *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    return done.stdout


def start(*words, **more):
    """A command in a process of its own, while it works."""
    command = [*COMMAND, *map(str, words)]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, **more)


def rows_of(path):
    """Rows of a CSV file by the names of its columns."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))
