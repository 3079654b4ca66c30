"""Optical flow of frames from contact-free colour images, for a pipeline to make traction of."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bubbleviz.camera.depth_camera import DepthCamera
from bubbleviz.colour.colour_image import ColourCamera
from bubbleviz.colour.seen_colour import placed
from bubbleviz.errors import InputError
from bubbleviz.frames.frame import Frame
from bubbleviz.pipeline import Pipeline

if TYPE_CHECKING:
    from bubbleviz.colour.optical_flow import FlowField, OpticalFlow
    from bubbleviz.shear.traction_estimator import TractionOptions


class TextureFlow:
    """Flow of the colour image of a frame.

    Parameters
    ----------
    flow : OpticalFlow
    learned_from, granted : str, optional
        What it was learned from, and `ColourCamera.remark`.

    Attributes
    ----------
    remark : str
        Both in one line; or why it is of no use.
    """

    def __init__(self, flow: OpticalFlow, learned_from: str = "", granted: str = "") -> None:
        self._flow = flow
        camera = f"colour camera: {granted}" if granted else ""
        self.remark = flow.problem or "; ".join(filter(None, (learned_from, camera)))

    def __call__(self, frame: Frame) -> FlowField | None:
        """Flow of a frame; None where there is no image of its moment.

        Empty, with the reason, where the image cannot be read or is of another size.
        """
        try:
            colour = frame.colour
            return None if colour is None else self._flow.measure(colour.grey())
        except InputError as error:
            return self._flow.nothing(str(error))

    def watched_by(self, pipeline: Pipeline, camera: DepthCamera, options: TractionOptions) -> None:
        """Have a pipeline make traction by it.

        Raises
        ------
        InputError
            The camera does not see the membrane, or the estimator is not of the exact membrane;
            the pipeline then goes on by depth alone.
        """
        pipeline.watch_texture(self, camera, options)
        try:
            pipeline.prepare(frozenset({"traction"}))
        except InputError:
            pipeline.watch_texture(None, options=options)
            raise


def delay_text(delay_s: float) -> str:
    """How colour and depth are paired where that is not by equal stamps, to add to a sentence."""
    return f", colour delay {delay_s:+.3f} s" if delay_s else ""


def flow_camera(colour: ColourCamera, depth: DepthCamera, name: str) -> DepthCamera:
    """The camera whose images flow is of, in the bubble frame.

    Raises
    ------
    InputError
        Where its pixels look is not known; `name` tells whose it is.
    """
    camera = placed(colour, depth)
    if camera is None:
        raise InputError(
            f"{name}: no camera info of the colour images' size, so that their flow tells nothing "
            "of the membrane; record or publish it with them"
        )
    return camera
