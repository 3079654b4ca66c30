"""Results of one frame and of many: arrays, tables, plots, pictures and files."""

from __future__ import annotations

import math
import sys
import time
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, overload

import numpy as np
from threadpoolctl import threadpool_limits

from bubbleviz.api.run_summary import pose_statistics, statistics, text_of
from bubbleviz.api.summary import Summary
from bubbleviz.camera import DepthCamera
from bubbleviz.errors import InputError
from bubbleviz.files import (
    PICTURES,
    as_input_error,
    checked,
    read_npz,
    refuse_existing,
    whole_file,
    write_rows,
)
from bubbleviz.inverse import LINEAR, PAPER, ConstantTension
from bubbleviz.membrane import MembraneMesh
from bubbleviz.output import (
    ARROW,
    COLUMNS,
    DPI,
    NODAL_FIELDS,
    SIZE_IN,
    FrameTable,
    PoseRow,
    ResultWriter,
    Shape,
    csv_row,
    draw_plots,
    magnitude_half_width_n,
    nodal_fields,
    pose_columns,
    pose_row,
    result_arrays,
    results_of,
    scene_of,
    summary_row,
    write_poses,
)
from bubbleviz.plugins import library
from bubbleviz.result import Estimate, Patch, Pose, Result
from bubbleviz.sensor import Sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.wording import count_of, counted, plus_minus

if TYPE_CHECKING:
    import pandas
    import trimesh
    import xarray
    from matplotlib.figure import Figure


_PRESSURE = "contact pressure, kPa"
_NO_IMAGE = np.empty((0, 0), np.float32)
"""Replaces the depth images in a `Run`, which would fill the memory."""


@dataclass(frozen=True)
class FrameResult:
    """Result of one frame; numbers are NaN unless `status` is `ok` or `no_contact`.

    Units are SI, positions in the bubble frame B: origin at the centre of the rim plane, z outward.

    Attributes
    ----------
    result : Result
        With its `estimate`, `patch`, `pose` and `times_ms`.
    model : SensorModel
        Model of the sensor, with its `mesh` of n nodes.
    """

    result: Result
    model: SensorModel

    @property
    def index(self) -> int:
        """Index in the recording, or count since a live source started."""
        return self.result.frame.index

    @property
    def time_s(self) -> float:
        """Seconds from the start of the recording."""
        return self.result.frame.time_s

    @property
    def stamp_ns(self) -> int:
        """Time stamp of the image, ns since 1970 by the source's clock; 0 if there is none."""
        return self.result.frame.stamp_ns

    @property
    def age_s(self) -> float:
        """Time from the image until now, when this is read, s; NaN for recordings.

        From its stamp or, if the clocks differ, from its arrival.
        """
        taken_ns = self.result.frame.taken_ns
        return math.nan if taken_ns is None else 1e-9 * (time.time_ns() - taken_ns)

    @property
    def status(self) -> str:
        """`ok`, `no_contact`, or the reason why there are no numbers (`Status`)."""
        return self.estimate.status

    @property
    def reason(self) -> str:
        """Why there are no numbers, in one clause; empty if there are."""
        return self.estimate.reason

    @property
    def caveat(self) -> str:
        """How wrong the force may be due to the model of the membrane, in one clause, or empty."""
        return self.estimate.caveat

    @property
    def force_n(self) -> np.ndarray:
        """Total contact force on the membrane in B, with friction, (3,), N."""
        return self._numbers("force_n")

    @property
    def force_sigma_n(self) -> np.ndarray:
        """Standard deviation σ of the force, (3,), N: 95 % of errors are within ±1.96 σ.

        0 without contact, NaN with the solver `paper`.
        """
        return self._numbers("force_sigma_n")

    @property
    def force_magnitude_n(self) -> float:
        """Magnitude of the force, N."""
        return float(np.linalg.norm(self.force_n))

    @property
    def force_magnitude_half_width_n(self) -> float:
        """Half of the 95 % interval of the magnitude, N.

        0 without contact, NaN with the solver `paper`.
        """
        return magnitude_half_width_n(self.estimate)

    @property
    def torque_nm(self) -> np.ndarray:
        """Moment of the contact about `center_of_pressure_m` in B, (3,), N·m."""
        return self._numbers("torque_nm")

    @property
    def torque_sigma_nm(self) -> np.ndarray:
        """Standard deviation of `torque_nm`, (3,), N·m; NaN with the solver `paper`."""
        return self._numbers("torque_sigma_nm")

    @property
    def center_of_pressure_m(self) -> np.ndarray:
        """Pressure-weighted centre of the patch, (3,), m; NaN without contact."""
        return self._numbers("center_of_pressure_m")

    @property
    def patch_area_m2(self) -> float:
        """Area of the contact patch on the reference surface, m²; 0 without contact."""
        return float(self._numbers("patch_area_m2"))

    @property
    def patch_area_interval_m2(self) -> np.ndarray:
        """Areas within the inner and outer line of the band around the edge, (2,), m²."""
        return self._numbers("patch_area_interval_m2")

    @property
    def contact_pressure_pa(self) -> np.ndarray:
        """Contact pressure p_c ≥ 0 of the nodes (Eq. 23), (n,), Pa."""
        return self._nodal("contact_pressure_pa")

    @property
    def displacement_m(self) -> np.ndarray:
        """Displacement u of the nodes along the rest normals (Eq. 1), (n,), m."""
        return self._nodal("displacement_m")

    @property
    def nodes_m(self) -> np.ndarray:
        """Nodes of the deformed membrane, (n, 3), m."""
        return self.model.mesh.nodes + self._nodal("displacement_3d_m")

    @property
    def pixel_mask(self) -> np.ndarray:
        """Pixels of the contact patch, (H, W) bool; computed on first use."""
        found = self.patch.pixel_mask
        return self.model.view.patch_pixels(self.estimate, self.patch) if found is None else found

    @property
    def pose(self) -> Pose | None:
        """Pose of the object with its covariance; None if no object is tracked."""
        return self.result.pose

    @property
    def T_B_O(self) -> np.ndarray:
        """Pose of the object, (4, 4), m; NaN if unknown."""
        pose = self.result.pose
        return np.full((4, 4), np.nan) if pose is None else pose.T_B_O

    @property
    def estimate(self) -> Estimate:
        """Solution of the inverse problem."""
        return self.result.solution[0]

    @property
    def patch(self) -> Patch:
        """The contact patch."""
        return self.result.solution[1]

    def plot(self, screenshot: str | Path | None = None, *, overwrite: bool = False) -> Any:
        """Show the membrane with its contact pressure, the patch's outline and the force.

        Parameters
        ----------
        screenshot : path, optional
            Write this PNG instead; needs no screen.
        overwrite : bool
            Replace an existing file.

        Returns
        -------
        object
            The return value of `pyvista.Plotter.show`: in a notebook the picture.

        Raises
        ------
        InputError
            pyvista (extra `window`) is not installed, or the file exists.
        """
        library("pyvista", "window")
        import pyvista  # an extra

        if screenshot is not None:
            refuse_existing(screenshot, ".png", overwrite=overwrite)
        with pyvista.vtk_verbosity("error"):  # no warnings of VTK without an X server
            plotter = pyvista.Plotter(off_screen=screenshot is not None)
            _draw(plotter, pyvista, self)
            backend = "static" if plotter.notebook else None  # works without screen and trame
            if screenshot is None:
                return plotter.show(jupyter_backend=backend)
            with whole_file(screenshot, overwrite=overwrite) as temporary:
                return plotter.show(jupyter_backend=backend, screenshot=str(temporary))

    def scene(self) -> trimesh.Scene:
        """Scene of what `plot` shows, in B, m; the colours end at four gauge pressures.

        Examples
        --------
        >>> found.scene().show()  # in a notebook: turned by the mouse, and kept when it is saved
        >>> found.scene().export("press.glb")  # for other programs
        """
        return scene_of(self.model, self.result)

    def _numbers(self, name: str) -> np.ndarray:
        return np.asarray(summary_row(self.result)[name])

    def _nodal(self, name: str) -> np.ndarray:
        return nodal_fields(self.result, self.model.mesh)[name]

    def __repr__(self) -> str:
        found = f"<frame {self.index} at {self.time_s:.3f} s: {self.status}"
        if not self.estimate.trusted:
            return f"{found}, {self.estimate.reason or 'not trusted'}>"
        force = _force_text(self.force_magnitude_n, self.force_magnitude_half_width_n)
        return f"{found}, {force} on {1e6 * self.patch_area_m2:.0f} mm²>"


class Run(Sequence[FrameResult], Summary):
    """Results of the frames of a recording, like a list; images are not kept.

    If results were written to a file during estimation, only summary values are in memory, for
    table, plot and summary, and `run[k]` is an error; `load_run` reads the results.

    Parameters
    ----------
    model : SensorModel
    context : dict
        Facts of the summary beside those of the frames: recording, sensor, solver, warning, ….
    provenance : dict
        Texts stored in RESULT.npz: sensor file, version, solver, ….

    Attributes
    ----------
    poses : list of dict
        Lines of POSES.csv, if an object was tracked.
    """

    def __init__(
        self, model: SensorModel, context: dict[str, Any], provenance: dict[str, str]
    ) -> None:
        self.model, self.context, self.provenance = model, context, provenance
        self.poses: list[PoseRow] = []
        bias_n = np.array(provenance.get("wrench_bias_n", "").split(), float)
        self._numbers = FrameTable(model.sensor.name, bias_n if len(bias_n) else None)
        self._results: list[FrameResult] = []
        self._failures: Counter[str] = Counter()  # statuses with their reasons
        self._caveat: str | None = None

    def add(self, result: Result, *, keep: bool) -> None:
        """Add the result of the next frame; `keep`: in memory."""
        pose = [] if result.pose is None else [pose_row(result)]
        self.poses += pose
        self._numbers.add(result, pose_columns(pose[0]) if pose else None)
        if (estimate := result.estimate) is not None:
            self._caveat = estimate.caveat or self._caveat
            if estimate.reason:
                self._failures[estimate.status_text] += 1
        if keep:
            frame = replace(result.frame, depth_m=_NO_IMAGE, mean_depth_m=None, find_colour=None)
            self._results.append(FrameResult(replace(result, frame=frame), self.model))

    def __len__(self) -> int:
        """Count the frames."""
        return len(self._numbers)

    @overload
    def __getitem__(self, index: int) -> FrameResult: ...
    @overload
    def __getitem__(self, index: slice) -> Self: ...
    def __getitem__(self, index: int | slice) -> FrameResult | Self:
        """Result of one frame, or of a slice of frames.

        Raises
        ------
        InputError
            Results were written to a file and not kept.
        """
        if len(self) and not self._results:
            remedy = "call track without out" if "object" in self.context else "use bv.load_run"
            raise InputError(
                f"{self.context['out']}: written frame by frame, so results are not in memory; "
                f"{remedy}"
            )
        if not isinstance(index, slice):
            return self._results[index]
        part = type(self)(self.model, self.context, self.provenance)
        for each in self._results[index]:
            part.add(each.result, keep=True)
        return part

    @property
    def warning(self) -> str | None:
        """Missing data and mismatches that did not prevent the estimation; None without any."""
        return self.context["warning"]

    def warn(self, *texts: str) -> None:
        """Set the warning, of those texts that are not empty."""
        self.context["warning"] = "; ".join(filter(None, texts)) or None

    @property
    def times_s(self) -> np.ndarray:
        """Time of each frame from the start of the recording, s, (F,)."""
        return self._of_frames("time_s")

    @property
    def status(self) -> np.ndarray:
        """Status of each frame, (F,) texts."""
        return self._of_frames("status")

    @property
    def force_n(self) -> np.ndarray:
        """Force on the membrane in B, (F, 3), N; NaN in untrusted frames."""
        return self._of_frames("force_n")

    @property
    def T_B_O(self) -> np.ndarray:
        """Pose of the object in each frame, (F, 4, 4), m; NaN if unknown."""
        return np.array([each.T_B_O for each in self])

    def columns(self) -> dict[str, np.ndarray]:
        """Values of each frame by column, (F,) each, units in the names, run times in ms."""
        table = self._numbers.columns()
        table["kappa"] = [np.nan if kappa is None else kappa for kappa in table["kappa"]]
        return {name: np.array(values) for name, values in table.items()}

    def rows(self) -> list[dict[str, Any]]:
        """Values of each frame by key of RESULT.npz."""
        return self._numbers.rows()

    def arrays(self) -> dict[str, np.ndarray]:
        """Arrays of RESULT.npz by name, without the masks."""
        return result_arrays(self.rows(), [each.result for each in self], self.model.mesh)

    def table(self) -> pandas.DataFrame:
        """Table with one row per frame, indexed by frame.

        Raises
        ------
        InputError
            pandas (extra `notebook`) is not installed.
        """
        table: pandas.DataFrame = library("pandas", "notebook").DataFrame(self.columns())
        return table.set_index("frame")

    def dataset(self) -> xarray.Dataset:
        """Fields of all frames with named dimensions, and units as attributes.

        Dimensions are `frame`, `node`, `axis`, `bound` of an interval, `triangle` and `corner`.

        Raises
        ------
        InputError
            xarray (extra `notebook`) is not installed.
        """
        make = library("xarray", "notebook").Dataset
        arrays = self.arrays()
        frame = arrays.pop("frame")
        dimensions = _dimensions()
        data = {name: (dimensions[name], array, _unit(name)) for name, array in arrays.items()}
        dataset: xarray.Dataset = make(data, {"frame": frame}).set_coords("time_s")
        return dataset

    def plot(self, path: str | Path | None = None, *, overwrite: bool = False) -> Figure:
        """Plot force, gas pressure, patch, residual and time over the frames; contact is shaded.

        Parameters
        ----------
        path : path, optional
            Also write this PNG, SVG or PDF.
        overwrite : bool
            Replace an existing file.

        Returns
        -------
        Figure
            Shown by notebooks; without a path it belongs to pyplot, and scripts can show it by
            `matplotlib.pyplot.show()`.

        Raises
        ------
        InputError
            The file exists, or has another suffix.
        """
        if path is not None:
            refuse_existing(path, *PICTURES, overwrite=overwrite)
        figure = _new_figure(shown=path is None or "ipykernel" in sys.modules)
        draw_plots(self._numbers.columns(), figure)
        if path is not None:
            with whole_file(path, overwrite=overwrite) as temporary:
                figure.savefig(temporary, dpi=DPI)
        return figure

    def save(
        self, out: str | Path, csv: str | Path | None = None, *, overwrite: bool = False
    ) -> None:
        """Write RESULT.npz, and RESULT.csv if requested, both or neither.

        Raises
        ------
        InputError
            A file exists or cannot be written.
        """
        with self.files(out, csv, overwrite=overwrite) as write:
            for each in self:
                patch = replace(each.patch, pixel_mask=each.pixel_mask)
                write(replace(each.result, patch=patch))

    @contextmanager
    def files(
        self,
        out: str | Path | None,
        csv: str | Path | None,
        *,
        overwrite: bool,
        frames: int | None = None,
    ) -> Iterator[Callable[[Result], object]]:
        """Function that writes the results of `frames` frames; the files appear after the block.

        It does nothing if `out` is None.
        """
        if out is None:
            yield lambda _: None
            return
        with ExitStack() as stack:
            archive = stack.enter_context(whole_file(out, ".npz", overwrite=overwrite))
            table = csv and stack.enter_context(whole_file(csv, ".csv", overwrite=overwrite))
            count, shape = len(self) if frames is None else frames, self.model.view.shape
            shear = self.context.get("texture") is not None
            writer = ResultWriter(archive, self.model.mesh, count, shape, shear=shear)
            yield stack.enter_context(writer).add
            writer.finish(self.rows(), **self.provenance)
            if table:
                sensor = self.model.sensor.name
                write_rows(table, [csv_row(row, sensor) for row in self.rows()])

    def save_poses(self, out: str | Path, *, overwrite: bool = False) -> None:
        """Write POSES.csv.

        Raises
        ------
        InputError
            No object was tracked, or the file exists or cannot be written.
        """
        if not self.poses:
            raise InputError(f"{self.context['recording']}: no object was tracked; use bv.track")
        refuse_existing(out, ".csv", overwrite=overwrite)
        write_poses(Path(out), self.poses, "csv", overwrite=overwrite)

    def facts(self) -> dict[str, Any]:
        """Context and statistics of the frames, or of the poses if an object was tracked."""
        found = (
            pose_statistics(self.poses)
            if self.poses
            else statistics(self.rows(), self._numbers.half_widths_n)
        )
        most_frequent = next((text for text, _ in self._failures.most_common(1)), None)
        return self.context | found | {"failure": most_frequent, "model": self._caveat}

    def to_text(self) -> str:
        """Text for the terminal, with units."""
        return text_of(self.facts())

    def _of_frames(self, name: str) -> np.ndarray:
        return np.array([row[name] for row in self.rows()])

    def __repr__(self) -> str:
        if not len(self):
            return f"<0 frames of {self.context['recording']}>"
        force, largest = np.linalg.norm(self.force_n, axis=1), ""
        if np.isfinite(force).any():
            k = int(np.nanargmax(force))
            largest = f", up to {_force_text(force[k], self._numbers.half_widths_n[k])}"
        statuses = counted(Counter(each["status"] for each in self.rows()))
        frames = count_of(len(self), "frame")
        return f"<{frames} of {self.context['recording']}: {statuses}{largest}>"


def _force_text(force_n: float, half_width_n: float) -> str:
    """Force with half of its 95 % interval if there is one, which the solver `paper` has not."""
    interval = half_width_n > 0.0
    return f"{plus_minus(force_n, half_width_n, 3) if interval else f'{force_n:.3g}'} N"


def load_run(path: str | Path) -> Run:
    """Load the results of `estimate` from a RESULT.npz.

    Parameters
    ----------
    path : path
        Read completely into memory; the mask of the patch takes 0.3 MB per frame of 640×480 pixels.

    Returns
    -------
    Run
        Without traction and slip, which its `warning` mentions; read them from the file.

    Raises
    ------
    InputError
        The file is missing, or is not a RESULT.npz.

    Examples
    --------
    >>> bv.estimate("press.mcap").save("press.npz")
    >>> bv.load_run("press.npz").force_n.shape
    (90, 3)
    """
    with as_input_error(path, "the results of bubbleviz estimate", "choose a RESULT.npz"):
        arrays = read_npz(path)
        texts = {name: str(arrays.pop(name)) for name in [*arrays] if not arrays[name].ndim}
        sensor = checked(Sensor, tomllib.loads(texts["sensor_toml"]), Path(path), "sensor")
        mesh = MembraneMesh(arrays["nodes_m"], arrays["triangles"], arrays["rim"])
        results, solver = results_of(arrays), texts["solver"]
    shear_warning = "traction and slip in the file are not loaded; read them with numpy.load"
    context = {
        "recording": str(path),
        "sensor": sensor.name,
        "out": None,
        "solver": solver,
        "kappa": results[0].solution[1].kappa,
        "texture": None,
        "gas_zero": None,
        "warning": shear_warning if "traction_status" in arrays else None,
    }
    run = Run(SensorModel(sensor, DepthCamera.of(sensor.camera), mesh), context, texts)
    caveat = ConstantTension.caveat if solver in (LINEAR, PAPER) else ""
    for result in results:
        told = replace(result.solution[0], caveat=caveat)
        run.add(replace(result, estimate=told), keep=True)
    return run


def _draw(plotter: Any, pyvista: Any, found: FrameResult) -> None:
    mesh, patch = found.model.mesh, found.result.patch
    shape = Shape.of(mesh, found.result)
    surface = pyvista.PolyData.from_regular_faces(shape.points_m, mesh.triangles)
    surface[_PRESSURE] = 1e-3 * shape.contact_pressure_pa
    plotter.add_mesh(surface, scalars=_PRESSURE, cmap="viridis")
    force = ""
    if patch is not None and patch.area_m2 > 0.0:
        surface["level"] = patch.level
        edge = surface.contour([0.0], scalars="level")
        plotter.add_mesh(edge, color="white", line_width=4, render_lines_as_tubes=True)
        size = float(np.linalg.norm(patch.force_n))
        direction = patch.force_n / size
        length = ARROW * float(np.ptp(mesh.nodes[:, 0]))
        tail = patch.center_of_pressure_m - length * direction
        arrow = pyvista.Arrow(
            start=tail, direction=direction, scale=length, shaft_radius=0.02, tip_radius=0.05
        )
        plotter.add_mesh(arrow, color="red")
        force = f", {size:.3g} N"
    plotter.add_text(f"frame {found.index}: {found.status}{force}", font_size=10)


def _new_figure(shown: bool) -> Figure:
    """Make an empty figure, of pyplot if it is shown."""
    from matplotlib.figure import Figure  # takes 0.4 s

    if not shown:
        return Figure(figsize=SIZE_IN, layout="constrained")
    from matplotlib import pyplot  # searches a display

    figure = pyplot.figure(figsize=SIZE_IN, layout="constrained")
    if "inline" in pyplot.get_backend():
        pyplot.close(figure)  # shown as the cell's result; pyplot would show it again
    return figure


def _dimensions() -> dict[str, tuple[str, ...]]:
    """Dimensions of the arrays of RESULT.npz by name."""
    second: dict[int, tuple[str, ...]] = {0: (), 2: ("bound",), 3: ("axis",)}
    frames = {key: ("frame", *second[len(names)]) for key, names in COLUMNS.items()}
    frames["wrench_covariance"] = ("frame", "component", "other_component")
    nodal = {
        key: ("frame", "node", "axis") if more else ("frame", "node")
        for key, more in NODAL_FIELDS.items()
    }
    nodes = {"nodes_m": ("node", "axis"), "normals": ("node", "axis"), "rim": ("node",)}
    return {**frames, **nodal, **nodes, "triangles": ("triangle", "corner")}


_UNITS = {"m": "m", "m2": "m2", "n": "N", "nm": "N m", "pa": "Pa", "s": "s", "ms": "ms", "px": "1"}
"""Units in UDUNITS notation, by the suffix of a name."""


def _unit(name: str) -> dict[str, str]:
    """Attributes of an array of RESULT.npz: its unit, if any."""
    unit = _UNITS.get(name.rpartition("_")[2]) if "_" in name else None
    return {} if unit is None else {"units": unit}


OneBlasThread = partial(threadpool_limits, limits=1, user_api="blas")
"""Context in which BLAS uses one thread; restores the previous setting.

The solver's matrices are small, so synchronising threads costs more than they save. The command
line sets `OPENBLAS_NUM_THREADS` before NumPy is loaded, which a library cannot do.
"""
