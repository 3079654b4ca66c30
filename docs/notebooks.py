"""Tutorials as notebooks: `.venv/bin/python docs/notebooks.py FOLDER` writes them.

The Markdown pages are the only source. MkDocs uses this as a hook: each notebook is in the built
site beside its page, which has a link to it.
"""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import nbformat
from nbformat import NotebookNode, v4
from pages import REPOSITORY, Block, blocks, parts

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

DOCS = REPOSITORY / "docs"
TUTORIALS = [page for page in sorted(DOCS.glob("tutorials/*.md")) if blocks(page, "python")]
PICTURE = re.compile(r"!\[[^\]]*\]\([^)]*\)\n*")
LINK_TO_A_PAGE = re.compile(r"\[([^\]]+)\]\((?!\w+://)[^)]*\)")
"""Leads nowhere from where a notebook is downloaded to; its words stay."""
KERNEL = {
    "kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"},
    "language_info": {"name": "python"},
}


def notebook(page: Path) -> NotebookNode:
    """Make a notebook of a page, without results."""
    cells = [cell for part in parts(page) for cell in cells_of(part)]
    for number, cell in enumerate(cells):
        cell["id"] = f"cell-{number}"  # the same in every build
    return v4.new_notebook(cells=cells, metadata=KERNEL)


def cells_of(part: str | Block) -> Iterator[NotebookNode]:
    """Cells of a part of a page: Python, commands that run here, and text."""
    if isinstance(part, str):
        if text := LINK_TO_A_PAGE.sub(r"\1", PICTURE.sub("", part)).strip():
            yield v4.new_markdown_cell(text)
    elif part.kind == "python":
        yield v4.new_code_cell(part.text.strip())
    elif part.kind == "sh" and not any(command.needs for command in part.commands()):
        for command in part.commands():
            yield v4.new_code_cell(f"!{shlex.join(command.words)}")
    else:
        yield v4.new_markdown_cell(f"```{part.kind}\n{part.text}```")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the notebooks to the site; MkDocs calls this."""
    from mkdocs.structure.files import File  # only where the pages are built

    for page in TUTORIALS:
        place = page.relative_to(DOCS).with_suffix(".ipynb").as_posix()
        files.append(File.generated(config, place, content=nbformat.writes(notebook(page))))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Link a tutorial to its notebook, below the title; MkDocs calls this."""
    place = Path(page.file.src_uri).with_suffix(".ipynb")
    if files.get_file_from_path(place.as_posix()) is None:
        return markdown
    title, _, rest = markdown.partition("\n")
    link = f'[This page as a notebook]({place.name}){{ download="{place.name}" }}'
    return f"{title}\n\n{link}\n{rest}"


def main() -> None:
    """Write all notebooks into the folder of the command line."""
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for page in TUTORIALS:
        nbformat.write(notebook(page), folder / f"{page.stem}.ipynb")
        print(f"wrote {folder / page.stem}.ipynb")


if __name__ == "__main__":
    main()
