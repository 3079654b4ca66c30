"""What the pipeline makes of a frame."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from bubbleviz.frames.frame import Frame

Status = Literal["ok", "no_contact", "no_data", "not_converged", "implausible"]
"""`implausible`: no membrane of this sensor, with the noise its file or calibration tells of and
the gas pressure measured, looks like the depth image. `not_converged`: beyond the solver, or beyond
the linear gas law."""


@dataclass(frozen=True)
class Estimate:
    """Solution of the inverse problem for one frame (Eq. 23).

    Attributes
    ----------
    status : Status
        Only the numbers of `ok` and `no_contact` are to be trusted.
    displacement_m : (n,) array
        u along the reference normals, m.
    contact_pressure_pa : (n,) array
        p_c ≥ 0, Pa.
    gas_pressure_change_pa : float
        p_v, Pa; measured where the recording has the gas pressure.
    residual_rms_m : float
        Root mean square of measured minus modelled range over the pixels used, m.
    kkt_residual : float
        Relative KKT residual of the problem the solver was given.
    iterations : int
        Iterations (or pivots) of the solver.
    solve_ms : float
        Wall time of the solver alone, ms.
    """

    status: Status
    displacement_m: np.ndarray
    contact_pressure_pa: np.ndarray
    gas_pressure_change_pa: float
    residual_rms_m: float
    kkt_residual: float
    iterations: int = 0
    solve_ms: float = 0.0


@dataclass(frozen=True)
class Patch:
    """The contact patch: the part of the membrane that touches something (V-C).

    Attributes
    ----------
    threshold_pa : float
        Contact pressure below which no point belongs to the patch, Pa.
    level : (n,) array
        Positive inside; its zero line, interpolated linearly, is the edge of the patch.
    force_n : (3,) array
        Resultant of p_c on the membrane in B, N (points into the sensor).
    center_of_pressure_m : (3,) array
        Pressure-weighted centre of the patch in B, m; NaN without contact.
    area_m2 : float
        Area of the patch on the reference surface, m²; 0 without contact.
    pixel_mask : (H, W) bool array or None
        Pixels of the patch; None when nobody asked for `pixel_mask`.
    """

    threshold_pa: float
    level: np.ndarray
    force_n: np.ndarray
    center_of_pressure_m: np.ndarray
    area_m2: float
    pixel_mask: np.ndarray | None = None

    @property
    def node_mask(self) -> np.ndarray:
        """Nodes in the patch, (n,) bool."""
        return self.level > 0.0


@dataclass(frozen=True)
class Result:
    """Everything a consumer asked for about one frame; what nobody asked for is None.

    Attributes
    ----------
    frame : Frame
        The frame it was made from.
    estimate : Estimate or None
    patch : Patch or None
    cloud_m : (k, 3) array or None
        Valid measured points in B, m.
    cloud_pixels : (k,) int array or None
        Flat pixel index of each point of the cloud.
    cloud_residual_m : (k,) array or None
        Measured minus modelled range of each point, m (NaN where the model has no surface).
    times_ms : dict
        Wall time of each stage that ran, by stage name, ms; `total` is depth in → products out.
    """

    frame: Frame
    estimate: Estimate | None = None
    patch: Patch | None = None
    cloud_m: np.ndarray | None = None
    cloud_pixels: np.ndarray | None = None
    cloud_residual_m: np.ndarray | None = None
    times_ms: dict[str, float] = field(default_factory=dict)
