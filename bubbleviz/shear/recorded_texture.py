"""Optical flow of a recording's colour images, for the pipeline to make traction of."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bubbleviz.camera.depth_camera import DepthCamera
from bubbleviz.errors import InputError
from bubbleviz.frames.frame import Frame
from bubbleviz.frames.recording import Recording
from bubbleviz.pipeline import Pipeline

if TYPE_CHECKING:
    from bubbleviz.colour.optical_flow import FlowField, FlowPreset, OpticalFlow


class RecordedTexture:
    """Flow of the frames of a recording from its contact-free colour images.

    Parameters
    ----------
    flow : OpticalFlow
    lag_s : float
        Of colour behind depth, s.
    remark : str
        What it was learned from, in one clause, or why it is of no use.
    """

    def __init__(self, flow: OpticalFlow, lag_s: float, remark: str = "") -> None:
        self._flow, self._lag_s = flow, lag_s
        self.remark = remark

    def __call__(self, frame: Frame) -> FlowField | None:
        """Flow of the colour image of a frame's moment; None where there is none."""
        colour = frame.colour_after(self._lag_s)
        return None if colour is None else self._flow.measure(colour.grey())

    @classmethod
    def of(cls, recording: Recording, preset: FlowPreset = "balanced") -> RecordedTexture:
        """Learn reference, noise and lag from the images before the first contact.

        Raises
        ------
        InputError
            There are no colour images, too few before the first contact, or no lag can be told.
        """
        # OpenCV and the learning of rest: only where shear is asked for
        from bubbleviz.calibration.rest.contact_free import LAG, find_contact_free
        from bubbleviz.colour.optical_flow import OpticalFlow
        from bubbleviz.colour.temporal_lag import temporal_lag

        contact_free = find_contact_free(recording).frames
        lag = temporal_lag(recording, contact_free=contact_free)
        times_s = recording.times_s.tolist()
        found = {k: recording.colour_at(times_s[k]) for k in contact_free[:-LAG]}
        seen = {k: image for k, image in found.items() if image is not None}
        flow = OpticalFlow.of([image.grey() for image in seen.values()], preset)
        remark = flow.problem or f"contact-free frames {min(seen)}–{max(seen)}; {lag.to_text()}"
        return cls(flow, lag.lag_s, remark)


def watch_recorded_texture(
    pipeline: Pipeline,
    recording: Recording,
    friction: float | None = None,
    preset: FlowPreset = "balanced",
) -> str:
    """Have a pipeline make traction by the recording's own colour images; tells which, in words.

    Raises
    ------
    InputError
        As of `RecordedTexture.of`, or the estimator is not of the exact membrane.
    """
    from bubbleviz.shear.traction_estimator import TractionOptions  # only for shear

    if recording.colour is None:
        raise InputError(f"{recording.path}: has no colour images; leave out --shear")
    own, depth = recording.colour.camera, pipeline.camera
    intrinsics = own.intrinsics or depth.intrinsics
    camera = DepthCamera(intrinsics, depth.T_B_C @ own.T_D_C)
    options = TractionOptions(friction)
    texture = RecordedTexture.of(recording, preset)
    pipeline.watch_texture(texture, camera, options)
    pipeline.prepare(frozenset({"traction"}))
    return texture.remark
