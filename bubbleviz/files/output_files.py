"""Output files that are written whole or not at all and never silently overwrite."""

from __future__ import annotations

import csv
import errno
import json
import math
import os
import re
import secrets
import shutil
import socket
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bubbleviz.errors import InputError
from bubbleviz.wording import encodable

_OURS = {
    *(".csv", ".parquet", ".npz", ".json", ".html", ".toml", ".ply", ".pvd", ".vtp", ".series"),
    *(".png", ".svg", ".pdf", ".mcap", ".yaml"),
}
"""Suffixes of files that this program writes into folders."""
_OUR_FOLDERS = {"meta", "data", "episodes", "chunk-000"}
"""Names of the folders in them, of a LeRobot dataset."""
_CANNOT_WRITE = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.EFBIG}


_MARK = re.compile(r"\..*\.(([0-9a-f]{8})-([1-9]\d*)-[0-9a-f]{8})(?:\.[^.]+)?")
"""In the hidden name of an unfinished output: where it is written, and by which process."""


@contextmanager
def whole_file(path: str | Path, *, overwrite: bool = False) -> Iterator[Path]:
    """Temporary path beside `path` that becomes `path` when the block ends without an error.

    Write a file or a folder at the temporary path, which does not exist yet and ends like
    `path` (some writers choose the format by it). When the block raises, nothing remains of it,
    and what `overwrite` would have replaced is as it was.

    Raises InputError: `path` exists, its folder does not, or the disk refuses.
    """
    path = Path(path)
    refuse_existing(path, overwrite=overwrite)
    sweep(path)
    temporary = _beside(path, f"{_where()}-{os.getpid()}-{secrets.token_hex(4)}")
    try:
        yield temporary
        _sync(temporary)
        with set_aside(path) if overwrite and temporary.is_dir() else nullcontext():
            _publish(temporary, path, overwrite=overwrite)
        sync(path.parent)
    except OSError as error:
        if error.errno in _CANNOT_WRITE or error.filename == str(temporary):
            raise cannot_write(path, error) from error
        raise
    finally:
        _discard(temporary)


@contextmanager
def set_aside(*paths: Path) -> Iterator[None]:
    """Keep what is at some paths under hidden names; it is back there if the block raises.

    For outputs that have to be written in place, or are several.
    """
    kept = {path: _beside(path, secrets.token_hex(4)) for path in paths if os.path.lexists(path)}
    for path, aside in kept.items():
        path.rename(aside)
    try:
        yield
    except BaseException:
        for path, aside in kept.items():
            _discard(path)
            aside.rename(path)
        raise
    for aside in kept.values():
        _discard(aside)


def refuse_existing(path: str | Path, *, overwrite: bool = False) -> None:
    """Raise InputError unless a file can be made at `path`; ask before long work.

    With `overwrite` a file may be there, or a folder that holds nothing but files of the kinds that
    this program writes.
    """
    path = Path(path)
    try:
        exists, parent_exists = os.path.lexists(path), path.parent.is_dir()
    except (OSError, ValueError) as error:
        raise cannot_write(path, error) from error
    if exists and not overwrite:
        raise _exists(path)
    if exists and path.is_dir():
        for each in path.rglob("*"):
            known = each.name in _OUR_FOLDERS if each.is_dir() else each.suffix.lower() in _OURS
            if not known:
                raise InputError(
                    f"{path}: holds {each.relative_to(path)}, which bubbleviz did not write; "
                    "choose another folder, or move that away"
                )
    if not parent_exists:
        raise InputError(f"{path}: folder {path.parent} does not exist; create it first")
    if not os.access(path.parent, os.W_OK):
        raise InputError(f"{path}: folder {path.parent} is not writable; choose another")


def free_name(path: Path) -> Path:
    """Path itself, or with the first number after its name that is not taken: `a-2.mcap`."""
    free, number = path, 2
    while os.path.lexists(free):
        free, number = path.with_name(f"{path.stem}-{number}{path.suffix}"), number + 1
    return free


def _beside(path: Path, mark: str) -> Path:
    """Hidden name in the same folder that is not taken."""
    # a name as long as the disk takes leaves no room for more, in bytes: é is two of them
    beginning = os.fsencode(path.stem)[:50].decode(errors="ignore")
    return path.parent / f".{beginning}.{mark}{path.suffix}"


def _where() -> str:
    """Name of the computer, or container: others write to the same folder over a network."""
    space = Path("/proc/self/ns/pid")  # in which processes are numbered
    numbered_in = f"{space.readlink()}" if space.is_symlink() else ""
    machine = Path("/etc/machine-id")  # robots of one image have one host name
    same_name = machine.read_text() if os.access(machine, os.R_OK) else ""
    return f"{zlib.crc32(f'{socket.gethostname()} {same_name} {numbered_in}'.encode()):08x}"


def sweep(path: Path, *, of_others: bool = False) -> None:
    """Remove what killed processes of this computer left unfinished in the folder of a path.

    `of_others`: and what those of other computers left of the output at this path, which may still
    run as far as this function knows.
    """
    for each in path.parent.glob(".*"):
        if (mark := _MARK.fullmatch(each.name)) is None:
            continue
        this = each == _beside(path, mark[1])
        if _is_dead(mark[2], mark[3]) or (of_others and this):
            _discard(each)


def _is_dead(where: str, pid: str) -> bool:
    """Whether a process of this computer is no more."""
    try:
        if where == _where():
            os.kill(int(pid), 0)
    except (ProcessLookupError, OverflowError):
        return True
    except OSError:  # another user's
        pass
    return False


def _sync(path: Path) -> None:
    """Have a file, or those in a folder, on the disk before their name is: a crash leaves no half.

    Some file systems cannot.
    """
    for each in (*path.rglob("*"), path) if path.is_dir() else (path,):
        sync(each)


def sync(path: Path) -> None:
    """Have a file's content, or a folder's names, on the disk; some file systems cannot.

    A folder that may be written but not read is left to the disk: its files have their names.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except PermissionError:
        if path.is_dir():
            return
        raise
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP, errno.EBADF):
            raise
    finally:
        os.close(descriptor)


def _publish(temporary: Path, path: Path, *, overwrite: bool) -> None:
    """Move into place; a file that appeared at `path` meanwhile is refused, not replaced."""
    if overwrite and temporary.is_file() and not path.is_dir():
        temporary.replace(path)
        return
    if temporary.is_dir():
        if os.path.lexists(path):
            raise _exists(path)
        temporary.rename(path)
        return
    try:
        os.link(temporary, path)  # atomic, and fails where the name is taken
    except FileExistsError:
        raise _exists(path) from None
    except OSError as error:
        if not temporary.exists():
            raise
        if os.path.lexists(path):  # a file system without hard links
            raise _exists(path) from error
        temporary.replace(path)


def _discard(temporary: Path) -> None:
    if temporary.is_dir():
        shutil.rmtree(temporary, ignore_errors=True)
    else:
        temporary.unlink(missing_ok=True)


def _exists(path: Path) -> InputError:
    return InputError(f"{path}: exists already; choose another name, or allow overwriting")


def cannot_write(path: Path, error: Exception) -> InputError:
    """The error to raise where the disk refuses `path`."""
    reason = getattr(error, "strerror", None) or error
    return InputError(f"{path}: cannot be written ({reason}); choose another place")


# Tables: on the terminal, as CSV and as JSON, written whole or not at all.


def out_folder(path: Path) -> Path:
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be made a folder ({error}); choose another") from error
    return path


def write_json(path: Path, data: Any) -> None:
    """JSON file; numbers that are not finite become null."""
    with whole_file(path) as temporary:
        temporary.write_text(to_json(data) + "\n", encoding="utf-8")


def to_json(data: Any) -> str:
    """JSON text; numbers that are not finite become null."""
    return encodable(json.dumps(_finite(data), indent=1, allow_nan=False, ensure_ascii=False))


def write_csv(path: Path, rows: Sequence[Any]) -> None:
    """CSV file of dataclass rows of one kind."""
    with whole_file(path) as temporary:
        write_rows(temporary, [asdict(row) for row in rows])


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """CSV of rows by column, in UTF-8 with a header line; `nan` for NaN, empty for None.

    Give the temporary path of `whole_file`.
    """
    # names of files may be no UTF-8
    with path.open("w", newline="", encoding="utf-8", errors="backslashreplace") as file:
        writer = csv.DictWriter(file, list(rows[0]) if rows else [])
        writer.writeheader()
        writer.writerows({name: _cell(value) for name, value in row.items()} for row in rows)


def _cell(value: Any) -> Any:
    """A text that a spreadsheet would run as a formula, as one that it shows."""
    formula = isinstance(value, str) and value.startswith(("=", "+", "-", "@"))
    return f"'{value}" if formula else value


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Aligned columns for the terminal."""
    lines = [list(header), *map(list, rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(header))]
    first, *others = (
        "  ".join(
            cell.ljust(width) if k == 0 else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )
    return "\n".join([first, "-" * len(first), *others])


def _finite(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _finite(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_finite(value) for value in data]
    if isinstance(data, float) and not math.isfinite(data):
        return None
    return data
