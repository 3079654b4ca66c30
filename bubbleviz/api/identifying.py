"""From contact-free frames to a sensor file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bubbleviz.api.blas_threads import OneBlasThread
from bubbleviz.calibration.identification import Identification
from bubbleviz.calibration.rubber.vented import Vented
from bubbleviz.calibration.save_identification import save
from bubbleviz.calibration.surface.reference_surface import Name
from bubbleviz.commands.identify import identify_with_levels
from bubbleviz.frames.frame_source import FrameSource
from bubbleviz.frames.kept_frames import KeptFrames
from bubbleviz.progress import Progress, quiet
from bubbleviz.sensor import Sensor, load_sensor


@dataclass(frozen=True)
class Identified:
    """An identified sensor that is not in a file yet.

    Attributes
    ----------
    found : Identification
        Everything that was found, with the `sensor` and its `model`.
    source : FrameSource
        The frames it was made from.
    started_from : str
        Name of the sensor file it started from.
    """

    found: Identification
    source: FrameSource
    started_from: str

    @property
    def tension_n_per_m(self) -> float:
        """Tension γ0 of the membrane at rest by Young–Laplace, N/m."""
        return self.found.tension_n_per_m

    @property
    def tension_interval_n_per_m(self) -> tuple[float, float]:
        """95 % interval of γ0, N/m."""
        tension = self.found.tension.tension
        return tension.low, tension.high

    @property
    def gauge_pressure_pa(self) -> float:
        """Gauge pressure of the gas, Pa: as measured, or the former sensor file's."""
        return self.found.sensor.pneumatics.gauge_pressure_pa

    @property
    def prestretch(self) -> float | None:
        """Pre-stretch λ of the rubber; None where neither levels nor a press tell it."""
        return self.found.sensor.membrane.prestretch

    def save(self, out: str | Path, report: str | Path | None = None) -> dict[str, Any]:
        """Write X.toml with its pixels and mesh beside it, and a report where it is asked for.

        Parameters
        ----------
        out : path
            X.toml.
        report : path, optional
            New folder for HTML and JSON.

        Returns
        -------
        dict
            The numbers of the report, SI units, with `verdict`.

        Raises
        ------
        InputError
            A file exists or cannot be written; nothing is written then.
        """
        folder = None if report is None else Path(report)
        return save(self.found, self.source, self.started_from, Path(out), folder)

    def __repr__(self) -> str:
        low, high = self.tension_interval_n_per_m
        return f"<γ0 {self.tension_n_per_m:.2f} N/m, 95 % within {low:.2f}…{high:.2f}>"


def identify(
    frames: FrameSource,
    sensor: str | Path | Sensor,
    *,
    contact_free: Sequence[int] | None = None,
    surface: Name | None = None,
    nodes: int = 1000,
    levels: Iterable[FrameSource] = (),
    vented: FrameSource | None = None,
    held_press: bool = True,
    progress: Progress = quiet,
) -> Identified:
    """Identify tension γ0, reference surface and pixels of an untouched sensor.

    Parameters
    ----------
    frames : Frames
        Of a recording that begins without contact.
    sensor : str, path or Sensor
        What to start from: name, camera pose, gauge pressure, chamber volume.
    contact_free : sequence of int, optional
        Indices into `frames`; found where not given.
    surface : {"sphere", "ellipsoid", "free-form"}, optional
        In place of the data's choice.
    nodes : int
        Of the mesh.
    levels : iterable of Frames
        The untouched sensor at other inflation levels: better pixels and, where gas pressures were
        recorded, pre-stretch λ and gauge pressure.
    vented : Frames, optional
        The chamber open: its gas pressure is the atmospheric one.
    held_press : bool
        Whether a press in `frames` that is held is asked for λ and gauge pressure where there are
        no levels.
    progress : callable
        Told each step and how far it is.

    Returns
    -------
    Identified
        To look at, and to `save`.

    Raises
    ------
    InputError
        Whatever makes the answer worthless: too few contact-free frames, frames of another camera
        or in another unit, no gauge pressure, half of the dome unseen, contact all along.

    Examples
    --------
    >>> found = bv.identify(bv.open("rest.mcap"), "punyo_oval_d405")
    >>> found.save("mine.toml", report="report")
    """
    name = sensor.name if isinstance(sensor, Sensor) else str(sensor)
    started = load_sensor(sensor)
    source = KeptFrames(frames)
    with OneBlasThread():
        opened = None if vented is None else Vented.measure(vented)
        found = identify_with_levels(
            source,
            started if opened is None else opened.set_in(started),
            contact_free,
            nodes=nodes,
            surface=surface,
            levels=levels,
            vented=opened,
            held_press=held_press,
            progress=progress,
        )
    return Identified(found, source, name)
