"""What was found in one frame, as arrays and as a picture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bubbleviz.files.result_writer import nodal_fields, summary_row
from bubbleviz.result import Estimate, Patch, Pose, Result
from bubbleviz.sensor_model import SensorModel


@dataclass(frozen=True)
class FrameResult:
    """What was found in one frame; NaN wherever `status` says that there is no number to trust.

    Units are SI, positions in the bubble frame B: origin at the centre of the rim plane, z outward.

    Attributes
    ----------
    result : Result
        With its `estimate`, `patch`, `pose` and `times_ms`.
    model : SensorModel
        The sensor it was made with, with its `mesh` of n nodes.
    """

    result: Result
    model: SensorModel

    @property
    def index(self) -> int:
        """Index in the recording, or count since a live source started."""
        return self.result.frame.index

    @property
    def time_s(self) -> float:
        """Seconds from the start of the recording."""
        return self.result.frame.time_s

    @property
    def status(self) -> str:
        """`ok`, `no_contact`, or why there is no number to trust (`Status`)."""
        return self.estimate.status

    @property
    def force_n(self) -> np.ndarray:
        """Resultant of the contact pressure on the membrane in B, (3,), N."""
        force: np.ndarray = summary_row(self.result)["force_n"]
        return force

    @property
    def force_sigma_n(self) -> np.ndarray:
        """Standard deviation of the force, (3,), N; NaN where the linear model was solved."""
        sigma: np.ndarray = summary_row(self.result)["force_sigma_n"]
        return sigma

    @property
    def center_of_pressure_m(self) -> np.ndarray:
        """Pressure-weighted centre of the patch, (3,), m; NaN without contact."""
        center: np.ndarray = summary_row(self.result)["center_of_pressure_m"]
        return center

    @property
    def patch_area_m2(self) -> float:
        """Area of the contact patch on the reference surface, m²; 0 without contact."""
        return float(summary_row(self.result)["patch_area_m2"])

    @property
    def patch_area_interval_m2(self) -> np.ndarray:
        """Areas within the inner and outer line of the band that holds the true edge, (2,), m²."""
        interval: np.ndarray = summary_row(self.result)["patch_area_interval_m2"]
        return interval

    @property
    def contact_pressure_pa(self) -> np.ndarray:
        """Contact pressure p_c ≥ 0 of the nodes (Eq. 23), (n,), Pa."""
        return nodal_fields(self.result, self.model.mesh)["contact_pressure_pa"]

    @property
    def displacement_m(self) -> np.ndarray:
        """Displacement u of the nodes along the rest normals (Eq. 1), (n,), m."""
        return nodal_fields(self.result, self.model.mesh)["displacement_m"]

    @property
    def nodes_m(self) -> np.ndarray:
        """Nodes of the membrane where they are now, (n, 3), m."""
        moved = nodal_fields(self.result, self.model.mesh)["displacement_3d_m"]
        return self.model.mesh.nodes + moved

    @property
    def pixel_mask(self) -> np.ndarray:
        """Pixels that see the contact patch, (H, W) bool; found when asked for."""
        return self.model.view.patch_pixels(self.estimate, self.patch)

    @property
    def pose(self) -> Pose | None:
        """Pose of the object with its covariance, where one was looked for."""
        return self.result.pose

    @property
    def T_B_O(self) -> np.ndarray:
        """Pose of the object, (4, 4), m; NaN where there is none."""
        pose = self.result.pose
        return np.full((4, 4), np.nan) if pose is None else pose.T_B_O

    @property
    def estimate(self) -> Estimate:
        """Solution of the inverse problem."""
        assert self.result.estimate is not None  # every result has one
        return self.result.estimate

    @property
    def patch(self) -> Patch:
        """The contact patch."""
        assert self.result.patch is not None  # every result has one
        return self.result.patch

    def plot(self, screenshot: str | Path | None = None) -> Any:
        """Show the membrane with its contact pressure, the patch's outline and the force.

        Parameters
        ----------
        screenshot : path, optional
            Write this PNG instead, without a screen.

        Returns
        -------
        object
            What `pyvista.Plotter.show` returns: in a notebook the picture.

        Raises
        ------
        InputError
            pyvista, of the extra `window`, is not installed, or the file exists.
        """
        from bubbleviz.api.membrane_picture import show_membrane  # pyvista takes long to load

        return show_membrane(self.result, self.model.mesh, screenshot)

    def __repr__(self) -> str:
        force = float(np.linalg.norm(self.force_n))
        return f"<frame {self.index}: {self.status}, {force:.3g} N>"
