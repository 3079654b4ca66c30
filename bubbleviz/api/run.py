"""What was found in many frames, as arrays, tables and plots."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, overload

import numpy as np

from bubbleviz.api.frame_result import FrameResult
from bubbleviz.errors import InputError
from bubbleviz.export.plot_files import DPI, SIZE_IN, draw_plots
from bubbleviz.export.pose_columns import pose_columns
from bubbleviz.export.table_export import Table, more_columns, table_of
from bubbleviz.files.output_files import whole_file
from bubbleviz.files.pose_writer import PoseRow
from bubbleviz.files.result_writer import COLUMNS, NODAL_FIELDS, result_arrays, summary_row
from bubbleviz.wording import count_of, how_to_install

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


class Run(Sequence[FrameResult]):
    """What was found in the frames of a recording, like a list; depth images are not kept.

    Parameters
    ----------
    results : sequence of FrameResult
        Of one sensor, at least one.
    """

    def __init__(self, results: Sequence[FrameResult]) -> None:
        self._results = results

    def __len__(self) -> int:
        """Count the frames."""
        return len(self._results)

    @overload
    def __getitem__(self, index: int) -> FrameResult: ...
    @overload
    def __getitem__(self, index: slice) -> Run: ...
    def __getitem__(self, index: int | slice) -> FrameResult | Run:
        """What was found in one frame, or in some of them."""
        if isinstance(index, slice):
            return Run(self._results[index])
        return self._results[index]

    @property
    def times_s(self) -> np.ndarray:
        """Time of each frame from the start of the recording, s, (F,)."""
        return np.array([each.time_s for each in self])

    @property
    def status(self) -> np.ndarray:
        """Status of each frame, (F,) texts."""
        return np.array([each.status for each in self])

    @property
    def force_n(self) -> np.ndarray:
        """Force on the membrane in B, (F, 3), N; NaN where it is not to be trusted."""
        return np.array([each.force_n for each in self])

    @property
    def T_B_O(self) -> np.ndarray:
        """Pose of the object in each frame, (F, 4, 4), m; NaN where there is none."""
        return np.array([each.T_B_O for each in self])

    def columns(self) -> dict[str, np.ndarray]:
        """Numbers of each frame by column, (F,) each, units in the names, times in ms."""
        table = self._table()
        table["kappa"] = [np.nan if kappa is None else kappa for kappa in table["kappa"]]
        return {name: np.array(values) for name, values in table.items()}

    def arrays(self) -> dict[str, np.ndarray]:
        """Every array of RESULT.npz but the masks, by the same names: frames, nodes and mesh."""
        return result_arrays([each.result for each in self], self._results[0].model.mesh)

    def table(self) -> pandas.DataFrame:
        """Table of the numbers of each frame, the frame's index as index.

        Raises
        ------
        InputError
            pandas, of the extra `notebook`, is not installed.
        """
        try:
            import pandas  # an extra
        except ImportError as error:
            raise _missing("pandas") from error
        return pandas.DataFrame(self.columns()).set_index("frame")

    def dataset(self) -> xarray.Dataset:
        """Fields of all frames with named dimensions.

        They are `frame`, `node`, `axis`, `bound` of an interval, `triangle` and `corner`.

        Raises
        ------
        InputError
            xarray, of the extra `notebook`, is not installed.
        """
        try:
            import xarray  # an extra
        except ImportError as error:
            raise _missing("xarray") from error
        arrays = self.arrays()
        frame, time = arrays.pop("frame"), arrays.pop("time_s")
        dimensions = _dimensions()
        data = {name: (dimensions[name], array) for name, array in arrays.items()}
        return xarray.Dataset(data, {"frame": frame, "time_s": ("frame", time)})

    def plot(self, path: str | Path | None = None) -> Figure:
        """Plot force, gas pressure, patch, residual and time over the frames; contact is shaded.

        Parameters
        ----------
        path : path, optional
            Write this PNG, SVG or PDF, too.

        Returns
        -------
        Figure
            Notebooks show it; without a path it is of pyplot, so that scripts can by
            `matplotlib.pyplot.show()`.

        Raises
        ------
        InputError
            The file exists.
        """
        figure = _new_figure(shown=path is None or "ipykernel" in sys.modules)
        draw_plots(self._table(), figure)
        if path is not None:
            with whole_file(path) as temporary:
                figure.savefig(temporary, dpi=DPI)
        return figure

    def _table(self) -> Table:
        results = [each.result for each in self]
        summaries = [summary_row(result) for result in results]
        more = [
            more_columns(result, summary)
            | ({} if result.pose is None else pose_columns(asdict(PoseRow.of(result))))
            for result, summary in zip(results, summaries, strict=True)
        ]
        return table_of(summaries, more, self._results[0].model.sensor.name)

    def __repr__(self) -> str:
        names, counts = np.unique(self.status, return_counts=True)
        found = ", ".join(f"{count} {name}" for name, count in zip(names, counts, strict=True))
        return f"<{count_of(len(self), 'frame')}: {found}>"


def _new_figure(shown: bool) -> Figure:
    """Make an empty figure, of pyplot where it is shown."""
    from matplotlib.figure import Figure  # 0.4 s

    if not shown:
        return Figure(figsize=SIZE_IN, layout="constrained")
    from matplotlib import pyplot  # looks for a display

    figure = pyplot.figure(figsize=SIZE_IN, layout="constrained")
    if "inline" in pyplot.get_backend():
        pyplot.close(figure)  # it is the cell's result; pyplot would show it once more
    return figure


def _dimensions() -> dict[str, tuple[str, ...]]:
    """Dimensions of the arrays of RESULT.npz by name."""
    second: dict[int, tuple[str, ...]] = {0: (), 2: ("bound",), 3: ("axis",)}
    frames = {key: ("frame", *second[len(names)]) for key, names in COLUMNS.items()}
    nodal = {
        key: ("frame", "node", "axis") if more else ("frame", "node")
        for key, more in NODAL_FIELDS.items()
    }
    nodes = {"nodes_m": ("node", "axis"), "normals": ("node", "axis"), "rim": ("node",)}
    return {**frames, **nodal, **nodes, "triangles": ("triangle", "corner")}


def _missing(library: str) -> InputError:
    return InputError(f"{library} is not installed; run {how_to_install('notebook')}")
