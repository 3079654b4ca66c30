"""Estimation of many recordings, in local processes or on a Dask cluster, into one table."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
from collections import Counter
from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import asdict, dataclass, fields, replace
from hashlib import sha256
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any, Literal

import numpy as np

import bubbleviz
from bubbleviz.api.estimating import estimate
from bubbleviz.api.frames import open
from bubbleviz.api.summary import Summary
from bubbleviz.errors import InputError, SolveError, check_given
from bubbleviz.files import (
    cannot_write,
    file_hash,
    refuse_existing,
    remove_unfinished,
    table,
    whole_file,
    write_json,
    write_rows,
)
from bubbleviz.processes import WorkerProcess, check_cluster, run_on_cluster
from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import AUTO, checked_sensor
from bubbleviz.result import TRUSTED
from bubbleviz.sensor import load_sensor, sensor_to_toml
from bubbleviz.wording import count_of, counted, reason_of

RESULT, TABLE, SUMMARY = "result.npz", "result.csv", "summary.json"
"""Files in the result folder of a recording."""
SUFFIXES = (".mcap", ".db3", ".bag")
_SUMMARY_TABLE, _LOCK = "summary.csv", ".batch.lock"
_OF_OPEN = "frames", "depth_topic"  # options that `open` takes
_HEADER = (
    *("recording", "frames", "contact", "max N", "median N", "wrench N", "residual mm", "ms/frame"),
    *("worst frame", "outcome"),
)

Outcome = Literal["done", "kept", "bad_input", "failed"]
"""`done` in this batch, `kept` from an earlier one; `bad_input`: a problem of recording or sensor,
`failed`: any other."""


@dataclass(frozen=True)
class BatchRow:
    """One recording in the summary table, with facts of its `Run`; None if unknown."""

    recording: str  # path relative to the batch's folder
    outcome: Outcome
    frames: int = 0
    contact_frames: int = 0  # with a contact patch
    untrusted_frames: int = 0  # neither `ok` nor `no_contact`
    max_force_n: float | None = None
    median_contact_force_n: float | None = None
    median_contact_measured_force_n: float | None = None
    median_residual_rms_m: float | None = None
    median_total_ms: float | None = None
    worst_frame: int | None = None  # first untrusted one, else that with the largest residual
    worst_status: str = ""
    worst_residual_rms_m: float | None = None
    sensor: str = ""
    error: str = ""  # one sentence; empty if there is a result
    warning: str | None = None
    model: str | None = None  # how wrong forces may be due to it; None: the exact membrane
    kappa: float | None = None  # None: automatic rule of the patch

    @property
    def has_result(self) -> bool:
        """Whether there is a RESULT.npz."""
        return self.outcome in ("done", "kept")

    @classmethod
    def of(cls, recording: str, rows: list[dict[str, Any]], facts: dict[str, Any]) -> BatchRow:
        """Row of a `Run` from its frames, at least one of them trusted, and its facts."""
        trusted = [row["status"] in TRUSTED for row in rows]
        residuals = [row["residual_rms_m"] for row in rows]
        worst = int(np.nanargmax(residuals)) if all(trusted) else trusted.index(False)
        known = {field.name: facts[field.name] for field in fields(cls) if field.name in facts}
        own: dict[str, Any] = {
            "recording": recording,
            "outcome": "done",
            "contact_frames": sum(row["patch_area_m2"] > 0.0 for row in rows),
            "untrusted_frames": trusted.count(False),
            "worst_frame": rows[worst]["frame"],
            "worst_status": rows[worst]["status"],
            "worst_residual_rms_m": float(residuals[worst]),
        }
        return cls(**known | own)

    def cells(self) -> list[str]:
        """Texts for the terminal."""
        if not self.has_result:
            return [self.recording, *["–"] * (len(_HEADER) - 2), self.outcome]
        trusted = self.worst_status in TRUSTED
        why = f"{_number(self.worst_residual_rms_m, 1e3)} mm" if trusted else self.worst_status
        return [
            self.recording,
            str(self.frames),
            str(self.contact_frames),
            _number(self.max_force_n),
            _number(self.median_contact_force_n),
            _number(self.median_contact_measured_force_n),
            _number(self.median_residual_rms_m, 1e3),
            _number(self.median_total_ms),
            f"{self.worst_frame} ({why})",
            self.outcome,
        ]


@dataclass(frozen=True)
class BatchSummary(Summary):
    """Summary of a batch."""

    table: str  # path of the CSV file
    rows: list[BatchRow]  # in the order of the recordings' paths

    def __repr__(self) -> str:
        outcomes = counted(Counter(row.outcome for row in self.rows))
        return f"<{count_of(len(self.rows), 'recording')}: {outcomes}; table {self.table}>"

    def to_text(self) -> str:
        """Aligned table with units, errors, and the path of the table."""
        kept = sum(row.outcome == "kept" for row in self.rows)
        with_result = sum(row.has_result for row in self.rows)
        earlier = f", {kept} of them from an earlier run" if kept else ""
        return "\n".join(
            [
                table(_HEADER, [row.cells() for row in self.rows]),
                *(row.error for row in self.rows if not row.has_result),
                *(f"{row.recording}: {row.warning}" for row in self.rows if row.warning),
                *sorted({f"model: {row.model}" for row in self.rows if row.model}),
                f"wrote {self.table}: {with_result} of {len(self.rows)} recordings have a result"
                f"{earlier}",
            ]
        )

    def raise_failures(self) -> None:
        """Raise if a recording has no result.

        Raises InputError: all failures are bad input. Raises SolveError: one failed for another
        reason.
        """
        failed = [row for row in self.rows if not row.has_result]
        if not failed:
            return
        others = [row for row in failed if row.outcome == "failed"]
        first = (others or failed)[0]
        count = f"{len(failed)} of {len(self.rows)} recordings have no result, see {self.table}"
        raise (SolveError if others else InputError)(f"{count}; the first: {first.error}")


@dataclass(frozen=True)
class Job:
    """A recording to estimate."""

    name: str  # path relative to the batch's folder
    recording: str  # absolute path
    out: str  # folder of its result
    sensor: str  # file, preset or `auto`
    options: dict[str, Any]  # of `estimate`, and `_OF_OPEN`
    keep: bool = True  # reuse an existing result of the same recording and settings


def batch(
    folder: str | Path,
    out: str | Path,
    sensor: str | Path = AUTO,
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    resume: bool = False,
    overwrite: bool = False,
    progress: Progress = quiet,
    **options: Any,
) -> BatchSummary:
    """Estimate all recordings in a folder and its subfolders, in parallel.

    OUT/summary.csv compares them; the result of FOLDER/a/b.mcap is in OUT/a/b.mcap/. If a recording
    fails, the others continue; the exit code of the command is then 2 (bad input) or 1. An
    interrupted batch leaves complete results only, and hidden temporary files that `resume`
    removes.

    Parameters
    ----------
    folder : path
    out : path
        New folder for the results, or one of an earlier batch.
    sensor : str or path
        Sensor file or preset; `auto`: the preset that fits each recording.
    jobs : int, optional
        Number of processes; one per processor by default. Each imports the calling script, whose
        call must therefore be under `if __name__ == "__main__":`.
    scheduler : str, optional
        Address of a Dask scheduler, such as tcp://10.0.0.5:8786, instead of local processes.
    resume : bool
        Continue in an existing folder; keep results that are up to date.
    overwrite : bool
        Replace the results in `out`.
    progress : callable
        Called with each finished recording and the share of finished ones; may raise to stop.
    **options
        `kappa`, `solver`, `friction` and others of `estimate`; `frames` and `depth_topic` of
        `open`.

    Raises
    ------
    InputError
        No recordings, no such sensor or cluster, or `out` cannot be used. Problems of single
        recordings are in their rows.
    """
    check_given("--jobs", jobs, 1, whole=True)
    if jobs is not None and scheduler is not None:
        raise InputError("--jobs counts processes on this machine; leave it out with --scheduler")
    found, out = find_recordings(folder), Path(out)
    if str(sensor) != AUTO:
        load_sensor(sensor)  # one error instead of one for every recording
    if scheduler is not None:
        check_cluster(scheduler)
    if not out.is_dir():
        refuse_existing(out)
    elif not (resume or overwrite):
        raise InputError(
            f"{out}: exists already; continue it with --resume, replace its results with "
            "--overwrite, or choose another folder"
        )
    all_jobs = _jobs(found, Path(folder), out, str(sensor), options, keep=not overwrite or resume)
    rows: dict[str, BatchRow] = {}
    with _locked(out, all_jobs, scheduler is None):
        running = (
            run_in_processes(all_jobs, jobs or _processors())
            if scheduler is None
            else _run_on_cluster(all_jobs, scheduler)
        )
        with closing(running):
            for row in running:
                rows[row.recording] = row
                progress(row.recording, len(rows) / len(all_jobs))
        summary = BatchSummary(str(out / _SUMMARY_TABLE), [rows[job.name] for job in all_jobs])
        with whole_file(out / _SUMMARY_TABLE, overwrite=True) as temporary:
            write_rows(temporary, [asdict(row) for row in summary.rows])
    return summary


def find_recordings(folder: str | Path) -> list[Path]:
    """All recordings in a folder and its subfolders, sorted by path.

    A folder with metadata.yaml is one recording (a rosbag2); elsewhere every .mcap, .db3 and .bag
    file is one. Hidden files are ignored, as they may be unfinished.

    Raises InputError: there is no such folder, or no recording in it.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give the folder that contains the recordings")
    found: list[Path] = []
    visited: set[str] = set()
    for parent, folders, files in os.walk(folder, followlinks=True):
        real = os.path.realpath(parent)
        if real in visited:  # a symbolic link to a folder searched already
            folders.clear()
            continue
        visited.add(real)
        if "metadata.yaml" in files:
            found.append(Path(parent))
            folders.clear()
            continue
        folders[:] = [name for name in folders if not name.startswith(".")]
        visible = (name for name in files if not name.startswith("."))
        found += [Path(parent, name) for name in visible if name.endswith(SUFFIXES)]
    if not found:
        raise InputError(
            f"{folder}: no recording in it or its subfolders; choose a folder with rosbag2 folders "
            "or .mcap, .db3 or .bag files"
        )
    return sorted(found)


def run_job(job: Job) -> BatchRow:
    """Estimate a recording, or reuse an existing result of the same recording and settings.

    Exceptions are reported in the row.
    """
    try:
        return _run(job)
    except InputError as error:
        return BatchRow(job.name, "bad_input", error=reason_of(error))
    except SolveError as error:
        return BatchRow(job.name, "failed", error=reason_of(error))
    except Exception as error:  # must not stop the other jobs
        return BatchRow(job.name, "failed", error=f"{type(error).__name__}: {reason_of(error)}")


def run_in_processes(jobs: Sequence[Job], processes: int) -> Generator[BatchRow]:
    """Rows of jobs in the order in which they finish; closing the iterator kills the processes.

    If a process dies, only its job fails (see `worker_process`).
    """
    pending = list(reversed(jobs))
    busy: dict[Any, tuple[WorkerProcess, Job]] = {}
    with ExitStack() as stack:
        idle = [stack.enter_context(WorkerProcess()) for _ in range(min(processes, len(pending)))]
        while pending or busy:
            while pending and idle:
                worker, job = idle.pop(), pending.pop()
                worker.send(run_job, job)
                busy[worker.pipe] = worker, job
            for pipe in wait(list(busy)):
                worker, job = busy.pop(pipe)
                outcome = worker.outcome()
                yield outcome.value if outcome.kind == "returned" else _lost(job, outcome.detail)
                idle.append(worker)


def _run_on_cluster(jobs: Sequence[Job], scheduler: str) -> Generator[BatchRow]:
    with closing(run_on_cluster(run_job, jobs, scheduler)) as running:
        for job, row, why in running:
            yield _lost(job, why) if row is None else row


def _lost(job: Job, why: str) -> BatchRow:
    error = f"{job.recording}: {why}; repeat with --resume, with fewer processes if memory ran out"
    return BatchRow(job.name, "failed", error=error)


def _run(job: Job) -> BatchRow:
    out = Path(job.out)
    topic = job.options.get("depth_topic")
    sensor_name, sensor = checked_sensor(job.recording, job.sensor, topic)
    inputs = {**job.options, "sensor": sensor_to_toml(sensor), "version": bubbleviz.__version__}
    files = (path for path in sensor.files if path.name != sensor.file)  # that is in the inputs
    parts = [*map(file_hash, (Path(job.recording), *files)), json.dumps(inputs, sort_keys=True)]
    key = sha256("\n".join(parts).encode()).hexdigest()
    kept = _finished(out, key) if job.keep else None
    if kept is not None:
        return kept
    try:
        return _estimated(job, sensor_name, key)
    except InputError:
        kept = _finished(out, key)  # a worker presumed lost may have finished first
        if kept is None:
            raise
        return kept


def _finished(out: Path, key: str) -> BatchRow | None:
    """Row of an existing result of the same recording and settings; None if there is none."""
    if not (out / RESULT).is_file():
        return None
    try:
        summary = json.loads((out / SUMMARY).read_text(encoding="utf-8"))
        row = BatchRow(**summary["row"])
    except (OSError, ValueError, TypeError, KeyError):
        return None
    return replace(row, outcome="kept") if summary.get("key") == key else None


def _estimated(job: Job, sensor_name: str, key: str) -> BatchRow:
    out = Path(job.out)
    out.parent.mkdir(parents=True, exist_ok=True)
    if out.is_dir() and {path.name for path in out.iterdir()} <= {RESULT, TABLE, SUMMARY}:
        shutil.rmtree(out)  # a result of other settings; folders with other files are kept
    options = {name: value for name, value in job.options.items() if name not in _OF_OPEN}
    opening = {name: job.options.get(name) for name in _OF_OPEN}
    with whole_file(out) as folder, open(job.recording, **opening) as frames:
        folder.mkdir()
        run = estimate(frames, sensor_name, out=folder / RESULT, csv=folder / TABLE, **options)
        row = BatchRow.of(job.name, run.rows(), run.facts())
        write_json(folder / SUMMARY, {"key": key, "row": asdict(row)})
    return row


def _jobs(
    found: list[Path], folder: Path, out: Path, sensor: str, options: dict[str, Any], *, keep: bool
) -> list[Job]:
    """A job for each recording, with absolute paths, as workers may run in other folders."""
    sensor = str(Path(sensor).absolute()) if Path(sensor).exists() else sensor
    jobs = []
    for path in found:
        name = path.relative_to(folder)
        name = Path(path.absolute().name) if name == Path() else name  # FOLDER is the recording
        paths = str(path.absolute()), str((out / name).absolute())
        jobs.append(Job(str(name), *paths, sensor, options, keep))
    return jobs


@contextmanager
def _locked(out: Path, jobs: list[Job], local: bool) -> Iterator[None]:
    """Lock the output folder for this batch, and remove temporary files before and after it.

    After an interruption only those of local workers, which are dead; workers of a cluster finish
    their jobs.
    """
    try:
        out.mkdir(exist_ok=True)
        with (out / _LOCK).open("w") as lock:
            _lock(lock.fileno(), out)
            _discard_unfinished(jobs)
            try:
                yield
            except BaseException:
                if local:
                    _discard_unfinished(jobs)
                raise
            else:
                _discard_unfinished(jobs)  # of workers that died
            finally:
                (out / _LOCK).unlink(missing_ok=True)
    except PermissionError as error:
        raise cannot_write(out, error) from error


def _lock(descriptor: int, out: Path) -> None:
    with suppress(BlockingIOError):
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.fstat(descriptor).st_nlink:  # else a batch that ended has removed it meanwhile
            return
    raise InputError(
        f"{out}: another batch is writing there; wait until it ends, or choose another folder"
    )


def _discard_unfinished(jobs: list[Job]) -> None:
    """Remove partial results of killed workers; the lock excludes other batches."""
    for out in {Path(job.out) for job in jobs}:
        remove_unfinished(out, of_others=True)


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _number(value: float | None, factor: float = 1.0) -> str:
    return "–" if value is None else f"{factor * value:.3g}"
