"""README and pages: their blocks run, their commands exist, their links lead somewhere."""

from __future__ import annotations

import os
import re
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner
from notebooks import TUTORIALS
from pages import FENCE, KINDS, NEEDS, PAGES, blocks, local_links, name_of
from small_press import write_press, write_small_sensor

from bubbleviz.cli.command_line import main
from bubbleviz_ui.bench.live_soak import free_port
from tests.frames.bagmaker import BagMaker, fill

CAPITALS = re.compile(r"\b(REC|S|FOLDER|PORT)\b")
"""What the reader puts in, in commands."""


def pages_with(*kinds: str) -> list[Path]:
    return [page for page in PAGES if blocks(page, *kinds)]


IN_PROCESS = [page for page in pages_with("python", "sh") if page not in TUTORIALS]
"""Tutorials run as notebooks."""


@pytest.mark.parametrize("page", IN_PROCESS, ids=name_of)
def test_blocks_of_a_page_run(page: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MPLBACKEND", "agg")
    names: dict[str, object] = {"__name__": "page"}
    for block in blocks(page, "python", "sh"):
        if block.kind == "python":
            place = f"{name_of(page)}:{block.line}"
            exec(compile("\n" * block.line + block.text, place, "exec"), names)
            continue
        for command in block.commands():
            data = [word for word in command.words if word.startswith("../shared/")]
            if all((folder / path).exists() for path in data):
                run(command.place, command.words)


def run(place: str, words: list[str]) -> None:
    """Run a command of ours."""
    assert words[0] == "bubbleviz", f"{place}: mark what this needs"
    done = CliRunner().invoke(main, words[1:], catch_exceptions=False)
    assert done.exit_code == 0, f"{place}: {' '.join(words)}\n{done.output}"


def made(folder: Path) -> dict[str, str]:
    """Make what the commands of the pages are given; what stands for the words in capitals."""
    sensor = write_small_sensor(folder / "small.toml")
    write_press(folder / "press0.mcap", sensor, (*[0.060] * 24, *[0.044] * 6))
    for name in ("day", "images"):
        (folder / name).mkdir()
    write_press(folder / "day" / "a.mcap", sensor)
    for k in range(3):
        np.save(folder / "images" / f"{k}.npy", np.full((43, 56), 0.1))
    tables = {"times": "0.1\n0.2\n0.3\n", "gas": "0,104000\n", "wrench": "0,1,2,3,4,5,6\n"}
    for name, text in tables.items():
        (folder / f"{name}.csv").write_text(text)
    fill(BagMaker("bag lz4")).write(folder, "old")
    return {"REC": "press0.mcap", "S": "small.toml", "FOLDER": "day"}


@pytest.mark.parametrize("page", pages_with("console"), ids=name_of)
def test_commands_of_a_page_run(page: Path, folder: Path) -> None:
    """Each on files of its own; those are left out whose page says that they need more."""
    commands = [command for block in blocks(page, "console") for command in block.commands()]
    wanted = {None, "takes minutes"} if "ALL_PAGES" in os.environ else {None}
    chosen = [command for command in commands if command.needs in wanted]
    if not chosen:
        left = {command.needs for command in commands if command.needs}
        pytest.skip("; ".join(f"{need}: {NEEDS[need]}" for need in sorted(left)))
    given = made(folder)
    for command in chosen:
        given["PORT"] = str(free_port())
        run(command.place, [CAPITALS.sub(lambda m: given[m[0]], word) for word in command.words])


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_command_exists_with_its_options(page: Path) -> None:
    for command in (c for block in blocks(page, "sh", "console") for c in block.commands()):
        program, *words = command.words
        if Path(program).name != "bubbleviz":
            assert command.needs, f"{command.place}: only commands of ours run"
            continue
        try:
            parse(main, words)
        except click.UsageError as error:
            pytest.fail(f"{command.place}: {' '.join(words)}: {error.format_message()}")


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
def test_code_is_in_blocks(page: Path) -> None:
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    assert not re.findall(r"\n\n {4}(?!- |\d)\S.*", text), "indented code is not run"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_link_leads_to_a_file(page: Path) -> None:
    assert not [link for link in local_links(page) if not (page.parent / link).exists()]
