"""Common harness of the studies: run cases, report tables, targets, CSV, JSON and a plot."""

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
from bubbleviz.files import (
    create_folder,
    refuse_existing,
    table,
    to_json,
    whole_file,
    write_json,
    write_rows,
)
from bubbleviz.inverse import RubberBubble
from bubbleviz.membrane import Contact, RubberMembrane, cotangent_laplacian
from bubbleviz.output import DPI
from bubbleviz.pipeline import Pipeline
from bubbleviz.processes import MEMORY_LIMIT_BYTES, WorkerProcess
from bubbleviz.result import Estimate, Patch, Result
from bubbleviz.simulation import Truth

Record = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """One case of a study; returns rows, which are dataclasses of one type.

    With a time limit it runs in a separate process, and `run` must be picklable. If a case raises,
    hangs or dies, the report lists it as omitted, unless `broken` makes a row of the reason and the
    time in ms.
    """

    name: str
    run: Callable[[], Sequence[Any]]
    limit_s: float | None = None
    broken: Callable[[str, float], Any] | None = None


class Column(NamedTuple):
    """Column of a table: a field of each record, scaled and formatted; the header has the unit."""

    header: str
    name: str
    form: str = ""
    scale: float = 1.0

    def text(self, record: Record) -> str:
        value = record[self.name]
        return format(self.scale * value if self.scale != 1.0 else value, self.form)


@dataclass(frozen=True)
class Table:
    """Records with their name in JSON, and columns for the terminal."""

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
    """A value with its limit, such as `≤ 0.02`, and whether it is met."""

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
    """Results of a study."""

    tables: Sequence[Table] = ()
    targets: Sequence[Target] = ()
    numbers: Record = field(default_factory=dict)  # further content of the JSON
    text: str = ""  # last line on the terminal
    plot: Callable[[Figure], None] | None = None
    rows_name: str = "rows"  # in the JSON
    rows: Sequence[Any] = ()
    omitted: Sequence[str] = ()
    written: list[Path] = field(default_factory=list)

    def to_dict(self) -> Record:
        """Content of the JSON, SI units."""
        return {
            **self.numbers,
            "targets": [asdict(target) for target in self.targets],
            **{each.name: list(each.records) for each in self.tables},
            self.rows_name: [asdict(row) for row in self.rows],
            "omitted": list(self.omitted),
        }

    def to_json(self) -> str:
        return to_json(self.to_dict())

    def to_text(self) -> str:
        """Tables, targets, omitted cases and written files."""
        parts = [each.to_text() for each in self.tables]
        lines = [
            (t.name, f"{t.value:.3g}", t.limit, "met" if t.met else "NOT met") for t in self.targets
        ]
        if lines:
            parts.append(table(("target", "value", "limit", ""), lines))
        wrote = [f"wrote {', '.join(map(str, self.written))}"] if self.written else []
        ends = [*filter(None, [self.text]), *(f"omitted: {o}" for o in self.omitted), *wrote]
        return "\n\n".join([*parts, *filter(None, ["\n".join(ends)])])


@dataclass(frozen=True)
class Study:
    """Cases, and the report on their rows.

    The folder `parts` stores the rows of finished cases, from which an interrupted study is
    continued if its `settings` are the same.
    """

    name: str  # of its files
    row: type  # of the rows
    cases: Sequence[Case]
    report: Callable[[list[Any]], Report]
    settings: Record = field(default_factory=dict)
    parts: Path | None = None
    fresh: bool = False  # every case with a limit gets a new process

    def run(self, out: Path | None = None) -> Report:
        """Run every case and write the report into a folder.

        Raises InputError: the folder has a report already, or parts of a study with other settings.
        """
        for suffix in ("csv", "json", "png"):
            if out is not None:  # fail before the computation
                path = create_folder(out) / f"{self.name}.{suffix}"
                if path.exists():
                    raise InputError(f"{path}: exists already; choose another --out, or delete it")
                refuse_existing(path)
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
            tqdm(self.cases, unit="case", disable=None) as cases,  # only on a terminal
        ):
            for case in cases:
                if self.fresh:
                    worker.stop()
                try:
                    rows += self._cached(case, worker)
                except Exception as error:  # reported; other cases continue
                    omitted.append(f"{case.name}: {type(error).__name__}: {error}")
        return rows, omitted

    def _cached(self, case: Case, worker: WorkerProcess) -> Sequence[Any]:
        """Rows from an earlier run, or computed and stored."""
        if self.parts is None:
            return _run(case, worker)
        path = self.parts / f"{case.name.replace(' ', '_').replace('/', '_')}.json"
        if path.exists():
            records = json.loads(path.read_text(encoding="utf-8"))
            numbers = ({k: np.nan if v is None else v for k, v in r.items()} for r in records)
            return [self.row(**each) for each in numbers]
        rows = _run(case, worker)
        if rows:
            write_json(path, [asdict(row) for row in rows])
        return rows


def _run(case: Case, worker: WorkerProcess) -> Sequence[Any]:
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
    """Raise InputError if the parts in a folder have other settings."""
    path, own = create_folder(parts) / "settings.json", json.loads(to_json(settings))
    if not path.exists():
        write_json(path, own)
    elif json.loads(path.read_text(encoding="utf-8")) != own:
        raise InputError(
            f"{parts}: has cases of a study with other settings; choose another --out, or delete "
            "this folder"
        )


def write(report: Report, out: Path, name: str) -> list[Path]:
    """Write NAME.csv, NAME.json and, if there is a plot, NAME.png; returns their paths."""
    paths = [out / f"{name}.csv", out / f"{name}.json"]
    with whole_file(paths[0]) as temporary:
        write_rows(temporary, [asdict(row) for row in report.rows])
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
            figure.savefig(temporary, dpi=DPI)
    return paths


def over(rows: Iterable[Any], name: str, average: Callable[[Any], Any] = np.median) -> float:
    """Average of a field over the rows in which it is not NaN; NaN if there are none."""
    values = np.array([getattr(row, name) for row in rows], float)
    values = values[~np.isnan(values)]
    return float(average(values)) if len(values) else np.nan


def groups(rows: Iterable[Any], *names: str) -> dict[tuple[Any, ...], list[Any]]:
    """Rows by the values of some fields, in order of first occurrence."""
    found: dict[tuple[Any, ...], list[Any]] = {}
    for row in rows:
        found.setdefault(tuple(getattr(row, name) for name in names), []).append(row)
    return found


Averages = dict[str, tuple[str, Callable[[Any], Any]]]
"""Field and averaging function by name."""


def averages(*names: str) -> Averages:
    """Medians of some fields, under the fields' names."""
    return {name: (name, np.median) for name in names}


def summaries(rows: Iterable[Any], by: Sequence[str], of: Averages) -> list[Record]:
    """One record per group of rows: values of the fields `by`, `count`, and averages."""
    return [
        {
            **dict(zip(by, key, strict=True)),
            "count": len(own),
            **{name: over(own, *average) for name, average in of.items()},
        }
        for key, own in groups(rows, *by).items()
    ]


# Checks of an estimate that share no code with the solver.


BALANCE = 1e-3  # largest residual of membrane balance and gas law over their largest term
KKT = {"paper": 5e-2}  # largest KKT residual of solvers with early termination; of others 1e-3
FORCE_RELATIVE = 0.2  # of the true force; chosen as a gross error
FORCE_PER_EDGE = 20.0  # relative error per m of mesh edge, for coarse meshes
FORCE_PER_NOISE = 2.5  # of γ0 × noise: the force by noise alone
RUBBER_BALANCE = 1e-2
"""Largest residual force of the exact membrane along random motions, over that of the gas: ten
times the tolerance at a node."""
RUBBER_RELATIVE, RUBBER_PER_EDGE = 0.05, 10.0
"""Force error of the exact membrane by its mesh, which is not part of its sigma: relative, and per
m of mesh edge; the larger one counts."""
SIGMAS = 4.0  # rarely exceeded by chance in some dozens of cases
MISFIT = 3.0  # largest misfit of a frame of status ok, over the noise


@dataclass(frozen=True)
class Band:
    """Tolerance of the force.

    With a sigma of the estimate: four sigma, plus the error by the mesh. Without: the larger of a
    fifth of the force and 2 % per millimetre of mesh edge, plus γ0 times 2.5 σ of the range (a
    membrane that moves by σ changes its force by about γ0 σ, whatever its size).
    """

    noise_m: float  # σ of range in the frame; at least 0.3 mm is used, for the mesh

    def width_n(self, truth: Truth, pipeline: Pipeline, estimate: Estimate) -> float:
        """Width of the band on either side of the true force, N."""
        true = float(np.linalg.norm(truth.force_n))
        edge = 1.5 * np.sqrt(np.median(pipeline.mesh.facet_areas))
        if estimate.status == "ok" and estimate.force_sigma_n is not None:
            sigma = float(np.linalg.norm(estimate.force_sigma_n))
            return SIGMAS * sigma + max(RUBBER_RELATIVE, RUBBER_PER_EDGE * edge) * true
        floor = FORCE_PER_NOISE * pipeline.model.tension_n_per_m * max(self.noise_m, 3e-4)
        relative = max(FORCE_RELATIVE, FORCE_PER_EDGE * edge)
        return float(relative * true + floor)


def forward_faults(contact: Contact, gauge_pressure_pa: float) -> list[str]:
    """Violated conditions of a forward solution."""
    pressure = max(gauge_pressure_pa, float(np.max(contact.contact_pressure_pa)))
    checks = {
        "not finite": np.isfinite(contact.displacement_m).all(),
        "negative pressure": contact.contact_pressure_pa.min() >= 0.0,
        "balance": contact.balance_residual < 1e-6,
        "gas law": contact.gas_law_residual < 1e-6,
        "penetration": contact.penetration_m < 1e-8,
        "complementarity": contact.complementarity < 1e-8 * pressure,
        "not converged": contact.converged,
    }
    return [f"forward: {name}" for name, passed in checks.items() if not passed]


def inverse_faults(
    pipeline: Pipeline, result: Result, truth: Truth | None, band: Band, measured_gas: bool = False
) -> list[str]:
    """Violated conditions of a result with status `ok` or `no_contact`."""
    estimate, patch = result.estimate, result.patch
    if estimate is None or patch is None:
        return ["no estimate or no patch"]
    faults = _fields(pipeline, estimate, patch, band)
    bubble = pipeline.estimator.bubble
    if not faults and isinstance(bubble, RubberBubble):
        faults = _rubber_equations(pipeline, bubble.membrane, estimate, patch, measured_gas)
    elif not faults:
        faults = _linear_equations(pipeline, estimate, patch, measured_gas)
    if truth is None or faults:
        return faults
    error = float(np.linalg.norm(patch.force_n - truth.force_n))
    width = band.width_n(truth, pipeline, estimate)
    if error <= width:
        return []
    true, found = np.linalg.norm(truth.force_n), np.linalg.norm(patch.force_n)
    return [
        f"status {estimate.status} with {found:.4g} N instead of {true:.4g} N (band {width:.3g} N)"
    ]


def _fields(pipeline: Pipeline, estimate: Estimate, patch: Patch, band: Band) -> list[str]:
    """Violations: numbers not finite, wrong status, KKT residual or misfit too large."""
    numbers: list[Any] = [
        *(estimate.displacement_m, estimate.contact_pressure_pa, estimate.gas_pressure_change_pa),
        *(estimate.residual_rms_m, estimate.kkt_residual, patch.force_n, patch.area_m2),
    ]
    if not all(np.isfinite(x).all() for x in numbers):
        return ["not finite"]
    if estimate.contact_pressure_pa.min() < 0.0:
        return [f"negative pressure {estimate.contact_pressure_pa.min():.3g} Pa"]
    touched = bool(np.any(estimate.contact_pressure_pa > 0.0))
    if touched != (estimate.status == "ok"):
        found = "has" if touched else "has no"
        return [f"status is {estimate.status}, but the estimate {found} contact pressure"]
    limit = KKT.get(pipeline.estimator.solver_name, 1e-3)
    if estimate.kkt_residual > limit:
        return [f"KKT residual {estimate.kkt_residual:.2g} above {limit:g}"]
    if estimate.residual_rms_m > MISFIT * max(band.noise_m, 1e-3):
        misfit = 1e3 * estimate.residual_rms_m
        return [f"status {estimate.status} with a misfit of {misfit:.2g} mm"]
    return []


def _linear_equations(
    pipeline: Pipeline, estimate: Estimate, patch: Patch, measured_gas: bool
) -> list[str]:
    """Violations of rim, force, balance K u = A (p_v − p_c) and the gas law of Eq. 6."""
    mesh, faults, gas_law = pipeline.mesh, [], pipeline.model.gas.pressure_change
    u, p_v = estimate.displacement_m, estimate.gas_pressure_change_pa
    if np.any(u[mesh.rim] != 0.0):
        faults.append("the rim moves")
    force = -(mesh.areas * estimate.contact_pressure_pa) @ mesh.normals
    if not np.allclose(force, patch.force_n, rtol=1e-6, atol=1e-12):
        faults.append("the force differs from the integral of the pressure")
    elastic = pipeline.model.tension_n_per_m * (cotangent_laplacian(mesh) @ u)[mesh.free]
    gas = p_v * mesh.areas[mesh.free]
    contact = (mesh.areas * estimate.contact_pressure_pa)[mesh.free]
    largest = max(float(np.abs(x).max(initial=0.0)) for x in (elastic, gas, contact))
    residual = float(np.abs(elastic - gas + contact).max(initial=0.0))
    if residual > BALANCE * max(largest, 1e-300):
        faults.append(f"balance off by {residual / largest:.2g} of its largest term")
    if not measured_gas:
        law, size = gas_law(u), abs(gas_law(np.abs(u)))
        if abs(law - p_v) > BALANCE * max(size, 1e-9):
            faults.append(f"gas law: p_v {p_v:.4g} Pa instead of {law:.4g} Pa")
    return faults


def _rubber_equations(
    pipeline: Pipeline,
    membrane: RubberMembrane,
    estimate: Estimate,
    patch: Patch,
    measured_gas: bool,
) -> list[str]:
    """Violations of equilibrium, gas law and force, from the membrane's energy and volume alone."""
    friction = estimate.friction_n
    if estimate.displacement_3d_m is None or friction is None:
        return []
    rest, gas, gauge = pipeline.mesh.nodes, pipeline.model.gas, membrane.gauge_pressure_pa
    x, p_v = rest + estimate.displacement_3d_m, estimate.gas_pressure_change_pa
    contact = estimate.contact_pressure_pa / gauge
    inside = 1.0 + p_v / gauge - contact
    moving = np.isin(np.arange(len(rest)), membrane.moving)[:, None]
    rng, residuals, loads, h = np.random.default_rng(0), [], [], 1e-7

    def slope(function: Callable[[np.ndarray], float], at: np.ndarray, motion: np.ndarray) -> float:
        return (function(at + h * motion) - function(at - h * motion)) / (2.0 * h)

    for _ in range(8):
        motion = moving * rng.standard_normal(rest.shape)
        loads.append(gauge * slope(membrane.volume, rest, motion))
        at_rest = slope(membrane.energy, rest, motion) - loads[-1]
        pressure = gauge * slope(membrane.volume, x, inside[:, None] * motion)
        elastic = slope(membrane.energy, x, motion)
        residuals.append(elastic - pressure - np.vdot(friction, motion) - at_rest)
    faults = []
    residual, load = np.linalg.norm(residuals), np.linalg.norm(loads)
    if residual > RUBBER_BALANCE * load:
        faults.append(f"balance off by {residual / load:.2g} of the gas load")
    normal = [-gauge * slope(membrane.volume, x, contact[:, None] * axis) for axis in np.eye(3)]
    expected = normal + friction.sum(axis=0)
    reported = np.array([patch.force_n, estimate.force_n])
    if not np.allclose(reported, expected, rtol=1e-4, atol=1e-5):
        faults.append("the force differs from the integral of pressure and friction")
    if not measured_gas:
        increase = membrane.volume(x) - membrane.volume(rest)
        law = -gas.P0 * increase / (gas.V0 + increase)
        if abs(law - p_v) > BALANCE * max(abs(law), 1.0):
            faults.append(f"gas law: p_v {p_v:.4g} Pa instead of {law:.4g} Pa")
    return faults
