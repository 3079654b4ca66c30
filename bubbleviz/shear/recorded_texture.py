"""Optical flow of a recording's colour images, for the pipeline to make traction of."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bubbleviz.colour.colour_image import readable
from bubbleviz.errors import InputError
from bubbleviz.frames.recording import Recording
from bubbleviz.pipeline import Pipeline
from bubbleviz.shear.texture_flow import TextureFlow, delay_text, flow_camera

if TYPE_CHECKING:
    from bubbleviz.colour.optical_flow import FlowPreset


def recorded_texture(
    recording: Recording, preset: FlowPreset = "fast", colour_delay_s: float = 0.0
) -> TextureFlow:
    """Learn reference and noise from the images before the first contact.

    Raises
    ------
    InputError
        There are no colour images, or too few before the first contact.
    """
    # OpenCV and the learning of rest: only where shear is asked for
    from bubbleviz.calibration.rest.contact_free import LAG, find_contact_free
    from bubbleviz.calibration.rest.depth_statistics import MIN_FRAMES
    from bubbleviz.colour.optical_flow import OpticalFlow

    contact_free = find_contact_free(recording).frames
    times_s = (recording.times_s + colour_delay_s).tolist()
    found = {k: recording.colour_at(times_s[k]) for k in contact_free[:-LAG]}
    seen = readable({k: image for k, image in found.items() if image is not None})
    if len(seen) < MIN_FRAMES:
        raise InputError(
            f"{recording.path}: shear needs {MIN_FRAMES} colour images before the first contact, "
            f"there are {len(seen)}; record a second without contact first, or leave out --shear"
        )
    flow = OpticalFlow.of(seen.values(), preset)
    said = f"contact-free frames {min(seen)}–{max(seen)}{delay_text(colour_delay_s)}"
    granted = "" if recording.colour is None else recording.colour.camera.remark
    return TextureFlow(flow, said, granted)


def watch_recorded_texture(
    pipeline: Pipeline,
    recording: Recording,
    friction: float | None = None,
    preset: FlowPreset = "fast",
) -> str:
    """Have a pipeline make traction by the recording's own colour images; tells which, in words.

    Raises
    ------
    InputError
        As of `recorded_texture`, `flow_camera` and `TextureFlow.watched_by`.
    """
    from bubbleviz.shear.traction_estimator import TractionOptions  # only for shear

    if recording.colour is None:
        raise InputError(f"{recording.path}: has no colour images; leave out --shear")
    options = TractionOptions(friction or None)
    camera = flow_camera(recording.colour.camera, pipeline.camera, str(recording.path))
    texture = recorded_texture(recording, preset, pipeline.model.sensor.camera.colour_delay_s)
    texture.watched_by(pipeline, camera, options)
    return texture.remark
