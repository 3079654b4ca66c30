"""What the window exports: how it is called, and what a name for it ends in. No Qt in here."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Kind:
    """One kind of export.

    Attributes
    ----------
    title, tip : str
        As the window calls it.
    suffixes : dict of str to str
        What the name of its file may end in, by title; empty: a folder of files.
    what : str
        Of `bubbleviz.output.export_plan.KINDS`, for a folder.
    """

    title: str
    tip: str
    suffixes: dict[str, str]
    what: str = ""

    @property
    def is_video(self) -> bool:
        """Pictures of the 3-D view, which only the window can make."""
        return ".mp4" in self.suffixes.values()

    @property
    def filters(self) -> str:
        """What a file dialog offers."""
        return ";;".join(f"{title} (*{suffix})" for title, suffix in self.suffixes.items())

    def named(self, path: Path, chosen_filter: str) -> Path:
        """Path with the filter's suffix where it has none of the kind's."""
        if not self.suffixes or path.suffix.lower() in self.suffixes.values():
            return path
        title = chosen_filter.split(" (")[0]
        suffix = self.suffixes.get(title, next(iter(self.suffixes.values())))
        return path.with_name(path.name + suffix)


KINDS = (
    Kind("Table", "Numbers of each frame, units in the columns' names; with poses where they "
         "were found", {"CSV": ".csv", "Parquet": ".parquet"}),
    Kind("Plots", "Force, gas pressure, patch, residual and times over time, for print",
         {"PNG": ".png", "SVG": ".svg", "PDF": ".pdf"}),
    Kind("ParaView series", "Membrane with displacement and pressure, a VTK file a frame", {},
         "vtk"),
    Kind("Membrane series", "Deformed membrane, a PLY file a frame", {}, "ply"),
    Kind("Patch clouds", "Points of the contact patch with pressure, a PLY file a frame", {},
         "patch"),
    Kind("Depth pictures", "Depth image, a PNG file a frame", {}, "depth"),
    Kind("Pressure pictures", "Contact pressure as the camera sees it, a PNG file a frame", {},
         "pressure"),
    Kind("Video of the view", "The 3-D view as it is now, frame by frame", {"MP4": ".mp4"}),
)  # fmt: skip
"""In the order they are offered."""
