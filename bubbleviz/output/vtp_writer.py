"""VTK XML poly data (.vtp) and the two indices of a series of them, written without VTK.

By hand because VTK comes with the window's extra only and its objects belong to the window's
thread; meshio and trimesh do not write .vtp.
"""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

_TYPES = {"<f8": "Float64", "<f4": "Float32", "<i8": "Int64", "<i4": "Int32", "|u1": "UInt8"}


def write_vtp(
    path: Path,
    points: np.ndarray,
    triangles: np.ndarray,
    fields: Mapping[str, np.ndarray],
    time_s: float,
) -> None:
    """Triangle mesh with nodal fields.

    Parameters
    ----------
    path : Path
    points : (n, 3) array
    triangles : (m, 3) int array
    fields : mapping of (n,) or (n, 3) array
    time_s : float
        What ParaView shows as time.
    """
    count = len(triangles)
    lines = [
        '<?xml version="1.0"?>',
        '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">',
        "<PolyData>",
        f"<FieldData>{_array('TimeValue', np.array([time_s]), 'NumberOfTuples')}</FieldData>",
        f'<Piece NumberOfPoints="{len(points)}" NumberOfPolys="{count}">',
        f"<Points>{_array('Points', points)}</Points>",
        "<Polys>",
        _array("connectivity", triangles.astype("<i8").ravel()),
        _array("offsets", 3 * np.arange(1, count + 1, dtype="<i8")),
        "</Polys>",
        "<PointData>",
        *(_array(name, values) for name, values in fields.items()),
        "</PointData>",
        "</Piece></PolyData></VTKFile>",
    ]
    path.write_text("\n".join(lines), encoding="ascii")


def write_pvd(path: Path, names: Sequence[str], times_s: Sequence[float]) -> None:
    """ParaView's own index of a series (.pvd)."""
    sets = "".join(
        f"<DataSet timestep={quoteattr(f'{time!r}')} file={quoteattr(name)}/>\n"
        for name, time in zip(names, times_s, strict=True)
    )
    path.write_text(
        f'<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n<Collection>\n{sets}'
        "</Collection>\n</VTKFile>\n",
        encoding="utf-8",
    )


def write_series(path: Path, names: Sequence[str], times_s: Sequence[float]) -> None:
    """The JSON index of a series (.vtp.series), for programs that do not read .pvd."""
    files = [{"name": name, "time": time} for name, time in zip(names, times_s, strict=True)]
    text = json.dumps({"file-series-version": "1.0", "files": files}, indent=1)
    path.write_text(text + "\n", encoding="utf-8")


def _array(name: str, values: np.ndarray, count: str = "") -> str:
    """A DataArray element, its bytes after their count in base64."""
    values = np.ascontiguousarray(values)
    raw = values.tobytes()
    data = base64.b64encode(struct.pack("<Q", len(raw)) + raw).decode()
    components = f' NumberOfComponents="{values.shape[1]}"' if values.ndim == 2 else ""
    tuples = f' {count}="{len(values)}"' if count else ""
    kind = _TYPES[values.dtype.str]
    return (
        f'<DataArray type="{kind}" Name={quoteattr(name)}{components}{tuples} format="binary">'
        f"{data}</DataArray>"
    )
