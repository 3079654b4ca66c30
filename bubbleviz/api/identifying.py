"""Identification of a sensor file from contact-free frames."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bubbleviz.api.estimating import path_of
from bubbleviz.api.frames import Frames, open, parse_frames
from bubbleviz.api.results import OneBlasThread
from bubbleviz.api.summary import Summary
from bubbleviz.calibration import (
    SURFACE_NAMES,
    Identification,
    Settings,
    Step,
    SurfaceName,
    Workbench,
    as_ranges,
    output_files,
    sentence,
    with_force,
    write_sensor,
)
from bubbleviz.errors import InputError, check_choice, check_given, check_number, check_type
from bubbleviz.files import parse_pose, refuse_input
from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import CachedFrames, FrameSource
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor import Sensor, load_sensor
from bubbleviz.simulation import Validation


@dataclass
class Identified(Summary):
    """An identified sensor; `save` writes the file.

    Attributes
    ----------
    found : Identification
        All results, with the `sensor` and its `model`.
    source : FrameSource
        The frames used.
    started_from : str
        Name of the initial sensor file.
    numbers : dict
        Numbers of the report, SI units, with `verdict`; empty before `save`.
    out, report : Path or None
        Files written by `save`.
    warning : str or None
        Missing parts of the recording, or a choice made in it.
    """

    found: Identification
    source: FrameSource
    started_from: str
    numbers: dict[str, Any] = field(default_factory=dict)
    out: Path | None = None
    report: Path | None = None
    warning: str | None = None

    @property
    def tension_n_per_m(self) -> float:
        """Tension γ0 of the membrane at rest by Young–Laplace, N/m."""
        return self.found.tension_n_per_m

    @property
    def tension_interval_n_per_m(self) -> tuple[float, float]:
        """95 % interval of γ0, N/m."""
        tension = self.found.tension.possible()
        return tension.low, tension.high

    @property
    def gauge_pressure_pa(self) -> float:
        """Gauge pressure of the gas, Pa: as measured, or the former sensor file's."""
        return self.found.sensor.pneumatics.gauge_pressure_pa

    @property
    def validation(self) -> Validation | None:
        """Validation by a known press, if one was given."""
        return self.found.validation

    @property
    def prestretch(self) -> float | None:
        """Pre-stretch λ of the rubber; None if neither levels nor a press determine it."""
        return self.found.sensor.membrane.prestretch

    def save(
        self,
        out: str | Path,
        report: str | Path | None = None,
        *,
        overwrite: bool = False,
        progress: Progress = quiet,
    ) -> dict[str, Any]:
        """Write X.toml, its pixel and mesh files next to it, and the requested report.

        Parameters
        ----------
        out : path
            X.toml.
        report : path, optional
            New folder for HTML and JSON.
        overwrite : bool
            Replace existing files.
        progress : Progress

        Returns
        -------
        dict
            The numbers of the report, SI units, with `verdict`.

        Raises
        ------
        InputError
            A file exists or cannot be written; then nothing is written.
        """
        out, folder = Path(out), None if report is None else Path(report)
        output_files(out, folder, overwrite=overwrite)  # refused before a press is simulated
        if self.found.reference_force is None:
            with OneBlasThread():
                self.found = with_force(self.found)
        self.numbers = write_sensor(
            self.found,
            out,
            folder,
            source=self.source,
            sensor_file=self.started_from,
            overwrite=overwrite,
            progress=progress,
        )
        self.out, self.report = out, folder
        return self.numbers

    def facts(self) -> dict[str, Any]:
        """Numbers of the report; before `save`, tension, gauge pressure and pre-stretch."""
        return self.numbers or {
            "tension_n_per_m": self.tension_n_per_m,
            "tension_interval_n_per_m": self.tension_interval_n_per_m,
            "gauge_pressure_pa": self.gauge_pressure_pa,
            "prestretch": self.prestretch,
        }

    def to_text(self) -> str:
        """Verdict, advice, and the files written."""
        if not self.numbers:
            return repr(self)
        verdict = self.numbers["verdict"]
        report = f" and {self.report / 'report.html'}" if self.report else ""
        table = map(sentence, verdict["parameters"])
        lines = (f"- {line}" for line in (*verdict["advice"], *table))
        return "\n".join([verdict["summary"], *lines, f"wrote {self.out}{report}"])

    def __repr__(self) -> str:
        low, high = self.tension_interval_n_per_m
        return f"<γ0 {self.tension_n_per_m:.2f} N/m, 95 % within {low:.2f}…{high:.2f}>"


def identify(
    frames: FrameSource | str | Path,
    sensor: str | Path | Sensor,
    *,
    contact_free: Sequence[int] | str | None = None,
    surface: SurfaceName | None = None,
    nodes: int = 1000,
    levels: Iterable[FrameSource | str | Path] = (),
    level_sigma: float | None = None,
    vented: FrameSource | str | Path | None = None,
    held_press: bool = True,
    object: str | None = None,
    pose: str | None = None,
    pressed: str | None = None,
    out: str | Path | None = None,
    report: str | Path | None = None,
    overwrite: bool = False,
    progress: Progress = quiet,
) -> Identified:
    """Make a sensor file from contact-free frames.

    Determines the reference surface, the tension γ0 and the error of each pixel. Inflation levels
    with gas pressures also give the pre-stretch λ and the gauge pressure; so does, less precisely,
    a press held still.

    Parameters
    ----------
    frames : Frames or path
        Recording that begins without contact.
    sensor : str, path or Sensor
        Initial sensor, file or preset: name, camera pose, gauge pressure, chamber volume.
    contact_free : sequence of int or str, optional
        Frames without contact, as indices or as "A:B", A to B−1; searched by default.
    surface : {"sphere", "ellipsoid", "free-form"}, optional
        Shape of the membrane; by default chosen by cross-validation.
    nodes : int
        Nodes of the mesh, 30 to 20,000.
    levels : iterable of Frames or path
        Recordings of the untouched sensor at other inflation levels.
    level_sigma : float, optional
        Standard deviation of gas pressure differences between recordings, Pa, due to weather and
        zero drift of the sensor. By default 1 % of the largest gauge pressure, as for silicon
        sensors with a total error band of ±1 to ±2 % of full scale.
    vented : Frames or path, optional
        Recording of the open chamber, for the atmospheric pressure.
    held_press : bool
        Without levels, determine λ and gauge pressure from a press that is held still in `frames`.
    object : str, optional
        Known object pressed in `frames`, for validation: mesh file or preset.
    pose : str, optional
        Pose T_B_O of that object, "x y z qx qy qz qw" (m, unit quaternion).
    pressed : str, optional
        Frames "A:B" in which that object is held still.
    out : path, optional
        Sensor file, SENSOR.toml.
    report : path, optional
        New folder for the report, HTML and JSON.
    overwrite : bool
        Replace existing files.
    progress : callable
        Called with each step and its completed share.

    Returns
    -------
    Identified
        Results, with `save`.

    Raises
    ------
    InputError
        Too few contact-free frames, frames of another camera or in a wrong unit, no gauge pressure,
        less than half of the dome visible, or contact in all frames.

    Examples
    --------
    >>> found = bv.identify(bv.open("rest.mcap"), "punyo_oval_d405")
    >>> found.save("mine.toml", report="report")
    """
    levels = (levels,) if isinstance(levels, str | Path | Frames) else tuple(levels)
    check_choice("--surface", surface, (None, *SURFACE_NAMES))
    check_number("--nodes", nodes, 30, 20_000, whole=True)
    check_given("--level-sigma", level_sigma, 0.0)
    if out is not None:  # fail before the computation
        files = output_files(out, None if report is None else Path(report), overwrite=overwrite)
        for each in files:
            refuse_input(each, *map(path_of, (frames, vented, *levels)))
    name = sensor.name if isinstance(sensor, Sensor) else str(sensor)
    opening: AbstractContextManager[FrameSource] = (
        open(frames) if isinstance(frames, str | Path) else nullcontext(frames)
    )
    with opening as chosen, OneBlasThread():
        check_type("frames", chosen, Frames, FrameSource)
        source, warning = CachedFrames(chosen), getattr(chosen, "note", None) or None
        if isinstance(contact_free, str):
            contact_free = parse_frames(contact_free, len(source), source.name, "--contact-free")
        settings = Settings(
            Step.TENSION,
            None if contact_free is None else as_ranges(contact_free),
            surface=surface,
            nodes=nodes,
            levels=tuple(_source(each) for each in levels),
            vented=None if vented is None else _source(vented),
            level_sigma_pa=level_sigma,
            **_known_press(source, object, pose, pressed),
            held_press=held_press,
            search=False,
            force=False,
        )
        found = Workbench(source, load_sensor(sensor)).work(settings, progress)
    identified = Identified(found, source, name, warning=warning)
    if out is not None:
        identified.save(out, report, overwrite=overwrite, progress=progress)
    return identified


def _source(frames: FrameSource | str | Path) -> FrameSource | Path:
    return Path(frames) if isinstance(frames, str | Path) else CachedFrames(frames)


def _known_press(
    source: FrameSource, obj: str | None, pose: str | None, pressed: str | None
) -> dict[str, Any]:
    """Settings of the press for the validation. Raises InputError: incomplete or unreadable."""
    if obj is None and pose is None and pressed is None:
        return {}
    if obj is None or pose is None or pressed is None:
        raise InputError(
            "validation by a known press needs --object, --pose and --pressed; give all three, or "
            "none"
        )
    load_object(obj), parse_pose(pose)
    frames = parse_frames(pressed, len(source), source.name, "--pressed")
    return {"obj": obj, "pose": pose, "pressed": (frames.start, frames.stop)}
