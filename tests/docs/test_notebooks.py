"""The tutorials as notebooks, run in a Jupyter kernel."""

import os
import sys
from pathlib import Path

import pytest
from nbclient import NotebookClient
from nbformat.v4 import new_code_cell
from notebooks import TUTORIALS, notebook
from pages import name_of


@pytest.fixture
def programs(monkeypatch):
    """As in an environment that is activated, with the kernel's own pictures."""
    monkeypatch.delenv("MPLBACKEND")
    folders = [str(Path(sys.executable).parent), os.environ["PATH"]]
    monkeypatch.setenv("PATH", os.pathsep.join(folders))


@pytest.mark.long  # in short: other pages, in test_pages.py
@pytest.mark.usefixtures("folder", "programs")
@pytest.mark.parametrize("page", TUTORIALS, ids=name_of)
def test_a_tutorial_runs_as_a_notebook(page, request):
    if page.name == "real-press.md":
        request.getfixturevalue("punyo_press")  # else skipped
    book = notebook(page)
    book.cells = [each for cell in book.cells for each in checked(cell)]
    NotebookClient(book, timeout=None).execute()
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
