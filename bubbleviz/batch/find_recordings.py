"""Recordings below a folder."""

from __future__ import annotations

import os
from pathlib import Path

from bubbleviz.errors import InputError

SUFFIXES = (".mcap", ".db3", ".bag")


def find_recordings(folder: str | Path) -> list[Path]:
    """Everything below a folder that `Recording` would open, by path.

    A folder with metadata.yaml is one recording (a rosbag2); elsewhere every .mcap, .db3 and .bag
    file is one. Names that begin with a dot are left out: they are files being written.

    Raises
    ------
    InputError
        There is no such folder, or no recording in it.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: not a folder; give the folder that holds the recordings")
    found: list[Path] = []
    seen: set[str] = set()
    for where, folders, files in os.walk(folder, followlinks=True):
        real = os.path.realpath(where)
        if real in seen:  # a link back, or to what was found already
            folders.clear()
            continue
        seen.add(real)
        if "metadata.yaml" in files:
            found.append(Path(where))
            folders.clear()
            continue
        folders[:] = [name for name in folders if not name.startswith(".")]
        found += [
            Path(where, name)
            for name in files
            if name.endswith(SUFFIXES) and not name.startswith(".")
        ]
    if not found:
        raise InputError(
            f"{folder}: no recording in it or below; it needs rosbag2 folders, .mcap, .db3 or "
            ".bag files"
        )
    return sorted(found)
