"""Contact-free colour images that flow is measured from, in the solver thread. No Qt in here."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bubbleviz.errors import InputError
from bubbleviz.frames.frame_source import FrameSource
from bubbleviz.frames.recording import Recording
from bubbleviz.inverse.rubber_estimator import RubberEstimator
from bubbleviz.pipeline import Pipeline, Product
from bubbleviz.result import Result
from bubbleviz_ui.model.demand import Demand, ShearOptions

if TYPE_CHECKING:
    import numpy as np

    from bubbleviz.colour.colour_image import ColourCamera

COLLECTED = 15
"""Images that are collected of frames that pass: half a second at 30 Hz."""
LONG = 3000
"""Frames beyond which a recording is not searched: the solver would wait for minutes."""
SHEAR: frozenset[Product] = frozenset({"flow", "traction", "slip"})
NO_RUBBER = (
    "Shear takes the exact membrane: choose the solver rubber, or a sensor file with its prestretch"
)


class ShearReference:
    """Gives the pipeline of one source what shear is measured against, once it is asked for.

    Of a recording from its own contact-free frames; of a long one, and of any other source, from
    the frames without contact that pass.

    Attributes
    ----------
    words : str
        What there is, or why there is nothing, in one sentence.
    """

    def __init__(self) -> None:
        self.words = ""
        self._options: ShearOptions | None = None
        self._possible = True
        self._images: dict[int, np.ndarray] | None = None  # while they are collected
        self._frame = 0

    def forget(self) -> None:
        """Find the reference anew for the next frame."""
        self._options = None

    def products(
        self, source: FrameSource, pipeline: Pipeline, index: int, demand: Demand
    ) -> frozenset[Product]:
        """What of a demand can be made of a frame; sees to the reference where that needs one."""
        if not demand.products & SHEAR:
            return demand.products
        if demand.shear != self._options:
            self._options, self._images = demand.shear, None
            self._begin(source, pipeline, demand.shear)
        elif index < self._frame:
            pipeline.restart()  # what slipped is told by frames that follow one another
        self._frame = index
        return demand.products if self._possible else demand.products - SHEAR

    def collect(self, pipeline: Pipeline, result: Result) -> None:
        """Take the colour image of a frame without contact, until there are enough."""
        images, estimate, options = self._images, result.estimate, self._options
        if images is None or options is None or estimate is None:
            return
        if result.frame.find_colour is None:
            self.words = f"Depth alone: {result.frame.no_colour}"
            return
        colour = result.frame.colour if estimate.status == "no_contact" else None
        if colour is not None:
            try:
                grey = colour.grey()
            except InputError as error:
                self.words = str(error)
                return
            if any(grey.shape != other.shape for other in images.values()):
                images.clear()  # another camera mode
            images[result.frame.index] = grey
        self.words = f"Collecting images without contact: {len(images)} of {COLLECTED}"
        if colour is not None and len(images) >= COLLECTED:
            self._learn(pipeline, colour.camera, options)

    def _begin(self, source: FrameSource, pipeline: Pipeline, options: ShearOptions) -> None:
        # what shear needs takes long to load, and nobody else needs it
        from bubbleviz.shear.recorded_texture import watch_recorded_texture
        from bubbleviz.shear.traction_estimator import TractionOptions

        self._possible = isinstance(pipeline.estimator, RubberEstimator)
        if not self._possible:
            self.words = NO_RUBBER
            return
        pipeline.watch_texture(None, options=TractionOptions(options.friction))
        if not isinstance(source, Recording) or len(source) > LONG:
            self._images = {}
            return
        try:
            self.words = watch_recorded_texture(pipeline, source, options.friction, options.flow)
        except InputError as error:
            self.words = f"Depth alone: {error}"

    def _learn(self, pipeline: Pipeline, colour: ColourCamera, options: ShearOptions) -> None:
        from bubbleviz.colour.optical_flow import OpticalFlow  # OpenCV, for shear alone
        from bubbleviz.shear.texture_flow import TextureFlow, flow_camera
        from bubbleviz.shear.traction_estimator import TractionOptions

        images, self._images = self._images or {}, None
        count = len(images)
        said = f"{count} images without contact; the lag of colour behind depth is not known"
        try:
            camera = flow_camera(colour, pipeline.camera, "colour camera")
            flow = OpticalFlow.of(images.values(), options.flow)
            texture = TextureFlow(flow, learned_from=said, granted=colour.remark)
            texture.watched_by(pipeline, camera, TractionOptions(options.friction))
        except InputError as error:
            self.words = f"Depth alone: {error}"
            return
        self.words = texture.remark
