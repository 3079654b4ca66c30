"""Write an identified sensor: the sensor file, its mesh and its pixel images."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import numpy as np

from bubbleviz.calibration.identify import Identification
from bubbleviz.errors import InputError
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.outputs import refuse_existing, whole_file
from bubbleviz.sensor import Calibration, Sensor, sensor_to_toml


def write_sensor(identification: Identification, out_toml: str | Path) -> Sensor:
    """Write `X.toml`, `X.ply` and `X.npz`, all of them or none, and return the sensor.

    The shipped Punyo preset is made by (move the old files away first)::

        from bubbleviz.calibration.identify import identify
        from bubbleviz.calibration.sensor_files import write_sensor
        from bubbleviz.frames.recording import Recording
        from bubbleviz.sensor import load_sensor

        write_sensor(
            identify(Recording("punyo_press_a"), load_sensor("punyo_oval_d405")),
            "punyo_oval_d405.toml",
        )

    which keeps the preset's rim plane, camera axes and name.

    Raises
    ------
    InputError
        A file exists, or cannot be written; nothing is written then.
    """
    path = Path(out_toml)
    if path.suffix != ".toml":
        raise InputError(f"{path}: a sensor file ends in .toml; rename it")
    mesh_path, pixels_path = path.with_suffix(".ply"), path.with_suffix(".npz")
    sensor = _described(identification, path)
    for each in (path, mesh_path, pixels_path):
        refuse_existing(each)
    with ExitStack() as files:
        # Published last to first: the sensor file comes last, when what it names is there.
        toml = files.enter_context(whole_file(path))
        mesh = files.enter_context(whole_file(mesh_path))
        pixels = files.enter_context(whole_file(pixels_path))
        identification.pixels.save(pixels)
        _write_ply(identification.mesh, mesh)
        toml.write_text(_comment(identification) + sensor_to_toml(sensor), encoding="utf-8")
    return sensor


def _described(identification: Identification, path: Path) -> Sensor:
    sensor = identification.sensor
    membrane = sensor.membrane.model_copy(update={"mesh_file": path.with_suffix(".ply").name})
    calibration = Calibration(pixels_file=path.with_suffix(".npz").name)
    return sensor.model_copy(
        update={"membrane": membrane, "calibration": calibration, "folder": path.parent}
    )


def _comment(identification: Identification) -> str:
    """Where the numbers come from, as comment lines."""
    fits, surfaces = identification.fits, identification.surfaces
    free = identification.samples.frames
    seen = surfaces.residual_m[identification.pixels.mask]
    axes = "/".join(f"{1e3 * x:.1f}" for x in fits.cap.ellipsoid.semi_axes_m)
    lines = [
        f"Identified from {identification.source_name}, contact-free frames {free[0]}–{free[-1]}.",
        "B: origin at the centre of the rim plane; the rim plane and the axes are the drawing's.",
        f"Cloud minus surface, rms over the used pixels: sphere"
        f" {1e3 * fits.sphere.rms_m:.2f} mm, ellipsoid of semi-axes {axes} mm"
        f" {1e3 * fits.cap.rms_m:.2f} mm, the mesh {1e3 * np.sqrt(np.mean(seen**2)):.3f} mm.",
        "tension_n_per_m: Young–Laplace, summed over the mesh so that its bumps do not bias it.",
    ]
    lines += _chamber_lines(identification)
    return "".join(f"# {line}\n" for line in lines) + "\n"


def _chamber_lines(identification: Identification) -> list[str]:
    chamber, cap = identification.chamber, identification.mesh.cap_volume()
    if chamber is None:
        return ["chamber_volume_m3: as given; no press with gas pressure to measure it by."]
    lines = [
        "chamber_volume_m3: by the gas law on the press that follows. The gas pressure rose by"
        f" {np.median(chamber.pressure_change_pa):.0f} Pa",
        f"while the volume under the membrane ({100 * chamber.seen:.0f} % of it seen) changed by"
        f" {1e6 * np.median(chamber.volume_change_m3):.2f} cm³: {1e6 * chamber.gas_volume_m3:.0f}"
        f" cm³ of gas in all,",
        f"{1e6 * cap:.0f} cm³ of it under the cap. The change is a dent less a bulge nearly as"
        " large, so that 0.1 mm of common",
        f"error in the depth makes {1e2 * chamber.sensitivity_m2:.0f} cm³ of difference"
        f" (spread over the frames {1e6 * chamber.spread_m3:.0f} cm³).",
    ]
    if chamber.chamber_volume_m3(cap) is None:
        lines.append(
            "That leaves nothing for the chamber: the value given before is kept, unmeasured."
        )
    return lines


def _write_ply(mesh: MembraneMesh, path: Path) -> None:
    """Binary little-endian PLY, double precision, metres."""
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment membrane in the bubble frame B, metres\n"
        f"element vertex {len(mesh.nodes)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(mesh.triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(mesh.triangles), dtype=[("count", "u1"), ("nodes", "<i4", 3)])
    faces["count"], faces["nodes"] = 3, mesh.triangles
    path.write_bytes(header.encode() + mesh.nodes.astype("<f8").tobytes() + faces.tobytes())
