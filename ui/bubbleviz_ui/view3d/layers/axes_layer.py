"""How the bubble frame lies, and how long a length is."""

from __future__ import annotations

from bubbleviz_ui.view3d.layers.layer import Canvas, Layer
from bubbleviz_ui.view3d.scale_bar import ScaleBar
from bubbleviz_ui.view3d.scene_text import write_in

CORNER = 80
"""Side of the corner of the view that the axes take, px."""
TEXT = 13  # px


class AxesLayer(Layer):
    """Axes of B in a corner, and a scale bar beside them."""

    name = "axes"

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._axes = canvas.view.add_axes(interactive=False, xlabel="x", ylabel="y", zlabel="z")
        for caption in (
            self._axes.GetXAxisCaptionActor2D(),
            self._axes.GetYAxisCaptionActor2D(),
            self._axes.GetZAxisCaptionActor2D(),
        ):
            write_in(canvas.view, caption.GetCaptionTextProperty(), TEXT)
            caption.GetTextActor().SetTextScaleModeToNone()
        scale = ScaleBar(canvas.view, canvas.units, left=CORNER)
        self.actors += [self._axes, *scale.actors]
        canvas.view.rendering.connect(self._fit)

    def _fit(self) -> None:
        """Keep the axes their size, however large the picture is."""
        width, height = self.canvas.view.room
        widget = self.canvas.view.renderer.axes_widget
        widget.SetViewport(0.0, 0.0, min(CORNER / width, 1.0), min(CORNER / height, 1.0))
