"""The work of `bubbleviz study …`: measurements, their reports, and what they say."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from bubbleviz.errors import InputError
from bubbleviz.files.tables import out_folder, to_json, write_csv, write_json
from bubbleviz.frames.sensor_matching import checked_sensor
from bubbleviz.sensor import load_sensor
from bubbleviz.simulation.synthetic_source import Model
from bubbleviz.study.accuracy import (
    accuracy_report,
    detection_limit,
    edge_report,
    invariance,
    regularisation,
)
from bubbleviz.study.accuracy.accuracy_study import (
    edge_grid,
    full_grid,
    quick_grid,
    run_accuracy,
)
from bubbleviz.study.accuracy.detection_limit import (
    DetectionGrid,
    detection_limits,
    quick_detection_grid,
)
from bubbleviz.study.accuracy.invariance import (
    InvarianceGrid,
    quick_invariance_grid,
    run_invariance,
)
from bubbleviz.study.identification import coverage_report
from bubbleviz.study.identification.coverage_study import (
    CoverageGrid,
    quick_coverage,
    run_coverage,
)
from bubbleviz.study.pose import pose_report
from bubbleviz.study.pose.pose_study import PoseGrid, quick_pose_grid, run_pose_study
from bubbleviz.study.pose.rubber_poses import RubberGrid, quick_rubber_grid, run_rubber_study
from bubbleviz.study.pose.screw_motion import SEEDS, run_screws, screw_source
from bubbleviz.study.presses import presses
from bubbleviz.study.report_files import check_free
from bubbleviz.study.shear import shear_report
from bubbleviz.study.shear.flow_presets import run_flow_presets
from bubbleviz.study.shear.shear_report import ShearStudy
from bubbleviz.study.shear.shear_study import ShearGrid, quick_shear_grid, run_shear
from bubbleviz.study.shear.slip_study import run_slip
from bubbleviz.study.speed import speed_report
from bubbleviz.study.speed.speed_study import (
    contact_runs,
    full_runs,
    quick_runs,
    read_ms,
    run_speed,
)
from bubbleviz.study.speed.stage_table import Machine, StageSizes, stage_text, stage_times
from bubbleviz.study.stability.stability_cases import all_cases, quick_cases
from bubbleviz.study.stability.stability_study import run_stability, summary

DEPTH_OF_SWEEP_M = 0.015
"""Of the presses of the sweep over λ, m: the middle of the grid's depths."""
STAGE_FILES = ("stages.json", "stages.csv")
STABILITY_FILES = ("stability.json", "stability.csv")


@dataclass(frozen=True)
class Findings:
    """What a study found.

    Attributes
    ----------
    numbers : dict
        SI units.
    text : str
        The same for people, with units.
    written : list of Path
        Files of the report.
    """

    numbers: dict[str, Any]
    text: str
    written: list[Path]

    def to_json(self) -> str:
        """The numbers as JSON."""
        return to_json(self.numbers)

    def to_text(self) -> str:
        """The text, and what was written."""
        wrote = [f"wrote {', '.join(map(str, self.written))}"] if self.written else []
        return "\n".join([self.text, *wrote])


def study_accuracy(
    sensor_name: str,
    out: Path | None,
    *,
    quick: bool,
    seed: int,
    shipped_only: bool,
    model: Model = "rubber",
) -> Findings:
    """Error of force, patch and shape against truths over depth, run time and membranes.

    Parameters
    ----------
    sensor_name : str
    out : Path or None
        Folder for the report; a stopped study goes on there.
    quick : bool
        A few cases.
    seed : int
        Of poses and noise.
    shipped_only : bool
        With the shipped default only.
    model : {"rubber", "linear"}
        Of the truth.

    Raises
    ------
    InputError
        No such sensor, or the folder has a report already.
    """
    sensor = load_sensor(sensor_name)
    grid = replace(quick_grid(model) if quick else full_grid(model), seed=seed)
    if shipped_only:
        grid = replace(grid, setups=grid.setups[:1])
    parts = None
    if out is not None:
        out_folder(out)
        check_free(out, accuracy_report.FILES + detection_limit.FILES + invariance.FILES)
        check_free(out, regularisation.FILES)
        parts = out_folder(out / "accuracy_parts")
    with _progress(len(grid.specimens), "membrane") as bar:
        found = run_accuracy(sensor, grid, parts, lambda _: bar.update())
    numbers, text, written = accuracy_report.as_dict(found), accuracy_report.to_text(found), []
    if out is not None:
        written = accuracy_report.write(found, out)
    if model == "rubber":
        limits_grid = replace(quick_detection_grid() if quick else DetectionGrid(), seed=seed)
        limits = detection_limits(sensor, limits_grid)
        same_grid = replace(quick_invariance_grid() if quick else InvarianceGrid(), seed=seed)
        changes = run_invariance(sensor, same_grid)
        numbers["detection"] = [asdict(limit) for limit in limits]
        numbers["invariance"] = [asdict(change) for change in changes]
        text = "\n\n".join((text, detection_limit.to_text(limits), invariance.to_text(changes)))
        if out is not None:
            written += [out / detection_limit.FILES[0], out / invariance.FILES[0]]
            write_csv(written[-2], limits)
            write_csv(written[-1], changes)
    else:  # the H1 term is judged where nothing else is wrong
        strengths = regularisation.sweep(
            sensor,
            presses(grid.objects, (DEPTH_OF_SWEEP_M,)),
            np.logspace(-1, 1, 3) if quick else np.logspace(-3, 4, 15),
            seed=seed,
            truth_nodes=grid.truth_nodes,
        )
        numbers["regularisation"] = regularisation.as_dict(strengths)
        text += "\n\n" + regularisation.to_text(strengths)
        if out is not None:
            written += regularisation.write(strengths, out)
    return Findings(numbers, text, written)


def study_edge(sensor_name: str, out: Path | None, *, quick: bool, seed: int) -> Findings:
    """How well the edge of the patch is found, on objects made for it, too; as `study_accuracy`."""
    sensor = load_sensor(sensor_name)
    grid = replace(edge_grid(quick=quick), seed=seed)
    parts = None
    if out is not None:
        check_free(out_folder(out), edge_report.FILES)
        parts = out_folder(out / "edge_parts")
    found = run_accuracy(sensor, grid, parts)
    written = edge_report.write(found, out) if out is not None else []
    return Findings(edge_report.as_dict(found), edge_report.to_text(found), written)


def study_speed(
    sensor_name: str, out: Path | None, *, quick: bool, recording: Path | None = None
) -> Findings:
    """Time by stage, growth with nodes and pixels, memory; as `study_accuracy`.

    Parameters
    ----------
    sensor_name, out, quick
        As of `study_accuracy`.
    recording : Path, optional
        A real press to measure the solvers on, too.
    """
    sensor = load_sensor(sensor_name)
    if recording is not None:
        checked_sensor(recording, None)
    if out is not None:
        check_free(out_folder(out), speed_report.FILES)
    runs = quick_runs() if quick else full_runs()
    runs += contact_runs(recording, frames=6 if quick else 40)
    with _progress(len(runs), "run") as bar:
        rows = run_speed(sensor, runs, lambda _: bar.update())
    found = speed_report.Speed(rows, read_ms(sensor))
    written = speed_report.write(found, out) if out is not None else []
    return Findings(speed_report.as_dict(found), speed_report.to_text(found), written)


def study_stages(sensor_name: str, out: Path | None, *, quick: bool) -> Findings:
    """Each stage of a frame: time, floor and growth, as on the page of performance.

    Parameters
    ----------
    sensor_name, out, quick
        As of `study_accuracy`.
    """
    sensor = load_sensor(sensor_name)
    if out is not None:
        check_free(out_folder(out), STAGE_FILES)
    sizes = StageSizes.quick() if quick else StageSizes()
    machine = Machine.measured()
    times = stage_times(sensor, sizes, machine)
    text = stage_text(times, sizes, machine)
    numbers = {
        "machine": asdict(machine),
        "sizes": asdict(sizes),
        "stages": [asdict(each) for each in times],
    }
    written: list[Path] = []
    if out is not None:
        written = [out / name for name in STAGE_FILES]
        write_json(written[0], numbers)
        write_csv(written[1], times)
    return Findings(numbers, text, written)


def study_stability(pattern: str, out: Path | None, *, quick: bool) -> Findings:
    """Stiff and extreme cases with `pattern` in their name; as `study_accuracy`."""
    cases = [case for case in (quick_cases() if quick else all_cases()) if pattern in case.name]
    if not cases:
        raise InputError(f"--case {pattern}: no case has this in its name; leave it out")
    if out is not None:
        check_free(out_folder(out), STABILITY_FILES)
    with _progress(len(cases), "case") as bar:
        results = run_stability(cases, lambda _: bar.update())
    found = summary(results)
    written: list[Path] = []
    if out is not None:
        written = [out / name for name in STABILITY_FILES]
        write_json(written[0], found)
        write_csv(written[1], results)
    lines = [f"{r.verdict:8} {r.name:44} {r.ms:8.0f} ms  {r.detail}" for r in results]
    counts = ", ".join(f"{found[key]} {key}" for key in ("passed", "refused", "failed"))
    return Findings(found, "\n".join([*lines, f"{found['cases']} cases: {counts}"]), written)


def study_pose(sensor_name: str, out: Path | None, *, quick: bool, seed: int) -> Findings:
    """Pose error against run time and other libraries, on rubber, too; as `study_accuracy`."""
    sensor = load_sensor(sensor_name)
    grid = replace(quick_pose_grid() if quick else PoseGrid(), seed=seed)
    if out is not None:
        check_free(out_folder(out), pose_report.FILES)
    with _progress(grid.poses * len(grid.objects), "press") as bar:
        trials = run_pose_study(sensor, grid, lambda _: bar.update())
    rubber_grid = replace(quick_rubber_grid() if quick else RubberGrid(), seed=seed)
    with _progress(rubber_grid.presses * len(rubber_grid.objects), "press on rubber") as bar:
        rubber = run_rubber_study(sensor, rubber_grid, lambda _: bar.update())
    nut = screw_source(sensor, nodes=grid.truth_nodes) if quick else screw_source(sensor)
    screws = run_screws(sensor, nut, SEEDS[:1] if quick else SEEDS)
    found = pose_report.PoseReport(trials, rubber, screws)
    written = pose_report.write(found, out) if out is not None else []
    return Findings(pose_report.as_dict(found), pose_report.to_text(found), written)


def study_shear(out: Path | None, *, quick: bool, seed: int) -> Findings:
    """Error of traction with friction on objects that stick and move; as `study_accuracy`.

    InputError also where OpenCV, which finds the flow, is not installed.
    """
    grid = replace(quick_shear_grid() if quick else ShearGrid(), seed=seed)
    if out is not None:
        check_free(out_folder(out), shear_report.FILES)
    presets = run_flow_presets(grid)
    with _progress(len(grid.slip_depths_m), "contact") as bar:
        slips = run_slip(grid, lambda _: bar.update())
    with _progress(grid.presses, "path") as bar:
        trials = run_shear(grid, lambda _: bar.update())
    found = ShearStudy(trials, slips, presets)
    written = shear_report.write(found, out) if out is not None else []
    return Findings(shear_report.as_dict(found), shear_report.to_text(found), written)


def study_identification(out: Path | None, *, quick: bool, seeds: int | None) -> Findings:
    """Whether the intervals of identified rubber hold the truth; as `study_accuracy`.

    Parameters
    ----------
    out, quick
        As of `study_accuracy`.
    seeds : int or None
        Identifications of every rubber; None for the usual number.
    """
    grid = quick_coverage() if quick else CoverageGrid()
    if seeds is not None:
        grid = replace(grid, seeds=seeds)
    parts = None
    if out is not None:
        check_free(out_folder(out), coverage_report.FILES)
        parts = out_folder(out / "coverage_parts")
    with _progress(grid.seeds * len(grid.rubbers), "identification") as bar:
        rows = run_coverage(grid, parts, lambda _: bar.update())
    written = coverage_report.write(rows, out) if out is not None else []
    return Findings(coverage_report.as_dict(rows), coverage_report.to_text(rows), written)


def _progress(total: int, unit: str) -> AbstractContextManager[Any]:
    return tqdm(total=total, unit=unit, disable=None)  # only on a terminal
