"""Contact-free colour images that flow is measured from, in the solver thread. No Qt in here."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bubbleviz.errors import InputError
from bubbleviz.inverse import RUBBER
from bubbleviz.pipeline import Pipeline, Product
from bubbleviz.recordings import FrameSource, Recording
from bubbleviz.result import Result
from bubbleviz_ui.model.demand import Demand, ShearOptions

if TYPE_CHECKING:
    from bubbleviz.shear import PassingTexture


LONG = 3000
"""Frames beyond which a recording is not searched: the solver would wait for minutes."""
SHEAR: frozenset[Product] = frozenset({"flow", "traction", "slip"})
NO_RUBBER = (
    "Shear needs the exact membrane: choose the solver rubber, or a sensor file with a prestretch"
)


class ShearReference:
    """Gives the pipeline of one source what shear is measured against, once it is asked for.

    Of a recording from its own contact-free frames; of a long one, and of any other source, from
    the frames without contact that pass, where they have colour images.
    """

    def __init__(self) -> None:
        self.words = ""  # What there is, or why there is nothing, in one sentence
        self._options: ShearOptions | None = None
        self._possible = True
        self._passing: PassingTexture | None = None
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
            self._options, self._passing = demand.shear, None
            self._begin(source, pipeline, demand.shear)
        elif index < self._frame:
            pipeline.restart()  # what slipped is told by frames that follow one another
        self._frame = index
        return demand.products if self._possible else demand.products - SHEAR

    def collect(self, result: Result) -> None:
        """Take the colour image of a frame without contact, until there are enough."""
        if self._passing is not None:
            self._passing.take(result)
            self.words = self._passing.words

    def _begin(self, source: FrameSource, pipeline: Pipeline, options: ShearOptions) -> None:
        # what shear needs takes long to load, and nobody else needs it
        from bubbleviz.recordings import find_contact_free
        from bubbleviz.shear import PassingTexture, TractionOptions, watch_recorded_texture

        self._possible = pipeline.estimator.solver_name == RUBBER
        if not self._possible:
            self.words = NO_RUBBER
            return
        if not isinstance(source, Recording) or source.colour is None or len(source) > LONG:
            self._passing = PassingTexture(pipeline, options.friction, options.flow)
            return
        pipeline.use_optical_flow(None, options=TractionOptions(options.friction))
        try:
            self.words = watch_recorded_texture(
                pipeline,
                source,
                lambda: find_contact_free(source).frames,
                options.friction,
                options.flow,
            )
        except InputError as error:
            self.words = f"Depth alone: {error}"
