"""File series, one file per frame: membrane (VTK, PLY), patch points, pictures."""

from __future__ import annotations

import base64
import struct
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from bubbleviz.camera import MembraneView
from bubbleviz.files import write_json, write_ply
from bubbleviz.output.exporter import Exporter, Shape
from bubbleviz.pipeline import Product
from bubbleviz.recordings import Frame
from bubbleviz.result import Estimate, Result
from bubbleviz.sensor_model import SensorModel

# VTK XML poly data (.vtp) and the index file of a series, written without VTK: VTK is only
# installed with the window, whose thread owns its objects; meshio and trimesh do not write .vtp.


_TYPES = {"<f8": "Float64", "<f4": "Float32", "<i8": "Int64", "<i4": "Int32", "|u1": "UInt8"}


def write_vtp(
    path: Path,
    points: np.ndarray,  # (n, 3)
    triangles: np.ndarray,  # (m, 3) int
    fields: Mapping[str, np.ndarray],  # mapping of (n,) or (n, 3) array
    time_s: float,  # time in ParaView
) -> None:
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
    sets = "".join(
        f"<DataSet timestep={quoteattr(f'{time!r}')} file={quoteattr(name)}/>\n"
        for name, time in zip(names, times_s, strict=True)
    )
    path.write_text(
        f'<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n<Collection>\n{sets}'
        "</Collection>\n</VTKFile>\n",
        encoding="utf-8",
    )


def _array(name: str, values: np.ndarray, count: str = "") -> str:
    """A DataArray element, with the size and bytes of the values in base64."""
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


COLOURS, UNKNOWN_COLOUR = "viridis", "#28282c"
"""Perceptually uniform (Smith and van der Walt, 2015), and dark for NaN."""
HIGHEST_PRESSURE = 4.0
"""Upper end of the colour scale in gauge pressures: a flat contact has about one, an edge more."""


class Series(Exporter):
    """Writes NAME_KIND_000012.SUFFIX into a folder for each frame of a sensor."""

    kind = ""

    def __init__(self, folder: Path, name: str, model: SensorModel) -> None:
        self.folder, self.model = folder, model
        self.name = f"{name}_{self.kind}" if self.kind else name

    def path(self, result: Result, suffix: str) -> Path:
        return self.folder / f"{self.name}_{result.frame.index:06d}{suffix}"


class VtkSeries(Series):
    """The membrane as .vtp, and the index file NAME.pvd.

    Nodal fields: `displacement_m`, `displacement_vector_m` (from the reference surface),
    `contact_pressure_pa`, and `patch`, 1 inside.
    """

    products: frozenset[Product] = frozenset({"estimate", "patch"})

    def __init__(self, folder: Path, name: str, model: SensorModel) -> None:
        super().__init__(folder, name, model)
        self._names: list[str] = []
        self._times: list[float] = []

    def add(self, result: Result) -> None:
        _, patch = result.solution
        mesh, path, time_s = self.model.mesh, self.path(result, ".vtp"), result.frame.time_s
        shape = Shape.of(mesh, result)
        fields = {
            "displacement_m": shape.displacement_m,
            "displacement_vector_m": shape.points_m - mesh.nodes,
            "contact_pressure_pa": shape.contact_pressure_pa,
            "patch": patch.node_mask.astype(np.uint8),
        }
        write_vtp(path, shape.points_m, mesh.triangles, fields, time_s)
        self._names.append(path.name)
        self._times.append(time_s)

    def finish(self) -> None:
        write_pvd(self.folder / f"{self.name}.pvd", self._names, self._times)


class MembranePly(Series):
    """The membrane as .ply, with displacement and contact pressure."""

    kind = "membrane"
    products: frozenset[Product] = frozenset({"estimate"})

    def add(self, result: Result) -> None:
        shape = Shape.of(self.model.mesh, result)
        values = {
            "displacement_m": shape.displacement_m,
            "contact_pressure_pa": shape.contact_pressure_pa,
        }
        triangles, comment = self.model.mesh.triangles, _comment(result.frame)
        write_ply(self.path(result, ".ply"), shape.points_m, values, triangles, comment)


class PatchPly(Series):
    """Measured points in the patch as .ply, with pressure; an empty file without a patch."""

    kind = "patch"
    products: frozenset[Product] = frozenset({"estimate", "patch", "pixel_mask", "cloud"})

    def add(self, result: Result) -> None:
        points, pressure = self._patch(result)
        values = {"contact_pressure_pa": pressure}
        write_ply(self.path(result, ".ply"), points, values, comment=_comment(result.frame))

    def _patch(self, result: Result) -> tuple[np.ndarray, np.ndarray]:
        estimate, patch = result.solution
        cloud, pixels = result.cloud_m, result.cloud_pixels
        if patch.pixel_mask is None or cloud is None or pixels is None:
            raise ValueError("the result lacks the products pixel_mask and cloud")
        inside = patch.pixel_mask.ravel()[pixels]
        if not estimate.trusted or not inside.any():
            return np.empty((0, 3)), np.empty(0)
        return cloud[inside], pressure_at(self.model.view, estimate, pixels[inside])


class Pictures(Series):
    """One image per frame as .png, and NAME_KIND.json with the colour scale.

    The scale depends on the sensor alone, so that pictures of one sensor can be compared.
    """

    quantity = ""

    @abstractmethod
    def image(self, result: Result) -> np.ndarray:
        """Values of the pixels, (H, W); NaN where unknown."""

    @abstractmethod
    def range(self) -> tuple[float, float]:
        """Values of the darkest and the brightest colour."""

    def add(self, result: Result) -> None:
        from matplotlib import colormaps  # only where pictures are written
        from PIL import Image

        low, high = self.range()
        scaled = (self.image(result) - low) / (high - low)
        colours = colormaps[COLOURS].with_extremes(bad=UNKNOWN_COLOUR)(scaled)
        picture = Image.fromarray((255.0 * colours[..., :3]).astype(np.uint8))
        picture.save(self.path(result, ".png"))

    def finish(self) -> None:
        low, high = self.range()
        scale = {
            "quantity": self.quantity,
            "darkest": low,
            "brightest": high,
            "colours": COLOURS,
            "not_known": UNKNOWN_COLOUR,
        }
        write_json(self.folder / f"{self.name}.json", scale)


class DepthPictures(Pictures):
    """The measured depth image, coloured from the nearest to the farthest reference node."""

    kind, quantity = "depth", "depth_m"

    def image(self, result: Result) -> np.ndarray:
        return result.frame.depth_m

    def range(self) -> tuple[float, float]:
        depths = self.model.camera.local(self.model.mesh.nodes)[:, 2]
        return float(depths.min()), float(depths.max())


class PressurePictures(Pictures):
    """Contact pressure at each pixel, from 0 to `HIGHEST_PRESSURE` gauge pressures."""

    kind, quantity = "pressure", "contact_pressure_pa"
    products: frozenset[Product] = frozenset({"estimate"})

    def image(self, result: Result) -> np.ndarray:
        estimate, view = result.trusted_estimate, self.model.view
        if estimate is None:
            return np.full(view.shape, np.nan)
        pixels = np.arange(view.shape[0] * view.shape[1])
        return pressure_at(view, estimate, pixels).reshape(view.shape)

    def range(self) -> tuple[float, float]:
        return 0.0, HIGHEST_PRESSURE * self.model.sensor.pneumatics.gauge_pressure_pa


SERIES: dict[str, type[Series]] = {
    "vtk": VtkSeries,
    "ply": MembranePly,
    "patch": PatchPly,
    "depth": DepthPictures,
    "pressure": PressurePictures,
}
"""By kind of export."""


def pressure_at(view: MembraneView, estimate: Estimate, pixels: np.ndarray) -> np.ndarray:
    """Contact pressure where the rays of pixels meet the deformed membrane, (k,), Pa.

    Interpolated linearly; NaN where a ray misses. `pixels` are flat indices, ascending.
    """
    hits = view.hits(view.motion_seen(estimate), pixels)
    pressure = hits.values(estimate.contact_pressure_pa, view.mesh.triangles)
    values = np.full(len(pixels), np.nan)
    values[np.searchsorted(pixels, hits.ray)] = pressure
    return values


def _comment(frame: Frame) -> str:
    return f"bubble frame B, metres; frame {frame.index}, {frame.time_s!r} s"
