"""The blocks of code of README and pages, and how each kind is run."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).parents[2]
PAGES = [*sorted(REPOSITORY.glob("*.md")), *sorted((REPOSITORY / "docs").rglob("*.md"))]
FENCE = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```$", re.MULTILINE | re.DOTALL)
KINDS = {"python", "sh", "console", "toml", "text"}
"""`python` and `sh` run; commands of `console`, for a robot, a camera or a screen, are parsed."""


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    page: Path
    line: int
    kind: str
    text: str


def blocks(page: Path) -> list[Block]:
    """Fenced blocks of a page in their order."""
    text = page.read_text(encoding="utf-8")
    return [
        Block(page, text[: match.start()].count("\n") + 1, match[1], match[2])
        for match in FENCE.finditer(text)
    ]


def commands(page: Path) -> Iterator[tuple[int, list[str]]]:
    """Line and words of every `bubbleviz …` of a page that stands in a block or is indented."""
    text = page.read_text(encoding="utf-8").replace("\\\n", " ")
    fenced = False
    for number, line in enumerate(text.split("\n"), 1):
        if line.startswith("```"):
            fenced = not fenced
        code = re.match(r"(?:    |\$ |)\s*(?:\$ )?(?:\.venv/bin/)?bubbleviz\b(.*)", line)
        if code and (fenced or line.startswith("    ")):
            words = re.split(r"  +(?![-\s])|(?:^|\s)#|\s*[|;&]", code[1].strip())[0]
            yield number, shlex.split(words)


def local_links(page: Path) -> Iterator[str]:
    """Files that a page links to or shows."""
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8")):
        if "://" not in target:
            yield target
