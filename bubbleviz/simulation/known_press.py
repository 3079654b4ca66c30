"""Comparison of a predicted press (known object and pose) with its frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bubbleviz.camera import MembraneView
from bubbleviz.errors import InputError, SolveError
from bubbleviz.files import parse_pose
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import Frame, FrameSource
from bubbleviz.rigid_object import RigidObject, load_object
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation.synthetic_source import SyntheticSource, iou
from bubbleviz.wording import count_of

LARGEST_SHARE = 0.5
"""Largest rms distance from the prediction over that from rest, for a confirmed calibration."""
LEAST_OVERLAP = 0.4
"""Smallest overlap of both patches; chosen: the predicted edge lies between two nodes."""


@dataclass(frozen=True)
class Validation:
    """Prediction of a press of a known object at a known pose, against its measurement."""

    # (k, 3), measured cloud in B (mean of the frames), minus the calibrated bias, m
    points_m: np.ndarray
    # (H, W), distance of each of them from the predicted membrane along its ray, positive outside,
    # m; NaN in pixels without one
    distance_m: np.ndarray
    # rms distance of the cloud from the membrane without contact, for comparison, m
    untouched_rms_m: float
    # predicted_patch, measured_patch: (H, W) bool, pixels that see the contact, by the forward
    # model and by the estimate
    predicted_patch: np.ndarray
    measured_patch: np.ndarray
    predicted_force_n: np.ndarray  # (3,), on the membrane in B
    measured_force_n: np.ndarray  # (3,), the same by the estimate; NaN if that failed

    @classmethod
    def of(
        cls,
        model: SensorModel,  # as calibrated, with the camera of the frames
        frames: Sequence[Frame],  # of the object held still; their mean is used
        obj: RigidObject,
        T_B_O: np.ndarray,  # (4, 4), its pose in B
    ) -> Validation:
        """Predict the press of an object at a pose and compare it with its frames.

        By the membrane of the sensor file: rubber where that has a pre-stretch.

        Raises InputError: no frames, no pixel on the membrane, or an object in the rim. Raises
        SolveError: there is no equilibrium at the pose.
        """
        if not frames:
            raise InputError("validation: no frames; give at least one of the object held still")
        frame = mean_frame(frames)
        press = SyntheticSource(model, obj, T_B_O[None])
        try:
            truth = press.truth(0)
        except SolveError as error:
            raise SolveError(
                f"validation: no equilibrium of the membrane with {obj.name} at this pose; correct "
                "the pose or the object"
            ) from error
        view = MembraneView(model.camera, press.mesh)
        measured = model.range_image(frame.depth_m).astype(float)
        distance = measured - view.range_image(truth.displacement_3d_m)
        untouched = measured - view.rest_range
        if not np.isfinite(distance).any():
            raise InputError(
                "validation: no pixel has a valid depth on the membrane; choose other pressed "
                "frames, or the sensor file of this camera"
            )
        result = Pipeline(model).process(frame, frozenset({"patch", "pixel_mask"}))
        estimated, force = np.zeros_like(truth.patch_mask), np.full(3, np.nan)
        if (patch := result.trusted_patch) is not None and patch.pixel_mask is not None:
            estimated, force = patch.pixel_mask, patch.force_n
        return cls(
            points_m=model.camera.points_at(measured, np.flatnonzero(np.isfinite(distance))),
            distance_m=distance,
            untouched_rms_m=float(np.sqrt(np.nanmean(untouched**2))),
            predicted_patch=truth.patch_mask,
            measured_patch=estimated,
            predicted_force_n=truth.force_n,
            measured_force_n=force,
        )

    @property
    def rms_m(self) -> float:
        """Root mean square of the distance, m."""
        return float(np.sqrt(np.nanmean(self.distance_m**2)))

    @property
    def p95_m(self) -> float:
        """95th percentile of the absolute distance, m."""
        return float(np.nanpercentile(np.abs(self.distance_m), 95.0))

    @property
    def estimated(self) -> bool:
        """Whether the estimate did not fail."""
        return bool(np.isfinite(self.measured_force_n).all())

    @property
    def patch_overlap(self) -> float:
        """Intersection over union of both patches; NaN without one, or if the estimate failed."""
        patches = self.predicted_patch, self.measured_patch
        return iou(*patches) if self.estimated and np.any(patches) else float("nan")

    @property
    def failures(self) -> tuple[str, ...]:
        """Reasons why the press does not confirm the calibration; empty if it does."""
        return tuple(text for text, failed in self._findings if failed)

    @property
    def summary(self) -> str:
        """Verdict and reasons in one or two sentences."""
        if self.failures:
            remedy = "Check the pose, the object, the gauge pressure and γ0."
            return f"Known press, poor: {'; '.join(self.failures)}. {remedy}"
        return f"Known press, good: {'; '.join(text for text, _ in self._findings)}."

    @property
    def _findings(self) -> tuple[tuple[str, bool], ...]:
        """Texts, and whether each speaks against the calibration."""
        overlap = self.patch_overlap
        patches = (
            f"predicted and estimated patch overlap by {100 * overlap:.0f} % (at least "
            f"{100 * LEAST_OVERLAP:.0f} % expected)"
        )
        if not self.estimated:
            patches = "the estimate of these frames failed, so that there is no patch to compare"
        elif np.isnan(overlap):
            patches = "neither prediction nor estimate has a contact patch"
        return (
            (
                f"predicted membrane {1e3 * self.rms_m:.2f} mm rms from the measured points, the "
                f"untouched one {1e3 * self.untouched_rms_m:.2f} mm (at most "
                f"{100 * LARGEST_SHARE:.0f} % of the latter expected)",
                self.rms_m > LARGEST_SHARE * self.untouched_rms_m,
            ),
            (patches, not overlap >= LEAST_OVERLAP),
        )


def validate_press(
    model: SensorModel,
    source: FrameSource,
    # obj, pose, pressed: as the user enters them, see `Settings`
    obj: str,
    pose: str,
    pressed: tuple[int, int],
) -> Validation:
    """Predict the press of an object held still and compare it with its frames in a recording.

    Raises InputError, SolveError: as `Validation.of`; no such object or frames, invalid pose.
    """
    if not 0 <= pressed[0] < pressed[1] <= len(source):
        raise InputError(
            f"{source.name}: pressed frames {pressed[0]}:{pressed[1]} are not a range of its"
            f" {count_of(len(source), 'frame')}; choose first before last within 0:{len(source)}"
        )
    frames = [source[k] for k in range(*pressed)]
    return Validation.of(model, frames, load_object(obj), parse_pose(pose))


def mean_frame(frames: Sequence[Frame]) -> Frame:
    """Frame with the mean depth (NaN where most frames have no return) and mean gas pressure."""
    stack = np.stack([frame.depth_m for frame in frames])
    valid = np.isfinite(stack)
    count = valid.sum(axis=0)
    mean = np.sum(stack, axis=0, where=valid, dtype=np.float64) / np.maximum(count, 1)
    gas = [f.gas_pressure_pa for f in frames if f.gas_pressure_pa is not None]
    return replace(
        frames[0],
        depth_m=np.where(2 * count >= len(frames), mean, np.nan).astype(np.float32),
        gas_pressure_pa=float(np.mean(gas)) if len(gas) == len(frames) else None,
    )
