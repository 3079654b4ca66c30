"""Atomic output files that never silently overwrite; tables as CSV, JSON and text."""

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
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

from bubbleviz.errors import InputError, given_path
from bubbleviz.wording import encodable

PICTURES = (".png", ".svg", ".pdf")
"""Suffixes of plots."""
_WRITTEN_SUFFIXES = {
    *(".csv", ".parquet", ".npz", ".json", ".html", ".toml", ".ply", ".pvd", ".vtp", ".series"),
    *(".mcap", ".yaml", *PICTURES),
}
"""Suffixes of files that this program writes into folders."""
_WRITTEN_FOLDERS = {"meta", "data", "episodes", "chunk-000"}
"""Names of subfolders that it writes (LeRobot datasets)."""
_CANNOT_WRITE = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.EFBIG}


_UNFINISHED = re.compile(r"\..*\.(([0-9a-f]{8})-([1-9]\d*)-[0-9a-f]{8})(?:\.[^.]+)?")
"""Hidden name of an unfinished output, with computer and process id."""


@contextmanager
def whole_file(path: str | Path, *suffixes: str, overwrite: bool = False) -> Iterator[Path]:
    """Temporary path in the same folder, renamed to `path` if the block ends without an error.

    Write a file or a folder to the temporary path, which does not exist yet and has the same
    suffix. If the block raises, it is removed, and an existing `path` is unchanged.

    Raises InputError: as `refuse_existing`, or writing fails.
    """
    path = given_path("output", path)
    refuse_existing(path, *suffixes, overwrite=overwrite)
    remove_unfinished(path)
    temporary = _hidden(path, f"{_computer()}-{os.getpid()}-{secrets.token_hex(4)}")
    try:
        yield temporary
        # before the rename, so that a crash leaves no half
        for each in (*temporary.rglob("*"), temporary):
            sync(each)
        with restore_on_error(path) if overwrite and temporary.is_dir() else nullcontext():
            _publish(temporary, path, overwrite=overwrite)
        sync(path.parent)
    except OSError as error:
        if error.errno in _CANNOT_WRITE or error.filename == str(temporary):
            raise cannot_write(path, error) from error
        raise
    finally:
        _discard(temporary)


@contextmanager
def restore_on_error(*paths: Path) -> Iterator[None]:
    """Move existing files to hidden names; move them back if the block raises, else delete them.

    For outputs that are written in place, or of several files.
    """
    backups = {path: _hidden(path, secrets.token_hex(4)) for path in paths if os.path.lexists(path)}
    for path, backup in backups.items():
        path.rename(backup)
    try:
        yield
    except BaseException:
        for path, backup in backups.items():
            _discard(path)
            backup.rename(path)
        raise
    for backup in backups.values():
        _discard(backup)


def portable_path(path: str | Path, folder: str | Path) -> str:
    """Path relative to a folder, so that both can be moved together; unchanged on another drive."""
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:
        return str(path)


def refuse_existing(path: str | Path, *suffixes: str, overwrite: bool = False) -> None:
    """Raise InputError unless `path` can be written; call it before long computations.

    With `overwrite` it may exist, but not as a folder with files of kinds that this program does
    not write. If `suffixes` are given, its name must end in one of them; "" means a folder.
    """
    path = given_path("output", path)
    ending = path.suffix.lower() if path.suffix[1:2].isalpha() else ""  # not that of "press_0.5"
    if suffixes and ending not in suffixes:
        *others, last = filter(None, suffixes)
        folder = "" if last == suffixes[-1] else ", or give a folder"
        names = f"{', '.join(others)} or {last}" if others else last
        raise InputError(f"{path}: wrong suffix for this output; end it in {names}{folder}")
    try:
        exists, parent_exists = os.path.lexists(path), path.parent.is_dir()
    except (OSError, ValueError) as error:
        raise cannot_write(path, error) from error
    if exists and not overwrite:
        raise _exists(path)
    if exists and path.is_dir():
        for each in path.rglob("*"):
            suffix = each.suffix.lower()
            known = each.name in _WRITTEN_FOLDERS if each.is_dir() else suffix in _WRITTEN_SUFFIXES
            if not known:
                raise InputError(
                    f"{path}: contains {each.relative_to(path)}, which bubbleviz did not write and "
                    "would delete; move it elsewhere, or choose another folder"
                )
    if not parent_exists:
        raise InputError(
            f"{path}: folder {path.parent} does not exist; create it, or choose another"
        )
    if not os.access(path.parent, os.W_OK):
        raise InputError(f"{path}: folder {path.parent} is not writable; choose another folder")


def refuse_input(output: str | Path | None, *read: str | Path | None) -> None:
    """Raise InputError if an output would replace an input, a recording in it, or its folder.

    Any path may be None: no such file.
    """
    for each in read:
        if output is None or each is None:
            continue
        written, original = given_path("output", output).resolve(), Path(each).resolve()
        inside = original in written.parents and written.suffix == ".mcap" and written.exists()
        if inside or written == original or written in original.parents:
            what = f"a recording in {each}" if inside else each
            raise InputError(f"{output}: would replace the input {what}; choose another name")


def free_name(path: Path) -> Path:
    """The path if it does not exist, else with the first unused number: `a-2.mcap`."""
    free, number = path, 2
    while os.path.lexists(free):
        free, number = path.with_name(f"{path.stem}-{number}{path.suffix}"), number + 1
    return free


def _hidden(path: Path, mark: str) -> Path:
    """Hidden name in the same folder, unique by `mark`."""
    # cut in bytes, as file systems limit the bytes of a name
    beginning = os.fsencode(path.stem)[:50].decode(errors="ignore")
    return path.parent / f".{beginning}.{mark}{path.suffix}"


def _computer() -> str:
    """Hash that identifies the computer or container, as several may share a network folder."""
    pid_namespace = Path("/proc/self/ns/pid")
    namespace = f"{pid_namespace.readlink()}" if pid_namespace.is_symlink() else ""
    machine_id = Path("/etc/machine-id")  # robots with one disk image have the same host name
    machine = machine_id.read_text() if os.access(machine_id, os.R_OK) else ""
    return f"{zlib.crc32(f'{socket.gethostname()} {machine} {namespace}'.encode()):08x}"


def remove_unfinished(path: Path, *, of_others: bool = False) -> None:
    """Remove unfinished outputs of killed processes of this computer in the folder of a path.

    `of_others`: also those of other computers for this path, even if their process may be running.
    """
    for each in path.parent.glob(".*"):
        if (match := _UNFINISHED.fullmatch(each.name)) is None:
            continue
        same_path = each == _hidden(path, match[1])
        if _is_dead(match[2], match[3]) or (of_others and same_path):
            _discard(each)


def _is_dead(computer: str, pid: str) -> bool:
    """Whether it is a process of this computer that has ended."""
    stat = Path("/proc", pid, "stat")  # it exists until the parent has asked for the exit code
    try:
        if computer == _computer():
            os.kill(int(pid), 0)
            return stat.is_file() and stat.read_text().rpartition(")")[2].split()[0] == "Z"
    except (ProcessLookupError, OverflowError):
        return True
    except OSError:  # another user's
        pass
    return False


def sync(path: Path) -> None:
    """Flush a file or folder to the disk, if the file system supports it.

    Folders without read permission are skipped.
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
    """Rename to `path`; without `overwrite` a file that appeared there meanwhile is an error."""
    if overwrite and temporary.is_file() and not path.is_dir():
        temporary.replace(path)
        return
    if temporary.is_dir():
        if os.path.lexists(path):
            raise _exists(path)
        temporary.rename(path)
        return
    try:
        os.link(temporary, path)  # atomic, and fails if the name exists
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
    return InputError(
        f"{path}: exists already; choose another name, or delete it first (commands: --overwrite)"
    )


def cannot_write(path: Path, error: Exception) -> InputError:
    """InputError for a failure to write `path`."""
    reason = getattr(error, "strerror", None) or error
    return InputError(f"{path}: cannot be written ({reason}); correct that or choose another path")


# Tables: on the terminal, as CSV and as JSON.


def create_folder(path: Path) -> Path:
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{path}: the folder cannot be created ({error.strerror or error}); choose another path"
        ) from error
    return path


def write_json(path: Path, data: Any) -> None:
    """Write a JSON file; numbers that are not finite become null."""
    with whole_file(path) as temporary:
        temporary.write_text(to_json(data) + "\n", encoding="utf-8")


def to_json(data: Any) -> str:
    """JSON text; numbers that are not finite become null."""
    return encodable(json.dumps(_finite(data), indent=1, allow_nan=False, ensure_ascii=False))


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows as CSV, in UTF-8 with a header line; `nan` for NaN, empty for None.

    Give the temporary path of `whole_file`.
    """
    # file names may not be UTF-8
    with path.open("w", newline="", encoding="utf-8", errors="backslashreplace") as file:
        writer = csv.DictWriter(file, list(rows[0]) if rows else [])
        writer.writeheader()
        writer.writerows({name: _cell(value) for name, value in row.items()} for row in rows)


def rows_of(columns: Mapping[str, Iterable[Any]]) -> list[dict[str, Any]]:
    """Rows of columns of equal length."""
    rows = zip(*columns.values(), strict=True)
    return [dict(zip(columns, row, strict=True)) for row in rows]


def _cell(value: Any) -> Any:
    """Escape text that a spreadsheet would execute as a formula."""
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
