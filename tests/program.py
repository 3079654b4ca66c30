"""Commands of bubbleviz, in the process of a test, and the tables that they write."""

import csv

from click.testing import CliRunner

from bubbleviz.cli.command_line import main


def run(*words, **more):
    """A command, with words of any type: its exit code and what it wrote."""
    return CliRunner().invoke(main, [str(word) for word in words], prog_name="bubbleviz", **more)


def output_of(*words):
    """What a command wrote to stdout, which must do its work."""
    done = run(*words, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


def refusal(*words):
    """What a command wrote to stderr, which must refuse its work in one line."""
    done = run(*words)
    assert (done.exit_code, done.stdout) == (2, ""), done.output
    assert done.stderr.startswith("bubbleviz: ") and done.stderr.count("\n") == 1, done.stderr
    return done.stderr


def rows_of(path):
    """Rows of a CSV file by the names of its columns."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))
