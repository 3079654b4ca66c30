"""The work of `bubbleviz estimate`: a recording through the pipeline into a file, no window."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import bubbleviz
from bubbleviz.calibration.pressure_zero import PressureZero, zero_of
from bubbleviz.commands.summary import Summary
from bubbleviz.errors import InputError
from bubbleviz.files.output_files import refuse_existing, whole_file
from bubbleviz.files.result_writer import UNKNOWN, ResultWriter, csv_row
from bubbleviz.files.tables import write_rows
from bubbleviz.frames.frame_source import FrameSource, shown_name
from bubbleviz.frames.message_decoding import has_returns
from bubbleviz.frames.recording import Recording
from bubbleviz.frames.sensor_matching import fitting_sensor, gas_warning
from bubbleviz.inverse.estimator import EstimatorOptions
from bubbleviz.pipeline import SHEAR, FrameOptions, Pipeline, Product
from bubbleviz.result import Result, Status
from bubbleviz.sensor import sensor_to_toml, with_colour_delay
from bubbleviz.shear.recorded_texture import watch_recorded_texture
from bubbleviz.wording import count_of

PRODUCTS: frozenset[Product] = frozenset({"estimate", "patch", "pixel_mask"})


@dataclass(frozen=True)
class EstimateSummary(Summary):
    """Summary of `estimate`; None for statistics without frames.

    Attributes
    ----------
    recording, sensor, out, solver : str
    frames : int
        Number of frames solved.
    status : dict
        Number of frames by status.
    kappa : float or None
        None for the default threshold.
    median_total_ms, p95_total_ms, median_solve_ms : float or None
        Depth image in → patch out, and the solver alone, over all frames after the first, ms.
    median_contact_total_ms : float or None
        The same over those of them with a contact patch: most of the others need no QP.
    rms_force_n : float or None
        Root mean square of |force| over all frames with data, N.
    median_contact_force_n, max_force_n : float or None
        |force| over the frames with a contact patch, and the highest of all, N.
    median_contact_measured_force_n : float or None
        |F| of the recording's wrench over the frames with a contact patch, its bias taken from the
        contact-free frames, N.
    median_residual_rms_m, max_kkt_residual : float or None
    traction_status : dict or None
        Number of frames by status of the traction; None where it was not asked for.
    median_traction_force_n, median_traction_half_width_n : float or None
        |force| with friction over the frames where that is known, and half of its 95 % interval, N.
    texture : str or None
        What its flow is measured from, and what of the colour camera is taken for granted.
    gas_zero : str or None
        Where the zero of the gas pressure was taken from; None without, or where it is believed.
    warning : str or None
        What is missing, or does not fit together, but was solved all the same.
    """

    recording: str
    sensor: str
    out: str
    solver: str
    frames: int
    status: dict[str, int]
    kappa: float | None
    median_total_ms: float | None
    p95_total_ms: float | None
    median_contact_total_ms: float | None
    median_solve_ms: float | None
    rms_force_n: float | None
    median_contact_force_n: float | None
    max_force_n: float | None
    median_contact_measured_force_n: float | None
    median_residual_rms_m: float | None
    max_kkt_residual: float | None
    traction_status: dict[str, int] | None
    median_traction_force_n: float | None
    median_traction_half_width_n: float | None
    texture: str | None
    gas_zero: str | None
    warning: str | None

    def to_text(self) -> str:
        """Text for the terminal, with units."""
        status = ", ".join(f"{count} {name}" for name, count in self.status.items())
        lines = [f"wrote   {self.out}", f"frames  {self.frames}: {status}"]
        if self.median_contact_force_n is not None:
            lines.append(
                f"force   {self.median_contact_force_n:.3g} N median in contact, "
                f"{self.max_force_n:.3g} N highest"
            )
        if self.median_contact_measured_force_n is not None:
            lines.append(
                f"        {self.median_contact_measured_force_n:.3g} N median in contact by the "
                "wrench, less its contact-free bias"
            )
        if self.gas_zero is not None:
            lines.append(self.gas_zero)
        if self.traction_status is not None:
            lines += [self._of_shear(), f"        {self.texture}"]
        if self.median_total_ms is not None:
            lines += [
                "time    depth image in → patch out, first frame left out: "
                f"{self.median_total_ms:.1f} ms median, {self.p95_total_ms:.1f} ms p95"
            ]
        if self.median_contact_total_ms is not None:
            lines.append(f"        {self.median_contact_total_ms:.1f} ms median in contact")
        return "\n".join(lines)

    def _of_shear(self) -> str:
        status = ", ".join(f"{n} {name}" for name, n in (self.traction_status or {}).items())
        if self.median_traction_force_n is None:
            return f"shear   {status}"
        half_width = f"{self.median_traction_half_width_n:.2g}"
        return (
            f"shear   {self.median_traction_force_n:.3g} ± {half_width} N (95 %) "
            f"median with friction: {status}; its direction has not been verified"
        )


def estimate_recording(
    recording: str | Path,
    sensor_name: str | Path,
    out: Path,
    csv: Path | None = None,
    *,
    kappa: float | None = None,
    solver: str | None = None,
    frames: str | None = None,
    zero_gas: bool = True,
    shear: bool = False,
    friction: float | None = None,
    colour_delay_s: float | None = None,
) -> EstimateSummary:
    """Solve the frames of a recording and write RESULT.npz, and RESULT.csv where asked for.

    Parameters
    ----------
    recording, sensor_name : str or path
    out, csv : Path
        Neither may exist.
    kappa : float, optional
        Patch threshold over the mean contact pressure.
    solver : str, optional
    frames : str, optional
        As in `parse_frames`.
    zero_gas : bool
        Shift the measured gas pressure so that at a rest of the recording it is the sensor file's;
        without a rest it is known within the weather. If not, it is believed as it is.
    shear : bool
        Traction with friction and slip, too, from the recording's colour images.
    friction : float, optional
        Coefficient of friction to expect of contacts, 0 for none; with `shear` also the bound on
        the traction along the membrane over that across it.
    colour_delay_s : float, optional
        Stamp of a colour image minus that of the depth image of the same moment, s: negative where
        colour leads depth. By default the sensor file's.

    Raises
    ------
    InputError
        Something given does not exist or does not fit together, or no frame has data.
    """
    _check_outputs(out, csv)
    options = patch_options(kappa)
    with Recording(recording) as source:
        sensor_name, sensor = fitting_sensor(source, sensor_name)
        sensor = with_colour_delay(sensor, colour_delay_s)
        chosen = parse_frames(frames, len(source), str(source.path))
        pipeline = Pipeline.of(sensor, source.intrinsics, EstimatorOptions.named(solver, friction))
        texture = None
        if shear:
            texture = watch_recorded_texture(pipeline, source, friction)
        made_by = {
            "sensor_toml": sensor_to_toml(sensor),
            "version": bubbleviz.__version__,
            "solver": solver or pipeline.estimator.solver_name,
        }
        zero = zero_of(source, pipeline) if zero_gas else None
        known_pa = pipeline.model.gas.P0
        if zero is None or zero.rest_pa is None:
            gas = gas_warning(source[chosen[0]].gas_pressure_pa, known_pa)
        else:
            gas = gas_warning(zero.rest_pa, known_pa, "without contact in the recording")
        warning = "; ".join(filter(None, (source.bag.note, gas)))
        if zero is not None and zero.offset_pa is not None:
            made_by["gas_pressure_offset_pa"] = f"{zero.offset_pa}"
        products = PRODUCTS | SHEAR if shear else PRODUCTS
        rows = _solve(source, chosen, pipeline, products, options, out, csv, made_by, zero)
    return EstimateSummary(
        recording=str(recording),
        sensor=str(sensor_name),
        out=str(out),
        solver=made_by["solver"],
        kappa=kappa,
        texture=texture,
        gas_zero=None if zero is None else zero.words,
        warning=warning or None,
        **_statistics(rows),
    )


def parse_frames(text: str | None, count: int, name: str) -> range:
    """Frames of `A:B` or `A:B:STEP` with B left out, as Python slices; all when None.

    Parameters
    ----------
    text : str or None
        A, B or both may be empty: the first, and the last, frame.
    count : int
        Number of frames there are.
    name : str
        Recording to name in an error.
    """
    if text is None:
        return range(count)
    parts = [part.strip() for part in text.split(":")]
    if len(parts) not in (2, 3) or not all(p.isascii() and p.isdigit() for p in parts if p):
        raise InputError(f'--frames "{text}": give A:B or A:B:STEP, such as 0:60 for 0 … 59')
    start, stop, step = (
        int(part) if part else default
        for part, default in zip([*parts, ""][:3], (0, count, 1), strict=True)
    )
    if step < 1:
        raise InputError(f'--frames "{text}": the step must be 1 or more')
    if stop > count or start >= count:
        there = count_of(count, "frame")
        raise InputError(
            f'{name}: --frames "{text}" is outside its {there}; choose within 0:{count}'
        )
    if start >= stop:
        raise InputError(f'--frames "{text}": holds no frame; choose A below B')
    return range(start, stop, step)


def patch_options(kappa: float | None) -> FrameOptions:
    """Options with a patch threshold; InputError where it is no number of 0 or more."""
    if kappa is not None and not (math.isfinite(kappa) and kappa >= 0.0):
        raise InputError(f"--kappa {kappa:g}: give a number of 0 or more")
    return FrameOptions(kappa, fine_contact=kappa is None)


def solved(
    source: FrameSource,
    chosen: Iterable[int],
    pipeline: Pipeline,
    products: frozenset[Product],
    options: FrameOptions,
    zero: PressureZero | None = None,
) -> Iterator[Result]:
    """Results of frames, each started where the last one ended.

    Parameters
    ----------
    source : FrameSource
    chosen : iterable of int
        Indices of the frames.
    pipeline : Pipeline
        For these frames alone.
    products : frozenset of Product
        The estimate among them.
    options : FrameOptions
    zero : PressureZero, optional
        Taken from the measured gas pressures.

    Raises
    ------
    InputError
        A frame cannot be read or, after the last one, none of them had data.
    """
    pipeline.prepare(products)  # set-up is not part of the first frame's time
    statuses: set[Status] = set()
    seen = False
    for index in chosen:
        frame = source[index] if zero is None else zero.applied(source[index])
        seen = seen or has_returns(frame.depth_m)
        result = pipeline.process(frame, products, options)
        if result.estimate is not None:
            statuses.add(result.estimate.status)
        yield result
    _check_any_data(statuses, shown_name(source), seen)


def _check_outputs(out: Path, csv: Path | None) -> None:
    for path in filter(None, (out, csv)):
        refuse_existing(path)
    if csv is not None and csv.absolute() == out.absolute():
        raise InputError(f"{out}: given for both --out and --csv; choose two names")


def _solve(
    source: Recording,
    chosen: range,
    pipeline: Pipeline,
    products: frozenset[Product],
    options: FrameOptions,
    out: Path,
    csv: Path | None,
    made_by: dict[str, str],
    zero: PressureZero | None = None,
) -> list[dict[str, Any]]:
    """Rows of the frames, once both files are written."""
    with ExitStack() as stack:
        shape = source.size[::-1]
        archive = stack.enter_context(whole_file(out))
        table = stack.enter_context(whole_file(csv)) if csv else None
        shear = "traction" in products
        writer = stack.enter_context(
            ResultWriter(archive, pipeline.mesh, len(chosen), shape, shear=shear)
        )
        shown = tqdm(chosen, unit="frame", disable=None)  # only on a terminal
        for result in solved(source, shown, pipeline, products, options, zero):
            writer.add(result)
        writer.finish(**made_by)
        if table:
            sensor = pipeline.model.sensor.name
            write_rows(table, [csv_row(row, sensor) for row in writer.rows])
        return writer.rows


def _check_any_data(statuses: set[Status], name: str, seen: bool) -> None:
    if statuses - set(UNKNOWN):
        return
    if "implausible" in statuses:
        raise InputError(
            f"{name}: no frame asked for looks like this sensor's membrane; choose its own sensor "
            "file, and check that depths are in metres (32FC1) or millimetres (16UC1)"
        )
    if "not_converged" in statuses:
        raise InputError(
            f"{name}: no frame asked for could be solved; compare with --solver linear, and check "
            "the sensor file's tension and prestretch"
        )
    if not seen:
        raise InputError(f"{name}: no depth in any frame asked for; uncover or check the camera")
    raise InputError(
        f"{name}: no measured pixel lies on the membrane in any frame asked for; "
        "choose the sensor file of this recording"
    )


def _statistics(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Values of the summary that come from the frames."""
    known = [row for row in rows if row["status"] not in UNKNOWN]
    touching = [row for row in known if row["patch_area_m2"] > 0.0]
    warm = rows[1:]
    warm_touching = [row["total_ms"] for row in warm if row["patch_area_m2"] > 0.0]
    return {
        "frames": len(rows),
        "status": dict(Counter(row["status"] for row in rows)),
        "median_total_ms": _over(np.median, [row["total_ms"] for row in warm]),
        "p95_total_ms": _over(_p95, [row["total_ms"] for row in warm]),
        "median_contact_total_ms": _over(np.median, warm_touching),
        "median_solve_ms": _over(np.median, [row["solve_ms"] for row in warm]),
        "rms_force_n": _over(_rms, _forces(known)),
        "median_contact_force_n": _over(np.median, _forces(touching)),
        "max_force_n": _over(np.max, _forces(known)),
        "median_contact_measured_force_n": _over(
            np.median, [row["measured_force_n"] for row in touching]
        ),
        "median_residual_rms_m": _over(np.median, [row["residual_rms_m"] for row in known]),
        "max_kkt_residual": _over(np.max, [row["kkt_residual"] for row in known]),
        **_shear_statistics(rows),
    }


def _shear_statistics(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The same of traction with friction."""
    statuses = Counter(row["traction_status"] for row in rows if "traction_status" in row)
    sheared = [row for row in rows if row.get("traction_status") == "ok"]
    sizes = [float(np.linalg.norm(row["traction_force_n"])) for row in sheared]
    half_widths = [row["traction_half_width_n"] for row in sheared]
    return {
        "traction_status": dict(statuses) or None,
        "median_traction_force_n": _over(np.median, sizes),
        "median_traction_half_width_n": _over(np.median, half_widths),
    }


def _forces(rows: list[dict[str, Any]]) -> list[float]:
    return [float(np.linalg.norm(row["force_n"])) for row in rows]


def _over(statistic: Any, values: list[float]) -> float | None:
    """Statistic of finite values; None where there are none, as JSON has no NaN."""
    finite = [value for value in values if math.isfinite(value)]
    return float(statistic(finite)) if finite else None


def _p95(values: list[float]) -> float:
    return float(np.percentile(values, 95.0))


def _rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
