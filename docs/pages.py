"""README and pages, taken apart into text and blocks of code."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).parents[1]
PAGES = [*sorted(REPOSITORY.glob("*.md")), *sorted((REPOSITORY / "docs").rglob("*.md"))]
FENCE = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```$", re.MULTILINE | re.DOTALL)
KINDS = {"python", "sh", "console", "toml", "text"}
NEEDS = {
    "needs a robot": "nobody publishes its ROS 2 messages here",
    "needs a screen": "only make pages opens the window",
    "needs the network": "installs packages",
    "takes minutes": "only make pages waits for it",
}
"""What a comment says of its line, or of all lines below in the block, and why they are not run."""


@dataclass(frozen=True)
class Command:
    """A command of a page: its words, and what of `NEEDS` its page says of it."""

    place: str
    words: list[str]
    needs: str | None


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    page: Path
    line: int
    kind: str
    text: str

    def commands(self) -> Iterator[Command]:
        """Commands of a block of `sh`, or of `console`, where they begin with `$`."""
        of_all = None
        for number, line in enumerate(self.text.replace("\\\n", " ").splitlines(), self.line + 1):
            words = shlex.split(line, comments=True)
            needs = next((each for each in NEEDS if each in line.partition("#")[2]), of_all)
            if not words:
                of_all = needs
                continue
            if self.kind == "console":
                assert words.pop(0) == "$", f"{name_of(self.page)}:{number}: begin with $"
            yield Command(f"{name_of(self.page)}:{number}", words, needs)


def name_of(page: Path) -> str:
    """Path of a page in the repository."""
    return page.relative_to(REPOSITORY).as_posix()


def parts(page: Path) -> Iterator[str | Block]:
    """Text and fenced blocks of a page in their order."""
    text, end = page.read_text(encoding="utf-8"), 0
    for match in FENCE.finditer(text):
        yield text[end : match.start()]
        yield Block(page, text[: match.start()].count("\n") + 1, match[1], match[2])
        end = match.end()
    yield text[end:]


def blocks(page: Path, *kinds: str) -> list[Block]:
    """Fenced blocks of a page in their order, of these kinds where some are named."""
    return [
        part
        for part in parts(page)
        if isinstance(part, Block) and (not kinds or part.kind in kinds)
    ]


def local_links(page: Path) -> Iterator[str]:
    """Files that a page links to or shows."""
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8")):
        if "://" not in target:
            yield target
