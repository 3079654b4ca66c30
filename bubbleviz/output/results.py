"""RESULT.npz, written frame by frame with bounded memory, and RESULT.csv."""

from __future__ import annotations

import shutil
import tempfile
import zipfile
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import fields
from pathlib import Path
from typing import IO, Any

import numpy as np

from bubbleviz.membrane import MembraneMesh
from bubbleviz.recordings import Frame, force_of
from bubbleviz.result import Estimate, Patch, Result


def by_axis(*keys: str) -> dict[str, tuple[str, ...]]:
    """Columns of vector components by key: `force_n` has `force_x_n` and so on."""
    parts = {key: key.rpartition("_") for key in keys}
    return {key: tuple(f"{p[0]}_{axis}_{p[2]}" for axis in "xyz") for key, p in parts.items()}


_WRENCH = ("force_n", "force_sigma_n", "torque_nm", "torque_sigma_nm")
"""Keys that exist with the prefix `traction_`, too, as a frame had a second force by colour."""

COLUMNS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("frame", "time_s", "status", "gas_pressure_change_pa", "threshold_pa"), ()),
    **by_axis("force_n", "force_sigma_n", "normal_force_n", "tangential_force_n"),
    **by_axis("torque_nm", "torque_sigma_nm"),
    "measured_force_n": (),
    **by_axis("wrench_n"),
    **by_axis("center_of_pressure_m"),
    "seen_share": (),
    "patch_area_m2": (),
    "patch_area_interval_m2": ("patch_area_low_m2", "patch_area_high_m2"),
    **dict.fromkeys(("gas_pressure_pa", "iterations", "images", "stamp_ns"), ()),
    **dict.fromkeys(("residual_rms_m", "kkt_residual", "solve_ms", "total_ms", "kappa"), ()),
    # only with the products traction and slip:
    **dict.fromkeys(("traction_status", "traction_reason"), ()),
    **by_axis(*(f"traction_{key}" for key in _WRENCH)),
    **dict.fromkeys(("flow_rms_px", "slip", "slip_sigma"), ()),
}
"""Keys of RESULT.npz with one value or a short vector per frame, and their columns in the CSV; an
empty tuple means one column of the same name."""

NODAL_FIELDS: dict[str, tuple[int, ...]] = {
    "displacement_m": (),
    "displacement_3d_m": (3,),
    "contact_pressure_pa": (),
    "patch_level": (),
    "traction_pa": (3,),
    "tangential_displacement_m": (3,),
}
"""Keys of RESULT.npz with values per frame and node, and the shape of a value. The patch is where
`patch_level` is positive; the last two exist only with the product traction."""

_COVARIANCE = "wrench_covariance"
"""Key of RESULT.npz with the covariance of `Estimate`, (F, 6, 6); not in the CSV."""

_OF_SHEAR = ("traction_pa", "tangential_displacement_m")

_TEXTS = ("status", "traction_status", "traction_reason")

_LARGEST = 1e15  # in any unit of the file; larger numbers are damage

_KNOWN_WITHOUT_DATA = {
    *("frame", "time_s", "status", "measured_force_n", "solve_ms", "total_ms", "kappa"),
    *("wrench_n", "gas_pressure_pa", "iterations", "images", "stamp_ns"),
}


def magnitude_half_width_n(estimate: Estimate) -> float:
    """Half of the 95 % interval of |F|, N: 0 without contact, NaN with the solver `paper`."""
    return 0.0 if estimate.status == "no_contact" else estimate.force_half_width_n


def summary_row(result: Result) -> dict[str, Any]:
    """Values of one frame by key of `COLUMNS`, and the covariance of the wrench.

    NaN if unknown, as without trusted estimate. `FrameTable` fills in the measured force, which
    needs the bias of `wrench_n`.
    """
    estimate, patch = result.solution
    sigma, gas_pa = estimate.force_sigma_n, result.frame.gas_pressure_pa
    covariance = estimate.wrench_covariance
    row: dict[str, Any] = {
        "frame": result.frame.index,
        "time_s": result.frame.time_s,
        "status": estimate.status,
        "gas_pressure_change_pa": estimate.gas_pressure_change_pa,
        "threshold_pa": patch.threshold_pa,
        "force_n": patch.force_n,
        "force_sigma_n": np.full(3, np.nan) if sigma is None else sigma,
        "normal_force_n": patch.force_n - np.nan_to_num(patch.tangential_force_n),
        "tangential_force_n": patch.tangential_force_n,
        "torque_nm": patch.torque_nm,
        "torque_sigma_nm": estimate.torque_sigma_about(patch.center_of_pressure_m),
        "measured_force_n": np.nan,
        "wrench_n": force_of(result.frame.wrench),
        "center_of_pressure_m": patch.center_of_pressure_m,
        "seen_share": estimate.seen_share,
        "patch_area_m2": patch.area_m2,
        "patch_area_interval_m2": np.array(patch.area_interval_m2),
        "residual_rms_m": estimate.residual_rms_m,
        "kkt_residual": estimate.kkt_residual,
        "solve_ms": estimate.solve_ms,
        "total_ms": result.times_ms["total"],
        "kappa": np.nan if patch.kappa is None else patch.kappa,
        "gas_pressure_pa": np.nan if gas_pa is None else gas_pa,
        "iterations": estimate.iterations,
        "images": result.frame.images,
        "stamp_ns": result.frame.stamp_ns,
        _COVARIANCE: np.full((6, 6), np.nan) if covariance is None else covariance,
    }
    if not estimate.trusted:
        for key in row.keys() & {*COLUMNS, _COVARIANCE} - _KNOWN_WITHOUT_DATA:
            row[key] = np.full(np.shape(row[key]), np.nan)
    return row | _shear_row(result, row)


def _shear_row(result: Result, row: dict[str, Any]) -> dict[str, Any]:
    """Traction and slip of a frame with this row; empty without the product traction.

    NaN for unknown values, as slip without a sticking patch.
    """
    traction, slip, flow = result.traction, result.slip, result.solution[0].flow
    if traction is None:
        return {}
    return {
        "traction_status": traction.status,
        "traction_reason": traction.reason,
        **{f"traction_{key}": row[key] for key in _WRENCH},
        "flow_rms_px": np.nan if flow is None else flow.rms_px,
        "slip": np.nan if slip is None else slip.share,
        "slip_sigma": np.nan if slip is None else slip.share_sigma,
    }


def nodal_fields(
    result: Result,  # with its estimate and patch
    mesh: MembraneMesh,
) -> dict[str, np.ndarray]:
    """Fields of one frame by key of `NODAL_FIELDS`; NaN without trusted estimate."""
    estimate, patch = result.solution
    fields = {
        "displacement_m": estimate.displacement_m,
        "displacement_3d_m": mesh.deformed(estimate.motion_m) - mesh.nodes,
        "contact_pressure_pa": estimate.contact_pressure_pa,
        "patch_level": patch.level,
    }
    if (traction := result.traction) is not None:
        fields["traction_pa"] = traction.normal_pa + traction.tangential_pa
        fields["tangential_displacement_m"] = traction.tangential_displacement_m
    if not estimate.trusted:
        fields = {name: np.full_like(field, np.nan) for name, field in fields.items()}
    return fields


def result_arrays(
    rows: Sequence[dict[str, Any]],  # of the frames, from `FrameTable`
    results: Sequence[Result],  # with estimates and patches
    mesh: MembraneMesh,
) -> dict[str, np.ndarray]:
    """Arrays of RESULT.npz without the masks."""
    fields = [nodal_fields(result, mesh) for result in results]
    return {
        **_columns(rows),
        **{name: np.array([each[name] for each in fields]) for name in fields[0]},
        **surface_arrays(mesh),
    }


def _columns(rows: Sequence[dict[str, Any]]) -> dict[str, np.ndarray]:
    return {
        key: np.array([row[key] for row in rows])
        for key in (*COLUMNS, _COVARIANCE)
        if key in rows[0]
    }


def surface_arrays(mesh: MembraneMesh) -> dict[str, np.ndarray]:
    """Arrays of the reference surface for RESULT.npz and TRUTH.npz."""
    return {
        "nodes_m": mesh.nodes,
        "normals": mesh.normals,
        "triangles": mesh.triangles,
        "rim": mesh.rim,
    }


def results_of(arrays: dict[str, np.ndarray]) -> list[Result]:
    """Results of the frames in a RESULT.npz, without images, traction and slip.

    Raises ValueError: no frames, or an array of other or impossible values or of another shape.
    """
    frames, nodes = len(arrays["frame"]), len(arrays["nodes_m"])
    # missing in files of earlier versions
    defaults = {"gas_pressure_pa": np.nan, "iterations": 0, "images": 1, "stamp_ns": 0}
    values = {key: np.full(frames, value) for key, value in defaults.items()}
    values |= {"wrench_n": np.full((frames, 3), np.nan)}
    values |= arrays
    shapes: dict[str, tuple[int, ...]] = {
        **{key: (len(names),) if names else () for key, names in COLUMNS.items()},
        **{key: (nodes, *shape) for key, shape in NODAL_FIELDS.items()},
        "patch_mask": values["patch_mask"].shape[1:3],  # any image's
        _COVARIANCE: (6, 6),
    }
    per_frame = values.keys() & shapes
    for key in per_frame:
        kinds = "U" if key in _TEXTS else "biuf"
        expected = (max(frames, 1), *shapes[key])
        if values[key].dtype.kind not in kinds or values[key].shape != expected:
            kind = "text" if kinds == "U" else "numbers"
            found = f"shape {values[key].shape} and type {values[key].dtype}"
            raise ValueError(f"{key} has {found}, not {expected} of {kind}")
        known = values[key][np.isfinite(values[key])] if values[key].dtype.kind == "f" else 0.0
        if (np.abs(known) > _LARGEST).any():
            raise ValueError(f"{key} has numbers beyond ±{_LARGEST:g}")
    return [_result_of({key: values[key][k] for key in per_frame}) for k in range(frames)]


def _result_of(values: dict[str, Any]) -> Result:
    """Result of one frame; most fields have the names of their arrays."""
    optional = {
        key: None if np.isnan(values[key]) else values[key] for key in ("kappa", "gas_pressure_pa")
    }
    if _COVARIANCE not in values:  # as in files of version 0.2
        sigma = np.append(values["force_sigma_n"], np.full(3, np.nan))
        values[_COVARIANCE] = np.diag(sigma**2)
    values |= optional | {
        "index": values["frame"],
        "depth_m": np.empty((0, 0), np.float32),
        "wrench": np.append(values["wrench_n"], np.full(3, np.nan)),
        "level": values["patch_level"],
        "area_m2": values["patch_area_m2"],
        "area_interval_m2": values["patch_area_interval_m2"],
        "pixel_mask": values["patch_mask"],
    }
    parts: list[Any] = [
        kind(**{each.name: values[each.name] for each in fields(kind) if each.name in values})
        for kind in (Frame, Estimate, Patch)
    ]
    frame, estimate, patch = parts
    return Result(frame, estimate, patch, times_ms={"total": values["total_ms"]})


class ResultWriter:
    """Writes RESULT.npz frame by frame.

    The masks of 36,000 frames are 11 GB and the nodal fields 0.6 GB, so neither stays in memory.
    Masks go directly into the archive, nodal fields through unnamed temporary files in the same
    folder (the system's folder for temporary files may be in memory).
    """

    def __init__(
        self,
        path: Path,  # the temporary path of `whole_file`
        mesh: MembraneMesh,
        frames: int,  # F, number of frames that will be added
        shape: tuple[int, int],  # H, W of the masks
        *,
        shear: bool = False,  # whether the results have traction
    ) -> None:
        self._mesh, self._frames = mesh, frames
        self._fields = {k: n for k, n in NODAL_FIELDS.items() if shear or k not in _OF_SHEAR}
        self._stack = ExitStack()
        with ExitStack() as opening:
            archive = zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1)
            self._archive = opening.enter_context(archive)
            self._spools = [
                opening.enter_context(tempfile.TemporaryFile(dir=path.parent)) for _ in self._fields
            ]
            # An archive has one member open at a time: the largest, the masks.
            self._masks = opening.enter_context(
                self._member("patch_mask", (frames, *shape), np.dtype(bool))
            )
            self._stack = opening.pop_all()

    def __enter__(self) -> ResultWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def add(self, result: Result) -> None:
        """Add the next frame, with its estimate, patch and pixel mask."""
        _, patch = result.solution
        if patch.pixel_mask is None:
            raise ValueError("the result lacks the product pixel_mask")
        self._masks.write(np.ascontiguousarray(patch.pixel_mask).tobytes())
        fields = nodal_fields(result, self._mesh)
        for spool, name in zip(self._spools, self._fields, strict=True):
            spool.write(np.ascontiguousarray(fields[name], dtype="<f8").tobytes())

    def finish(self, rows: Sequence[dict[str, Any]], **provenance: str) -> None:
        """Write the remaining arrays: nodal fields, rows of the frames, and provenance texts."""
        self._masks.close()
        nodal = (self._frames, len(self._mesh.nodes))
        for (name, more), spool in zip(self._fields.items(), self._spools, strict=True):
            spool.seek(0)
            with self._member(name, nodal + more, np.dtype("<f8")) as member:
                shutil.copyfileobj(spool, member, 1 << 20)
        texts = {key: np.array(text) for key, text in provenance.items()}
        small = {**_columns(rows), **surface_arrays(self._mesh), **texts}
        for name, array in small.items():
            with self._member(name, array.shape, array.dtype) as member:
                member.write(np.ascontiguousarray(array).tobytes())

    def _member(self, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> IO[bytes]:
        """Open an array of the archive for writing, after its header."""
        member = self._archive.open(f"{name}.npy", "w", force_zip64=True)
        header = {
            "descr": np.lib.format.dtype_to_descr(dtype),
            "fortran_order": False,
            "shape": shape,
        }
        np.lib.format.write_array_header_1_0(member, header)
        return member


def csv_row(row: dict[str, Any], sensor: str) -> dict[str, Any]:
    """Values of a row by column of the CSV, the sensor's name last; `kappa` None: automatic."""
    plain: dict[str, Any] = {}
    for key, names in COLUMNS.items():
        if key in row:
            plain |= dict(zip(names or (key,), np.atleast_1d(row[key]).tolist(), strict=True))
    kappa = None if np.isnan(row["kappa"]) else plain["kappa"]
    return plain | {"kappa": kappa, "sensor": sensor}
