"""What `bubbleviz study accuracy --edge` shows: how well the patch's edge is found, by noise."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bubbleviz.files.tables import table, write_csv, write_json
from bubbleviz.study.accuracy.accuracy_study import Accuracy, Row
from bubbleviz.study.presses import EDGE_OBJECTS
from bubbleviz.study.report_files import Target, at_least, at_most, target_table

FILES = ("edge.csv", "edge.json", "edge_presses.csv")
_LEAST_IOU = {"0.05 mm": 0.90, "0.15 mm": 0.88, "0.5 mm": 0.83, "1 %": 0.78}
_LARGEST_AREA_ERROR, _LEAST_IN_BAND = 0.04, 0.9
_OWN, _OTHERS = "study's own", "others"


@dataclass(frozen=True)
class Edge:
    """Means over the presses of some objects at one noise.

    Attributes
    ----------
    objects : str
        `study's own`, which no constant was chosen on, `others`, or one object.
    noise : str
    presses : int
        With an answer.
    failed : int
        Those without one.
    iou, iou_worst, area_error_relative, edge_in_band : float
    iou_threshold : float
        Of the depth threshold, blurred or not, that an oracle picks for each object.
    iou_on_mesh : float
        Of the true edge drawn through the mesh's nodes.
    edge_sigma_bound_m, iou_bound_place, iou_bound_shape : float
        See `edge_bound`.
    """

    objects: str
    noise: str
    presses: int
    failed: int
    iou: float
    iou_worst: float
    area_error_relative: float
    edge_in_band: float
    iou_threshold: float
    iou_on_mesh: float
    edge_sigma_bound_m: float
    iou_bound_place: float
    iou_bound_shape: float


def edges(accuracy: Accuracy) -> list[Edge]:
    """Both groups of objects, then each object, by noise."""
    objects = list(dict.fromkeys(row.object_name for row in accuracy.rows))
    groups = {
        _OWN: [name for name in objects if name in EDGE_OBJECTS],
        _OTHERS: [name for name in objects if name not in EDGE_OBJECTS],
    } | {name: [name] for name in objects}
    return [
        _edge(group, noise, rows, accuracy)
        for group, members in groups.items()
        for noise in dict.fromkeys(row.noise for row in accuracy.rows)
        if (rows := [r for r in accuracy.rows if r.noise == noise and r.object_name in members])
    ]


def _edge(name: str, noise: str, rows: list[Row], accuracy: Accuracy) -> Edge:
    answered = [row for row in rows if np.isfinite(row.iou)]
    best = {
        row.object_name: max(
            (
                base.iou
                for base in accuracy.baselines
                if (base.object_name, base.noise) == (row.object_name, noise)
            ),
            default=np.nan,
        )
        for row in rows
    }

    def mean(field: str) -> float:
        values = [getattr(row, field) for row in answered]
        return float(np.mean(values)) if values else np.nan

    return Edge(
        objects=name,
        noise=noise,
        presses=len(answered),
        failed=len(rows) - len(answered),
        iou=mean("iou"),
        iou_worst=min((row.iou for row in answered), default=np.nan),
        area_error_relative=mean("area_error_relative"),
        edge_in_band=mean("edge_in_band"),
        iou_threshold=float(np.mean([best[row.object_name] for row in rows])),
        iou_on_mesh=mean("iou_on_mesh"),
        edge_sigma_bound_m=mean("edge_sigma_bound_m"),
        iou_bound_place=mean("iou_bound_place"),
        iou_bound_shape=mean("iou_bound_shape"),
    )


def targets(accuracy: Accuracy) -> list[Target]:
    """Whether each group of objects meets what the patch is aimed at."""
    found = []
    for edge in edges(accuracy):
        if edge.objects not in (_OWN, _OTHERS) or edge.noise not in _LEAST_IOU:
            continue
        name = f"{edge.objects}, {edge.noise}"
        found += [
            at_least(f"{name}: mean IoU", edge.iou, _LEAST_IOU[edge.noise]),
            at_most(
                f"{name}: |mean area error|", abs(edge.area_error_relative), _LARGEST_AREA_ERROR
            ),
            at_least(f"{name}: true edge in the band", edge.edge_in_band, _LEAST_IN_BAND),
        ]
    return found


def as_dict(accuracy: Accuracy) -> dict[str, Any]:
    """Everything, for JSON."""
    return {
        "edges": [asdict(edge) for edge in edges(accuracy)],
        "targets": [asdict(target) for target in targets(accuracy)],
        "rows": [asdict(row) for row in accuracy.rows],
        "baselines": [asdict(base) for base in accuracy.baselines],
        "omitted": accuracy.omitted,
    }


def to_text(accuracy: Accuracy) -> str:
    """Tables for the terminal."""
    header = (
        "objects", "noise", "presses", "failed", "IoU", "worst", "area err %", "edge in band %",
        "depth threshold", "mesh allows", "bound: place", "and shape", "edge σ ≥ mm",
    )  # fmt: skip
    lines = [
        (
            e.objects, e.noise, str(e.presses), str(e.failed), f"{e.iou:.3f}",
            f"{e.iou_worst:.2f}", f"{100 * e.area_error_relative:+.0f}",
            f"{100 * e.edge_in_band:.0f}", f"{e.iou_threshold:.3f}", f"{e.iou_on_mesh:.3f}",
            f"{e.iou_bound_place:.3f}", f"{e.iou_bound_shape:.3f}",
            f"{1e3 * e.edge_sigma_bound_m:.2f}",
        )
        for e in edges(accuracy)
    ]  # fmt: skip
    parts = ["Edge of the patch on the sensor, of rubber", table(header, lines), ""]
    parts += [target_table(targets(accuracy)), *(f"left out: {each}" for each in accuracy.omitted)]
    return "\n".join(parts)


def write(accuracy: Accuracy, folder: Path) -> list[Path]:
    """Write edge.csv, edge.json and every press; the paths."""
    paths = [folder / name for name in FILES]
    write_csv(paths[0], edges(accuracy))
    write_json(paths[1], as_dict(accuracy))
    write_csv(paths[2], accuracy.rows)
    return paths
