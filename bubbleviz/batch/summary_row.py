"""One row of a batch's summary table."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np

from bubbleviz.files.result_writer import UNKNOWN
from bubbleviz.result import TRUSTED

Outcome = Literal["done", "kept", "bad_input", "failed"]
"""`done` now, `kept` from before; `bad_input` the recording's or the sensor's fault, `failed` any
other."""

NAN = float("nan")


@dataclass(frozen=True)
class Row:
    """One recording in the summary table; NaN and -1 for what is not known.

    Attributes
    ----------
    recording : str
        Path below the batch's folder.
    outcome : Outcome
    frames, contact_frames, untrusted_frames : int
        All; with a contact patch; with a status other than `ok` and `no_contact`.
    max_force_n, mean_contact_force_n : float
        |force| over the frames about which something is known, and over those with a patch.
    mean_contact_measured_force_n : float
        |force| of the recording's wrench over the latter, its contact-free bias taken away.
    median_residual_rms_m : float
    median_ms : float
        Depth image in → patch out, first frame left out.
    worst_frame : int
        The first frame that is not to be trusted or, when all are, that of the largest residual.
    worst_status : str
    worst_residual_rms_m : float
    sensor : str
    error : str
        One sentence; empty when there is a result.
    note : str
        What is missing of the recording, such as its end, or does not fit the sensor file; empty
        when nothing is.
    kappa : float or None
        None where the rule of the patch is automatic.
    """

    recording: str
    outcome: Outcome
    frames: int = 0
    contact_frames: int = 0
    untrusted_frames: int = 0
    max_force_n: float = NAN
    mean_contact_force_n: float = NAN
    mean_contact_measured_force_n: float = NAN
    median_residual_rms_m: float = NAN
    median_ms: float = NAN
    worst_frame: int = -1
    worst_status: str = ""
    worst_residual_rms_m: float = NAN
    sensor: str = ""
    error: str = ""
    note: str = ""
    kappa: float | None = None

    @property
    def has_result(self) -> bool:
        """Whether there is a RESULT.npz."""
        return self.outcome in ("done", "kept")

    @classmethod
    def of_result(cls, recording: str, sensor: str, path: Path, note: str = "") -> Row:
        """Row from a RESULT.npz."""
        keys = (
            "frame",
            "status",
            "force_n",
            "measured_force_n",
            "patch_area_m2",
            "residual_rms_m",
            "total_ms",
        )
        with np.load(path) as file:
            columns = {key: file[key] for key in keys}
            kappa = float(file["kappa"][0])
        return cls(
            recording,
            "done",
            sensor=sensor,
            note=note,
            kappa=None if math.isnan(kappa) else kappa,
            **_statistics(**columns),
        )

    def to_json(self) -> str:
        """JSON object; NaN becomes null."""
        values = asdict(self).items()
        finite = {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in values}
        return json.dumps(finite, indent=1, allow_nan=False, ensure_ascii=False)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Row:
        """Row from its JSON object; TypeError where that is another's."""
        names = {field.name for field in fields(cls)}
        if set(values) != names:
            raise TypeError("not the fields of a row")
        known: dict[str, Any] = {
            k: NAN if v is None and k != "kappa" else v for k, v in values.items()
        }
        return cls(**known)


def _statistics(
    frame: np.ndarray,
    status: np.ndarray,
    force_n: np.ndarray,
    measured_force_n: np.ndarray,
    patch_area_m2: np.ndarray,
    residual_rms_m: np.ndarray,
    total_ms: np.ndarray,
) -> dict[str, Any]:
    known = ~np.isin(status, UNKNOWN)
    trusted = np.isin(status, TRUSTED)
    touching = known & (patch_area_m2 > 0.0)
    force = np.linalg.norm(force_n, axis=1)
    worst = _worst(trusted, residual_rms_m)
    return {
        "frames": len(frame),
        "contact_frames": int(touching.sum()),
        "untrusted_frames": int((~trusted).sum()),
        "max_force_n": float(force[known].max()),  # a recording without a known frame is refused
        "mean_contact_force_n": float(force[touching].mean()) if touching.any() else NAN,
        "mean_contact_measured_force_n": _mean_known(measured_force_n[touching]),
        "median_residual_rms_m": float(np.median(residual_rms_m[known])),
        "median_ms": float(np.median(total_ms[1:])) if len(total_ms) > 1 else NAN,
        "worst_frame": int(frame[worst]),
        "worst_status": str(status[worst]),
        "worst_residual_rms_m": float(residual_rms_m[worst]),
    }


def _mean_known(values: np.ndarray) -> float:
    return float(np.nanmean(values)) if np.isfinite(values).any() else NAN


def _worst(trusted: np.ndarray, residual_rms_m: np.ndarray) -> int:
    """Index of the frame to inspect first."""
    if not trusted.all():
        return int(np.argmin(trusted))
    return int(np.nanargmax(residual_rms_m))
