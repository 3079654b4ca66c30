"""Check of a sensor file against contact-free frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from bubbleviz.api.estimating import Recorded, SensorName, as_frames, sensor_for
from bubbleviz.api.frames import parse_frames
from bubbleviz.api.results import OneBlasThread
from bubbleviz.api.summary import Summary
from bubbleviz.calibration import CheckRow, SensorCheck, check_sensor
from bubbleviz.errors import InputError
from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import AUTO, CachedFrames, Recording, find_contact_free, shown_name
from bubbleviz.sensor_model import SensorModel

_TEMPERATURE = "sensor_msgs/msg/Temperature"
_MAX_FRAMES = 60  # more frames only take time


@dataclass(frozen=True)
class CheckSummary(SensorCheck, Summary):
    """Result of comparing contact-free frames with a sensor file, SI units."""

    recording: str = ""
    sensor: str = ""
    # missing parts of the recording, a choice made in it, or a contradiction in the sensor file
    warning: str | None = None


def check(
    frames: Recorded,
    sensor: SensorName = AUTO,
    *,
    contact_free: Sequence[int] | str | None = None,
    progress: Progress = quiet,
) -> CheckSummary:
    """Check whether contact-free frames still fit a sensor file.

    Compares rest shape, bias of the pixels, camera info and gas pressure. A change is reported if
    χ² of the mean image exceeds what the noise in the sensor file explains.

    Parameters
    ----------
    frames : sequence of Frame or path
        Beginning without contact.
    sensor : str, path or Sensor
        As in `estimate`.
    contact_free : sequence of int or str, optional
        Frames without contact, as indices or as "A:B", A to B−1; searched by default.
    progress : Progress

    Returns
    -------
    CheckSummary
        `verdict` is `fits`, `drifted` or `another` (membrane or camera); `reason` is one line with
        the change, its effect on force, and the remedy; `bias_m` is the mean of measured minus
        expected z-depth, m.

    Raises
    ------
    InputError
        Sensor and frames do not match, or there are no contact-free frames.

    Examples
    --------
    >>> bv.check(bv.open("rest.mcap"), "mine.toml").verdict
    'fits'
    """
    with as_frames(frames) as chosen, OneBlasThread():
        name, own, intrinsics = sensor_for(chosen, sensor)
        source = CachedFrames(chosen)
        if isinstance(contact_free, str):
            contact_free = parse_frames(contact_free, len(source), source.name, "--contact-free")
        free = contact_free or find_contact_free(source, progress).frames
        try:
            some = [source[k] for k in free[:: -(-len(free) // _MAX_FRAMES)]]
            model = SensorModel.of(own, intrinsics)
            found = check_sensor(model, some)
        except InputError as error:
            raise InputError(f"{shown_name(chosen.source)}: {error}") from error
        fields = {**vars(found), "rows": (*found.rows, *_temperature(chosen.source))}
    recording = shown_name(chosen.source)
    warning = "; ".join(filter(None, (chosen.note, model.contradiction))) or None
    return CheckSummary(**fields, recording=recording, sensor=name, warning=warning)


def _temperature(source: Any) -> list[CheckRow]:
    """Temperature of the camera at the end of a recording, if recorded."""
    if not isinstance(source, Recording):
        return []
    topics = [each for each in source.bag.topics if each.type == _TEMPERATURE and each.count]
    last = (source.bag.messages(each).message(each.count - 1).temperature for each in topics)
    return [CheckRow("camera temperature", "°C", float(degrees)) for degrees in last]
