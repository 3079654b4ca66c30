"""The tutorials as notebooks, run in a Jupyter kernel."""

import os
import shlex
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from nbclient import NotebookClient
from nbformat.v4 import new_code_cell
from notebooks import TUTORIALS, notebook
from pages import name_of

from bubbleviz.cli.command_line import main

QUICK = ("first-press.md",)
"""Where one begins: `make test` runs it too."""


@pytest.fixture
def programs(monkeypatch):
    """As in an environment that is activated, with the kernel's own pictures."""
    monkeypatch.delenv("MPLBACKEND")
    folders = [str(Path(sys.executable).parent), os.environ["PATH"]]
    monkeypatch.setenv("PATH", os.pathsep.join(folders))


@pytest.mark.usefixtures("folder", "programs")
@pytest.mark.parametrize(
    "page",
    [pytest.param(p, marks=() if p.name in QUICK else pytest.mark.long) for p in TUTORIALS],
    ids=name_of,
)
def test_a_tutorial_runs_as_a_notebook(page, request):
    if page.name == "real-press.md":
        request.getfixturevalue("punyo_press")  # else skipped
    book, quick = notebook(page), "TEST_ALL" not in os.environ
    commands = [cell for cell in book.cells if cell.source.startswith("!")]
    if quick:  # a process each is left out; they run below
        book.cells = [cell for cell in book.cells if cell not in commands]
    book.cells = [each for cell in book.cells for each in checked(cell)]
    NotebookClient(book, timeout=None).execute()
    for command in commands if quick else ():
        _, *words = shlex.split(command.source)
        done = CliRunner().invoke(main, words, catch_exceptions=False)
        assert done.exit_code == 0, done.output
    for cell in book.cells:
        outputs = cell.get("outputs", [])
        assert not [each.text for each in outputs if each.get("name") == "stderr"], cell.source
        pictures = [each for each in outputs if "image/png" in each.get("data", {})]
        assert len(pictures) == (".plot(" in cell.source), cell.source


def checked(cell):
    """A cell, and another that fails where its command failed: Jupyter would go on."""
    if not cell.source.startswith("!"):
        return [cell]
    return [cell, new_code_cell("assert _exit_code == 0")]
