"""The work of `bubbleviz batch`: recordings of a folder to results and one table."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

from bubbleviz.batch.batch_job import Job, Settings
from bubbleviz.batch.batch_summary import BatchSummary, write_summary
from bubbleviz.batch.dask_cluster import check_cluster, run_on_cluster
from bubbleviz.batch.find_recordings import find_recordings
from bubbleviz.batch.local_processes import run_in_processes
from bubbleviz.batch.summary_row import Row
from bubbleviz.errors import InputError
from bubbleviz.files.output_files import cannot_write, refuse_existing
from bubbleviz.frames.sensor_matching import AUTO
from bubbleviz.sensor import load_sensor

SUMMARY = "summary.csv"
_LOCK = ".batch.lock"


def run_batch(
    folder: str | Path,
    settings: Settings,
    out: Path,
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    resume: bool = False,
    progress: Callable[[Row, int, int], None] = lambda row, done, count: None,
) -> BatchSummary:
    """Estimate every recording below a folder, and write OUT/summary.csv.

    The result of FOLDER/a/b.mcap is in OUT/a/b.mcap/. Stopped at any moment, OUT holds whole
    results only, or nothing but hidden temporary files that `resume` removes.

    Parameters
    ----------
    folder : path
    settings : Settings
    out : Path
        New folder, or with `resume` one of an earlier batch.
    jobs : int, optional
        Processes; by default as many as this process may use processors.
    scheduler : str, optional
        Address of a Dask scheduler in place of processes here.
    resume : bool
        Keep the results made of the same recordings with the same settings.
    progress : callable
        Told each row, how many there are and will be; may raise to stop.

    Raises
    ------
    InputError
        No recordings, a sensor or cluster that is not there, or `out` cannot be used. What is
        wrong with single recordings is in their rows.
    """
    found = find_recordings(folder)
    if settings.sensor != AUTO:
        load_sensor(settings.sensor)  # else every recording would fail for the same reason
    if scheduler is not None:
        check_cluster(scheduler)
    if not (resume and out.is_dir()):
        refuse_existing(out)
    todo = _jobs(found, Path(folder), out, settings)
    rows: dict[str, Row] = {}
    with _owned(out, todo, scheduler is None):
        running = (
            run_in_processes(todo, min(jobs or _processors(), len(todo)))
            if scheduler is None
            else run_on_cluster(todo, scheduler)
        )
        with closing(running):
            for row in running:
                rows[row.recording] = row
                progress(row, len(rows), len(todo))
        summary = BatchSummary(str(out / SUMMARY), [rows[job.name] for job in todo])
        write_summary(out / SUMMARY, summary.rows)
    return summary


def _jobs(found: list[Path], folder: Path, out: Path, settings: Settings) -> list[Job]:
    """A job for each recording, with absolute paths: workers may start elsewhere."""
    if Path(settings.sensor).exists():
        settings = replace(settings, sensor=str(Path(settings.sensor).absolute()))
    made = []
    for path in found:
        name = path.relative_to(folder)
        name = Path(path.absolute().name) if name == Path() else name  # FOLDER is the recording
        made.append(Job(str(name), str(path.absolute()), str((out / name).absolute()), settings))
    return made


@contextmanager
def _owned(out: Path, todo: list[Job], local: bool) -> Iterator[None]:
    """The output folder for this batch alone, without temporary files of unfinished results.

    Stopped, workers of a cluster finish what they have begun; local ones are dead.
    """
    try:
        out.mkdir(exist_ok=True)
        with (out / _LOCK).open("w") as lock:
            _lock(lock.fileno(), out)
            _discard_unfinished(todo)
            try:
                yield
            except BaseException:
                if local:
                    _discard_unfinished(todo)
                raise
            _discard_unfinished(todo)  # of workers that died on the way
    except PermissionError as error:
        raise cannot_write(out, error) from error


def _lock(descriptor: int, out: Path) -> None:
    try:
        import fcntl  # not on Windows
    except ImportError:
        return
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InputError(
            f"{out}: another batch writes there; wait for it, or choose another folder"
        ) from None


def _discard_unfinished(todo: list[Job]) -> None:
    """Remove what `whole_file` left of results when their process was killed."""
    for path in {Path(job.out) for job in todo}:
        ours = re.compile(rf"\.{re.escape(path.stem)}\.[0-9a-f]{{8}}{re.escape(path.suffix)}")
        if path.parent.is_dir():
            for each in path.parent.iterdir():
                if ours.fullmatch(each.name) and each.is_dir():
                    shutil.rmtree(each, ignore_errors=True)


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
