"""README and pages: their blocks run, their commands exist, their links lead somewhere."""

from __future__ import annotations

import os
import shlex
from pathlib import Path

import click
import pytest
from click.testing import CliRunner
from pages import KINDS, PAGES, REPOSITORY, blocks, commands, local_links

from bubbleviz.cli.command_line import main

QUICK = {"README.md", "extend.md", "first-press.md", "robot.md"}
"""Pages whose blocks run in `make test`; `make pages` runs all of them."""
REAL = REPOSITORY.parent / "shared" / "data" / "punyo_press_a"


def running() -> list[Path]:
    return [page for page in PAGES if {"python", "sh"} & {block.kind for block in blocks(page)}]


def name_of(page: Path) -> str:
    return page.relative_to(REPOSITORY).as_posix()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A new folder to work in, beside the data that this machine has."""
    work = tmp_path / "work"
    work.mkdir()
    if REAL.is_dir():
        (tmp_path / "shared" / "data").mkdir(parents=True)
        (tmp_path / "shared" / "data" / REAL.name).symlink_to(REAL)
    monkeypatch.chdir(work)
    monkeypatch.setenv("MPLBACKEND", "agg")
    return work


@pytest.mark.parametrize("page", running(), ids=name_of)
def test_blocks_of_a_page_run(page: Path, folder: Path) -> None:
    if page.name not in QUICK and "ALL_PAGES" not in os.environ:
        pytest.skip("takes long; make pages runs it")
    if page.name == "real-press.md" and not REAL.is_dir():
        pytest.skip("the real recording punyo_press_a is not on this machine")
    names: dict[str, object] = {"__name__": "page"}
    for block in blocks(page):
        if block.kind == "python":
            place = f"{name_of(page)}:{block.line}"
            exec(compile("\n" * block.line + block.text, place, "exec"), names)
        elif block.kind == "sh":
            run_commands(block.text)


def run_commands(text: str) -> None:
    """Run the lines of a block, each a command of ours."""
    for line in text.replace("\\\n", " ").splitlines():
        program, *words = shlex.split(line, comments=True) or ["", ""]
        if program and (REAL.is_dir() or REAL.name not in line):
            assert program == "bubbleviz", line
            done = CliRunner().invoke(main, words, catch_exceptions=False)
            assert done.exit_code == 0, f"{line}\n{done.output}"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_command_exists_with_its_options(page: Path) -> None:
    for line, words in commands(page):
        try:
            parse(main, words)
        except click.UsageError as error:
            pytest.fail(f"{name_of(page)}:{line}: {' '.join(words)}: {error.format_message()}")


def parse(command: click.Command, words: list[str], parent: click.Context | None = None) -> None:
    """Parse a command line without running it; UsageError where it is wrong."""
    if isinstance(command, click.Group) and words and not words[0].startswith("-"):
        context = click.Context(command, parent=parent, info_name=command.name)
        _, sub, rest = command.resolve_command(context, words)
        assert sub is not None  # else a UsageError
        parse(sub, rest, context)
    else:
        command.make_context(command.name, list(words), parent=parent)


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_block_says_what_it_is(page: Path) -> None:
    assert not [f"{name_of(page)}:{b.line}" for b in blocks(page) if b.kind not in KINDS]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_link_leads_to_a_file(page: Path) -> None:
    assert not [link for link in local_links(page) if not (page.parent / link).exists()]
