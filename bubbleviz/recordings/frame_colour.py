"""The colour image of a frame, and its mapping to the membrane as a texture."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from bubbleviz.camera import ColourCamera, DepthCamera
from bubbleviz.errors import InputError
from bubbleviz.recordings.frame import Frame


@dataclass(frozen=True)
class FrameColour:
    rgb: np.ndarray | None = None  # (H, W, 3) uint8
    camera: ColourCamera = field(default_factory=ColourCamera)
    reason: str = ""  # why there is no image; empty if there is one

    @classmethod
    def of(cls, frame: Frame) -> FrameColour:
        if frame.find_colour is None:
            return cls(reason=frame.no_colour)
        try:
            found = frame.colour
            if found is None:
                return cls(reason="no colour image at this time")
            return cls(found.rgb(), found.camera)
        except InputError:  # the depth image can be used without it
            return cls(reason="the colour image cannot be read or decoded")

    def aligned(self, depth: DepthCamera) -> bool:
        """Whether its pixels have the same rays as the pixels of the depth image."""
        same = self.camera.intrinsics == depth.intrinsics
        return same and np.array_equal(self.camera.T_D_C, np.eye(4))


@dataclass(frozen=True)
class Texture:
    """A colour image mapped to the deformed membrane."""

    colour: FrameColour
    # (n, 2), position of each node in the image: fractions of the width and of the height, from the
    # upper left corner
    place: np.ndarray
    seen: np.ndarray  # (n,) bool, nodes inside the image
    reason: str = ""  # why there is no texture; empty if there is one

    @classmethod
    def of(cls, colour: FrameColour, nodes_m: np.ndarray, depth: DepthCamera) -> Texture:
        camera = placed(colour.camera, depth)
        if colour.rgb is None or camera is None:
            nothing = np.zeros((len(nodes_m), 2)), np.zeros(len(nodes_m), bool)
            why = colour.reason or "the intrinsics of the colour camera are not known"
            return cls(colour, *nothing, why)
        own, points = camera.intrinsics, camera.local(nodes_m)
        before = points[:, 2] > 0.0
        points[~before] = (0.0, 0.0, 1.0)
        place = (own.project(points) + 0.5) / (own.width, own.height)  # pixel centres are integers
        return cls(colour, place, before & np.all((place >= 0.0) & (place <= 1.0), axis=1))


def placed(colour: ColourCamera, depth: DepthCamera) -> DepthCamera | None:
    """The colour camera in the bubble frame; None where its intrinsics are not known."""
    if colour.intrinsics is None:
        return None
    return DepthCamera(colour.intrinsics, depth.T_B_C @ colour.T_D_C)
