"""One harness for every study: cases give rows, rows give tables, targets, CSV, JSON and a plot."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from bubbleviz.errors import InputError, SolveError
from bubbleviz.files.output_files import refuse_existing, whole_file
from bubbleviz.files.tables import out_folder, table, to_json, write_csv, write_json
from bubbleviz.processes.worker_process import MEMORY_LIMIT_BYTES, WorkerProcess

Record = dict[str, Any]
DOTS_PER_INCH = 130  # legible at the width of a page


@dataclass(frozen=True)
class Case:
    """One piece of a study's work, which returns rows: dataclasses of one kind.

    With a limit it runs in a process of its own, for which `run` must pickle. A case that raises,
    hangs or dies is left out, and the report says why, unless `broken` makes a row of that and
    the time in ms.
    """

    name: str
    run: Callable[[], Sequence[Any]]
    limit_s: float | None = None
    broken: Callable[[str, float], Any] | None = None


class Column(NamedTuple):
    """A number or word of each record times a scale, in a format; the header has the unit."""

    header: str
    name: str
    form: str = ""
    scale: float = 1.0

    def text(self, record: Record) -> str:
        """What stands in a line."""
        value = record[self.name]
        return format(self.scale * value if self.scale != 1.0 else value, self.form)


@dataclass(frozen=True)
class Table:
    """Records under their name in JSON; shown on the terminal where it has columns."""

    name: str
    records: Sequence[Record]
    columns: Sequence[Column] = ()
    title: str = ""

    def to_text(self) -> str:
        """Title and aligned columns."""
        lines = [[column.text(record) for column in self.columns] for record in self.records]
        shown = table([column.header for column in self.columns], lines)
        return f"{self.title}\n{shown}" if self.title else shown


@dataclass(frozen=True)
class Target:
    """A value with its limit, such as `≤ 0.02`, and whether that is met."""

    name: str
    value: float
    limit: str
    met: bool


def at_most(name: str, value: float, limit: float) -> Target:
    """Target with an upper limit."""
    return Target(name, float(value), f"≤ {limit:g}", bool(value <= limit))


def at_least(name: str, value: float, limit: float) -> Target:
    """Target with a lower limit."""
    return Target(name, float(value), f"≥ {limit:g}", bool(value >= limit))


@dataclass(frozen=True)
class Report:
    """What a study found."""

    tables: Sequence[Table] = ()
    targets: Sequence[Target] = ()
    numbers: Record = field(default_factory=dict)  # what else belongs into the JSON
    text: str = ""  # last line on the terminal
    plot: Callable[[Figure], None] | None = None
    rows_name: str = "rows"  # in the JSON
    rows: Sequence[Any] = ()
    omitted: Sequence[str] = ()
    written: list[Path] = field(default_factory=list)

    def to_dict(self) -> Record:
        """Everything, SI units."""
        return {
            **self.numbers,
            "targets": [asdict(target) for target in self.targets],
            **{each.name: list(each.records) for each in self.tables},
            self.rows_name: [asdict(row) for row in self.rows],
            "omitted": list(self.omitted),
        }

    def to_json(self) -> str:
        """The same as text."""
        return to_json(self.to_dict())

    def to_text(self) -> str:
        """Tables, targets, what was left out and what was written."""
        parts = [each.to_text() for each in self.tables]
        lines = [
            (t.name, f"{t.value:.3g}", t.limit, "met" if t.met else "NOT met") for t in self.targets
        ]
        if lines:
            parts.append(table(("target", "value", "limit", ""), lines))
        wrote = [f"wrote {', '.join(map(str, self.written))}"] if self.written else []
        ends = [*filter(None, [self.text]), *(f"left out: {o}" for o in self.omitted), *wrote]
        return "\n\n".join([*parts, *filter(None, ["\n".join(ends)])])


@dataclass(frozen=True)
class Study:
    """Cases, and the report on their rows.

    `parts` is a folder that keeps the rows of finished cases, so that a stopped study goes on
    there; `settings` are what those must have been made with.
    """

    name: str  # of its files
    row: type  # of the rows
    cases: Sequence[Case]
    report: Callable[[list[Any]], Report]
    unit: str = "case"  # for the progress bar
    settings: Record = field(default_factory=dict)
    parts: Path | None = None
    fresh: bool = False  # every case with a limit gets a new process

    def run(self, out: Path | None = None) -> Report:
        """Run every case and write the report into a folder.

        Raises InputError: the folder has a report already, or parts of a study with other settings.
        """
        for suffix in ("csv", "json", "png"):
            if out is not None:  # before the long work
                refuse_existing(out_folder(out) / f"{self.name}.{suffix}")
        if self.parts is not None:
            check_same(self.parts, self.settings)
        rows, omitted = self._rows()
        report = replace(self.report(rows), rows=rows, omitted=omitted)
        if out is not None:
            report.written.extend(write(report, out, self.name))
        return report

    def _rows(self) -> tuple[list[Any], list[str]]:
        rows, omitted = list[Any](), list[str]()
        with (
            WorkerProcess(MEMORY_LIMIT_BYTES) as worker,
            tqdm(self.cases, unit=self.unit, disable=None) as cases,  # only on a terminal
        ):
            for case in cases:
                if self.fresh:
                    worker.stop()
                try:
                    rows += self._kept(case, worker)
                except Exception as error:  # a study reports what breaks, and goes on
                    omitted.append(f"{case.name}: {type(error).__name__}: {error}")
        return rows, omitted

    def _kept(self, case: Case, worker: WorkerProcess) -> Sequence[Any]:
        """Rows from an earlier run, or made now and kept."""
        if self.parts is None:
            return _made(case, worker)
        path = self.parts / f"{case.name.replace(' ', '_').replace('/', '_')}.json"
        if path.exists():
            records = json.loads(path.read_text(encoding="utf-8"))
            numbers = ({k: np.nan if v is None else v for k, v in r.items()} for r in records)
            return [self.row(**each) for each in numbers]
        rows = _made(case, worker)
        if rows:
            write_json(path, [asdict(row) for row in rows])
        return rows


def _made(case: Case, worker: WorkerProcess) -> Sequence[Any]:
    if case.limit_s is None:
        return case.run()
    outcome = worker.call(case.run, limit_s=case.limit_s)
    if outcome.kind == "returned":
        rows: Sequence[Any] = outcome.value
        return rows
    why = f"{outcome.kind}: {outcome.detail}"
    if case.broken is None:
        raise SolveError(why)
    return [case.broken(why, outcome.ms)]


def check_same(parts: Path, settings: Record) -> None:
    """Refuse, with an InputError, a folder whose parts are of other settings."""
    path, own = out_folder(parts) / "settings.json", json.loads(to_json(settings))
    if not path.exists():
        write_json(path, own)
    elif json.loads(path.read_text(encoding="utf-8")) != own:
        raise InputError(f"{path}: is of another study; choose another folder or delete it")


def write(report: Report, out: Path, name: str) -> list[Path]:
    """Write NAME.csv, NAME.json and, where there is a plot, NAME.png; the paths."""
    paths = [out / f"{name}.csv", out / f"{name}.json"]
    write_csv(paths[0], report.rows)
    write_json(paths[1], report.to_dict())
    if report.plot is not None and report.rows:
        figure = Figure(figsize=(15, 5), layout="constrained")
        report.plot(figure)
        for axes in figure.axes:
            axes.grid(alpha=0.3)
            if axes.get_legend_handles_labels()[0]:
                axes.legend(fontsize=8)
        paths.append(out / f"{name}.png")
        with whole_file(paths[-1]) as temporary:
            figure.savefig(temporary, dpi=DOTS_PER_INCH)
    return paths


def over(rows: Iterable[Any], name: str, average: Callable[[Any], Any] = np.median) -> float:
    """Average of a field over the rows that have a number; NaN where none has."""
    values = np.array([getattr(row, name) for row in rows], float)
    values = values[~np.isnan(values)]
    return float(average(values)) if len(values) else np.nan


def groups(rows: Iterable[Any], *names: str) -> dict[tuple[Any, ...], list[Any]]:
    """Rows by the values of some fields, in the order in which these come."""
    found: dict[tuple[Any, ...], list[Any]] = {}
    for row in rows:
        found.setdefault(tuple(getattr(row, name) for name in names), []).append(row)
    return found


Averages = dict[str, tuple[str, Callable[[Any], Any]]]
"""Names of averages, with the field and how it is averaged."""


def averages(*names: str) -> Averages:
    """Medians of some fields, under the fields' names."""
    return {name: (name, np.median) for name in names}


def summaries(rows: Iterable[Any], by: Sequence[str], of: Averages) -> list[Record]:
    """A record of each group of rows: its fields, its `count`, and averages."""
    return [
        {
            **dict(zip(by, key, strict=True)),
            "count": len(own),
            **{name: over(own, *average) for name, average in of.items()},
        }
        for key, own in groups(rows, *by).items()
    ]
