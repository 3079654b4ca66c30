"""Contact-free reference images of the optical flow; used in the solver thread. No Qt."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bubbleviz.errors import InputError
from bubbleviz.inverse import RUBBER
from bubbleviz.pipeline import FLOW_PRODUCTS, Pipeline, Product
from bubbleviz.recordings import FrameSource, Recording
from bubbleviz.result import Result
from bubbleviz_ui.model.demand import Demand

if TYPE_CHECKING:
    from bubbleviz.shear import PassingTexture


MAX_SEARCHED = 3000
"""Longer recordings are not searched, as that would take minutes."""
NEEDS_RUBBER = "Shear needs the exact membrane; choose the solver rubber in the Contact patch panel"


class ShearReference:
    """Provides the pipeline of one source with the reference images of shear, when requested.

    A recording is searched for contact-free frames; for a long one, and any other source, the
    contact-free frames with colour images are collected while they are processed.
    """

    def __init__(self) -> None:
        self.message = ""  # Description of the reference, or why there is none
        self._begun = False
        self._possible = True
        self._passing: PassingTexture | None = None

    def reset(self) -> None:
        """Search the reference again at the next frame."""
        self._begun = False

    def products(
        self, source: FrameSource, pipeline: Pipeline, demand: Demand
    ) -> frozenset[Product]:
        """Products of a demand that are possible; provides the reference if needed."""
        if not demand.products & FLOW_PRODUCTS:
            return demand.products
        if not self._begun:
            self._begun, self._passing = True, None
            self._begin(source, pipeline)
        return demand.products if self._possible else demand.products - FLOW_PRODUCTS

    def add_frame(self, result: Result) -> None:
        """Use the colour image of a contact-free frame, until there are enough."""
        if self._passing is not None:
            self._passing.take(result)
            self.message = self._passing.words

    def _begin(self, source: FrameSource, pipeline: Pipeline) -> None:
        # slow imports that only shear needs
        from bubbleviz.recordings import find_contact_free
        from bubbleviz.shear import PassingTexture, watch_recorded_texture

        self._possible = pipeline.estimator.solver_name == RUBBER
        if not self._possible:
            self.message = NEEDS_RUBBER
            return
        if not isinstance(source, Recording) or source.colour is None or len(source) > MAX_SEARCHED:
            self._passing = PassingTexture(pipeline)
            return
        pipeline.use_optical_flow(None)
        try:
            self.message = watch_recorded_texture(
                pipeline, source, lambda: find_contact_free(source).frames
            )
        except InputError as error:
            self.message = f"Depth alone: {error}"
