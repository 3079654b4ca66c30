"""A LeRobot dataset (v3.0) of a recording: one episode with force, σ, patch, node forces, slip.

In the format of Hugging Face's `lerobot`: `meta/info.json` describes the columns of
`data/…/file-000.parquet`, with one row per frame. Its `aggregate_datasets` joins several datasets.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from bubbleviz.files import write_json
from bubbleviz.output.exporter import Exporter
from bubbleviz.output.results import summary_row
from bubbleviz.output.table_export import require_parquet
from bubbleviz.pipeline import Product
from bubbleviz.recordings import usual_step
from bubbleviz.result import Result
from bubbleviz.sensor_model import SensorModel

_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_FIRST = "chunk-000/file-000.parquet"
_TASK = "contact with a Soft-bubble sensor"
_WRENCH = ("force_x_n", "force_y_n", "force_z_n", "torque_x_nm", "torque_y_nm", "torque_z_nm")
_COUNTS = ("frame_index", "episode_index", "index", "task_index")
_SLIP = ("slip", "slip_sigma")  # only where shear was asked for
_FPS = 30
"""Frames per second written for a recording of a single frame."""


class LeRobotDataset(Exporter):
    products: frozenset[Product] = frozenset({"estimate", "patch"})

    def __init__(self, folder: Path, name: str, model: SensorModel) -> None:
        require_parquet(folder)
        self._folder, self._model = folder, model
        self._rows: list[dict[str, Any]] = []

    def add(self, result: Result) -> None:
        row, estimate = summary_row(result), result.trusted_estimate
        nodes, torque_nm = np.full(3 * len(self._model.mesh.nodes), np.nan), row["torque_nm"]
        if estimate is not None:
            torque_nm = np.nan_to_num(torque_nm)  # NaN without contact, where it is 0
        if estimate is not None and estimate.nodal_force_n is not None:
            nodes = estimate.nodal_force_n.ravel()
        self._rows.append(
            {
                "observation.wrench": np.concatenate([row["force_n"], torque_nm]),
                "observation.force_sigma_n": row["force_sigma_n"],
                "observation.patch_area_m2": row["patch_area_m2"],
                "observation.gas_pressure_pa": row["gas_pressure_pa"],
                "observation.node_forces_n": nodes,
                "observation.trusted": estimate is not None,
                **{f"observation.{key}": row[key] for key in _SLIP if key in row},
                "timestamp": row["time_s"],
            }
        )

    def finish(self) -> None:
        columns, frames = self._columns(), len(self._rows)
        stats = {name: _stats(values) for name, values in columns.items()}
        features = {name: _feature(name, values) for name, values in columns.items()}
        step_s = usual_step(np.diff(columns["timestamp"]))
        info = {
            "codebase_version": "v3.0",
            "robot_type": self._model.sensor.name,
            "total_episodes": 1,
            "total_frames": frames,
            "total_tasks": 1,
            "chunks_size": 1000,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 500,
            "fps": _FPS if step_s is None else max(1, round(1.0 / step_s)),
            "splits": {"train": "0:1"},
            "data_path": f"data/{_FILE}",
            "video_path": None,
            "features": features,
        }
        for folder in ("data/chunk-000", "meta/episodes/chunk-000"):
            (self._folder / folder).mkdir(parents=True)
        write_json(self._folder / "meta/info.json", info)
        write_json(self._folder / "meta/stats.json", stats)
        self._write_tables(columns, stats, frames)

    def _columns(self) -> dict[str, np.ndarray]:
        """Values of all frames (F, …) by column, in their stored types."""
        columns = {
            name: np.array([row[name] for row in self._rows], bool if "trusted" in name else "f4")
            for name in self._rows[0]
        }
        columns["timestamp"] -= columns["timestamp"][0]
        count = np.arange(len(self._rows))
        numbers = zip(_COUNTS, (count, 0 * count, count, 0 * count), strict=True)
        return columns | dict(numbers)

    def _write_tables(
        self, columns: dict[str, np.ndarray], stats: dict[str, dict[str, Any]], frames: int
    ) -> None:
        import pyarrow  # an optional extra, see `require_parquet`
        from pyarrow.parquet import write_table

        data = pyarrow.table({name: _stored(values) for name, values in columns.items()})
        write_table(data, self._folder / "data" / _FIRST)
        episode_stats = {
            f"stats/{name}/{key}": [value]
            for name, own in stats.items()
            for key, value in own.items()
        }
        episode = {
            "episode_index": [0],
            "tasks": [[_TASK]],
            "length": [frames],
            "dataset_from_index": [0],
            "dataset_to_index": [frames],
            "data/chunk_index": [0],
            "data/file_index": [0],
            "meta/episodes/chunk_index": [0],
            "meta/episodes/file_index": [0],
        }
        episodes = pyarrow.table({**episode, **episode_stats})
        write_table(episodes, self._folder / "meta/episodes" / _FIRST)
        tasks = pyarrow.table({"task_index": [0], "task": [_TASK]})
        write_table(_indexed(tasks, "task"), self._folder / "meta/tasks.parquet")


def _feature(name: str, values: np.ndarray) -> dict[str, Any]:
    """Description of a column for `info.json`."""
    dtype = "bool" if values.dtype == bool else "int64" if name in _COUNTS else "float32"
    names = list(_WRENCH) if name == "observation.wrench" else None
    return {"dtype": dtype, "shape": list(values.shape[1:]) or [1], "names": names}


def _stats(values: np.ndarray) -> dict[str, Any]:
    """Statistics over frames with finite values; 0 if there are none, as JSON has no NaN."""
    rows = values.reshape(len(values), -1).astype(float)
    known = rows[np.isfinite(rows).all(axis=1)]
    rows = known if len(known) else np.zeros((1, rows.shape[1]))
    found = {"min": rows.min(0), "max": rows.max(0), "mean": rows.mean(0), "std": rows.std(0)}
    return {**{name: each.tolist() for name, each in found.items()}, "count": [len(known)]}


def _stored(values: np.ndarray) -> Any:
    """A Parquet column of numbers, or of lists of equal length."""
    import pyarrow  # an optional extra, see `require_parquet`

    if values.ndim == 1:
        return pyarrow.array(values)
    return pyarrow.FixedSizeListArray.from_arrays(values.ravel(), values.shape[1])


def _indexed(table: Any, index: str) -> Any:
    """A table with metadata so that pandas uses one of its text columns as the index."""
    kinds = {"task_index": ("int64", "int64"), index: ("unicode", "object")}
    columns = [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": of, "metadata": None}
        for name, (kind, of) in kinds.items()
    ]
    metadata = {"index_columns": [index], "column_indexes": [], "columns": columns}
    return table.replace_schema_metadata({"pandas": json.dumps(metadata)})
