"""Export plan: kinds of files and their paths, checked before the export starts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from bubbleviz.errors import InputError
from bubbleviz.files import refuse_existing
from bubbleviz.output.exporter import Exporter
from bubbleviz.output.lerobot import LeRobotDataset
from bubbleviz.output.series import SERIES
from bubbleviz.output.table_export import (
    TableExporter,
    require_parquet,
    write_csv,
    write_parquet,
    write_plots,
)
from bubbleviz.pipeline import Pipeline

_FILES: dict[str, tuple[str, Callable[..., Any]]] = {
    ".csv": ("table", write_csv),
    ".parquet": ("parquet", write_parquet),
    ".png": ("plots", write_plots),
    ".svg": ("plots", write_plots),
    ".pdf": ("plots", write_plots),
}
"""Kind and writer of single-file exports, by suffix."""

_SINGLE_FILE = {"table": ".csv", "parquet": ".parquet", "plots": ".png"}
"""Default suffix of single-file exports, by kind."""

_SERIES_SUFFIXES = (".pvd", ".vtp", ".vtk", ".ply")
_FILES_IN_A_FOLDER: dict[str, Callable[..., Exporter]] = {"lerobot": LeRobotDataset, **SERIES}
KINDS = (*_SINGLE_FILE, *_FILES_IN_A_FOLDER)
_GROUPS = {"png": ("depth", "pressure")}
"""Names that stand for several kinds."""


@dataclass(frozen=True)
class ExportPlan:
    out: Path  # a file, or a folder for all files
    kinds: tuple[str, ...]  # of `KINDS`
    is_folder: bool
    # pose columns for the table by frame index, see `read_poses`
    poses: dict[int, dict[str, Any]] = field(default_factory=dict)
    overwrite: bool = False

    @classmethod
    def of(
        cls,
        out: str | Path,
        what: Sequence[str] = (),
        poses: dict[int, dict[str, Any]] | None = None,
        *,
        overwrite: bool = False,
    ) -> ExportPlan:
        """Plan for an output path, whose suffix determines the kind of a single file.

        Raises InputError: an unknown kind, one that does not match the suffix, or `out` exists.
        """
        out, kinds = Path(out), _kinds(what)
        refuse_existing(out, overwrite=overwrite)
        plan = cls(out, kinds, True, poses or {}, overwrite)
        if out.suffix.lower() in _FILES:
            kind = _FILES[out.suffix.lower()][0]
            if kinds not in ((), (kind,)):
                raise InputError(
                    f"{out}: a {out.suffix} file holds {kind}, not {', '.join(kinds)}; give a "
                    "name without suffix for a folder"
                )
            plan = replace(plan, kinds=(kind,), is_folder=False)
        elif out.suffix.lower() == ".mp4":
            raise InputError(
                f"{out}: videos are exported from the window; open the recording there"
            )
        elif out.suffix.lower() in _SERIES_SUFFIXES:
            raise InputError(f"{out}: a series of files needs a folder; give a name without suffix")
        elif not kinds:
            raise InputError(
                f"{out}: nothing to export was chosen; give a file that ends in .csv, .parquet, "
                f".png, .svg or .pdf, or --what: {', '.join(KINDS)}"
            )
        if "parquet" in plan.kinds or "lerobot" in plan.kinds:
            require_parquet(out)
        return plan

    def exporters(
        self,
        pipeline: Pipeline,  # source of the results
        at: Path,  # temporary path of `out`; an existing folder if it is one
        wrench_bias_n: np.ndarray | None = None,  # of tables, as of `FrameTable`
    ) -> list[Exporter]:
        """One exporter for each kind; files in a folder have its name."""
        if not self.is_folder:
            return [self._one_file(at, pipeline, wrench_bias_n)]
        name = self.out.name
        exporters: list[Exporter] = []
        for kind in self.kinds:
            if kind in _SINGLE_FILE:
                path = at / f"{name}{_SINGLE_FILE[kind]}"
                exporters.append(self._one_file(path, pipeline, wrench_bias_n))
            else:
                exporters.append(_FILES_IN_A_FOLDER[kind](at, name, pipeline.model))
        return exporters

    @property
    def has_table(self) -> bool:
        """Whether a table or its plots are among the files."""
        return bool({*self.kinds} & {*_SINGLE_FILE})

    def _one_file(
        self, path: Path, pipeline: Pipeline, wrench_bias_n: np.ndarray | None
    ) -> Exporter:
        write, sensor = _FILES[path.suffix.lower()][1], pipeline.model.sensor.name
        return TableExporter(path, write, sensor, self.poses, wrench_bias_n)


def _kinds(what: Sequence[str]) -> tuple[str, ...]:
    """Requested kinds without duplicates, in the order of `KINDS`."""
    requested = {kind for word in what for kind in _GROUPS.get(word, (word,))}
    for kind in sorted(requested - set(KINDS)):
        raise InputError(f'--what "{kind}": unknown; choose from {", ".join((*KINDS, *_GROUPS))}')
    return tuple(kind for kind in KINDS if kind in requested)
