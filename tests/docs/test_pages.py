"""README and pages: code blocks run, commands exist, links resolve."""

import os
import re
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner
from notebooks import TUTORIALS
from pages import FENCE, KINDS, NEEDS, PAGES, REPOSITORY, blocks, local_links, name_of
from small_press import small_source, write_press, write_small_sensor

from benchmarks.__main__ import benchmarks
from benchmarks.window.__main__ import bench
from benchmarks.window.live_soak import free_port
from bubbleviz.api.simulating import Simulation
from bubbleviz.cli.command_line import main
from bubbleviz.sensor import load_sensor, sensor_to_toml
from tests.recordings.bagmaker import BagMaker, fill

CAPITALS = re.compile(r"\b(REC|S|FOLDER|PORT)\b")
"""What the reader puts in, in commands."""
PROGRAMS: dict[tuple[str, ...], click.Group] = {
    ("bubbleviz",): main,
    ("python", "-m", "benchmarks"): benchmarks,
    ("python", "-m", "benchmarks.window"): bench,
}
"""What the commands of the pages begin with."""


def program_of(command):
    """Click command and arguments of a shell command; None if it is not ours."""
    words = [Path(command.words[0]).name, *command.words[1:]]
    for start, group in PROGRAMS.items():
        if tuple(words[: len(start)]) == start:
            return group, words[len(start) :]
    return None


def pages_with(*kinds):
    return [page for page in PAGES if blocks(page, *kinds)]


def but_the_longest(pages):
    """The page of all commands is of `make test-all`; that its options exist is always checked."""
    long = {page: pytest.mark.long for page in pages if page.name == "commands.md"}
    return [pytest.param(page, marks=long.get(page, ())) for page in pages]


IN_PROCESS = [page for page in pages_with("python", "sh") if page not in TUTORIALS]
"""Tutorials run as notebooks."""
FEW = {"--frames": "3"}
"""In place of what a page gives, in `make test`."""


@pytest.mark.parametrize("page", but_the_longest(IN_PROCESS), ids=name_of)
def test_blocks_of_a_page_run(page, folder):
    names: dict[str, object] = {"__name__": "page"}
    for block in blocks(page, "python", "sh"):
        if block.kind == "python":
            place = f"{name_of(page)}:{block.line}"
            exec(compile("\n" * block.line + block.text, place, "exec"), names)
            continue
        for command in block.commands():
            data = [word for word in command.words if word.startswith("../shared/")]
            if all((folder / path).exists() for path in data):
                full = "TEST_ALL" in os.environ
                run(command if full else replace(command, words=fewer(command)))


def fewer(command):
    """The words of a command, to do the same with a few frames."""
    words = command.words
    words = [FEW.get(before, word) for before, word in zip(["", *words], words, strict=False)]
    real = any(word.startswith("../shared/") for word in words) and "estimate" in words
    return [*words, "--frames", "78:82"] if real else words


def run(command):
    """Run a command of ours."""
    ours = program_of(command)
    assert ours is not None, f"{command.place}: mark what this needs"
    done = CliRunner().invoke(*ours, catch_exceptions=False)
    assert done.exit_code == 0, f"{command.place}: {' '.join(command.words)}\n{done.output}"


def made(folder):
    """Write the input files of the commands on the pages; values of their placeholders."""
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


@pytest.mark.timeout(3600)  # whole studies take a quarter of an hour, beside other work longer
@pytest.mark.parametrize("page", but_the_longest(pages_with("console")), ids=name_of)
def test_commands_of_a_page_run(page, folder):
    """Each on its own files; commands that need more, as marked on the page, are skipped."""
    commands = [command for block in blocks(page, "console") for command in block.commands()]
    wanted = {None, "takes minutes"} if "TEST_ALL" in os.environ else {None}
    chosen = [command for command in commands if command.needs in wanted]
    if not chosen:
        left = {command.needs for command in commands if command.needs}
        pytest.skip("; ".join(f"{need}: {NEEDS[need]}" for need in sorted(left)))
    given = made(folder)
    for command in chosen:
        given["PORT"] = str(free_port())
        words = [CAPITALS.sub(lambda m: given[m[0]], word) for word in command.words]
        run(replace(command, words=words))


SHORT = {"--minutes": "0.1", "--seconds": "2"}
"""In place of what a page gives."""


def on_screen():
    commands = (c for page in PAGES for b in blocks(page, "sh", "console") for c in b.commands())
    return [command for command in commands if command.needs == "needs a screen"]


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """A folder with a recording that fits a preset, its sensor file and ground truth."""
    folder = tmp_path_factory.mktemp("simulated")
    sensor = folder / "my.toml"
    sensor.write_text(sensor_to_toml(load_sensor("pico_flexx_75mm")), encoding="utf-8")
    source = small_source(sensor, (*[0.060] * 75, *[0.044] * 15))
    Simulation(source).save(folder / "press.mcap", folder / "truth.npz")
    return folder


@pytest.mark.long
@pytest.mark.parametrize("command", on_screen(), ids=lambda command: command.place)
def test_commands_that_open_the_window(command, folder, simulated):
    """What would stay open writes a picture and ends; measurements are cut short."""
    shutil.copytree(simulated, folder, dirs_exist_ok=True)
    ours = program_of(command)
    words = ["press.mcap" if word == "REC" else word for word in ours[1]]
    words = [SHORT.get(before, word) for before, word in zip(["", *words], words, strict=False)]
    if words[:1] == ["open"] and not {"--screenshot", "--session"} & {*words}:
        words = [*words, "--screenshot", "a.png"]
    display = {} if words else {"DISPLAY": ""}  # without one, pictures of the example are written
    stays = "--session" in words  # a live source has no picture: it is interrupted
    code = f"from {ours[0].callback.__module__} import {ours[0].name} as main; main()"
    process = subprocess.Popen(
        [sys.executable, "-c", code, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, **display, "PYTHONPATH": str(REPOSITORY)},
    )
    try:
        said, _ = process.communicate(timeout=20.0 if stays else 240.0)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGINT if stays else signal.SIGKILL)
        said, _ = process.communicate()
    assert process.returncode == (130 if stays else 0), f"{command.place}: {said}"
    assert "--screenshot" not in words or Path("a.png").stat().st_size > 10_000


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_command_exists_with_its_options(page):
    for command in (c for block in blocks(page, "sh", "console") for c in block.commands()):
        ours = program_of(command)
        if ours is None:
            assert command.needs, f"{command.place}: only commands of ours run"
            continue
        try:
            parse(*ours)
        except click.UsageError as error:
            pytest.fail(f"{command.place}: {' '.join(command.words)}: {error.format_message()}")


def parse(command, words, parent=None):
    """Parse a command line without running it; UsageError where it is wrong."""
    if isinstance(command, click.Group) and words and not words[0].startswith("-"):
        # click keeps the help option of the first context a command sees: with -h, as on a terminal
        settings = command.context_settings
        context = click.Context(command, parent=parent, info_name=command.name, **settings)
        _, sub, rest = command.resolve_command(context, words)
        assert sub is not None  # else a UsageError
        parse(sub, rest, context)
    else:
        command.make_context(command.name, list(words), parent=parent)


@pytest.mark.parametrize("page", pages_with("toml"), ids=name_of)
def test_sensor_files_of_a_page_can_be_read(page, tmp_path):
    for block in blocks(page, "toml"):
        path = tmp_path / "sensor.toml"
        path.write_text(block.text, encoding="utf-8")
        assert load_sensor(path).name


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_block_says_what_it_is(page):
    assert not [f"{name_of(page)}:{b.line}" for b in blocks(page) if b.kind not in KINDS]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_code_is_in_blocks(page):
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    assert not re.findall(r"\n\n {4}(?!- |\d)\S.*", text), "indented code is not run"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_link_leads_to_a_file(page):
    assert not [link for link in local_links(page) if not (page.parent / link).exists()]
