"""Write an identified sensor: the sensor file, its mesh and its pixel images."""

from __future__ import annotations

import hashlib
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bubbleviz.calibration.identification import Identification
from bubbleviz.calibration.verdict import parameters
from bubbleviz.errors import InputError
from bubbleviz.files import refuse_existing, whole_file, write_ply
from bubbleviz.sensor import Calibration, Sensor, sensor_to_toml

_MESH_COMMENT = "membrane in the bubble frame B, metres"


@dataclass(frozen=True)
class Origin:
    """Where an identification comes from."""

    recording: str  # name of the recording
    recording_sha256: str | None
    sensor_file: str
    date: str  # ISO 8601, UTC
    report: str | None = None  # path of the report, from the sensor file's folder


def file_hash(path: str | Path) -> str:
    """SHA-256 of a file, or of the files in a folder one after the other by name."""
    path = Path(path)
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    digest = hashlib.sha256()
    for each in files:
        with each.open("rb") as stream:
            while chunk := stream.read(1 << 20):
                digest.update(chunk)
    return digest.hexdigest()


def output_files(out_toml: str | Path) -> tuple[Path, Path, Path]:
    """Paths of the sensor file, its mesh and its pixel images; InputError where one is taken."""
    path = Path(out_toml)
    if path.suffix != ".toml":
        raise InputError(f"{path}: a sensor file ends in .toml; rename it")
    paths = path, path.with_suffix(".ply"), path.with_suffix(".npz")
    for each in paths:
        refuse_existing(each)
    return paths


def write_sensor(
    identification: Identification, out_toml: str | Path, origin: Origin | None = None
) -> Sensor:
    r"""Write `X.toml`, `X.npz` and, where it has one, `X.ply`, all or none; return the sensor.

    The shipped Punyo preset is made by (move the old files away first)::

        bubbleviz identify punyo_press_a --sensor OLD/punyo_oval_d405.toml \
            --out presets/sensors/punyo_oval_d405.toml

    which keeps the rim plane, camera axes and name of the old one.

    Raises
    ------
    InputError
        A file exists, or cannot be written; nothing is written then.
    """
    path, mesh_path, pixels_path = output_files(out_toml)
    sensor = _described(identification, path, origin)
    with ExitStack() as files:
        # Published last to first: the sensor file comes last, when what it names is there.
        toml = files.enter_context(whole_file(path))
        if sensor.membrane.mesh_file is not None:
            mesh, ply = identification.mesh, files.enter_context(whole_file(mesh_path))
            write_ply(ply, mesh.nodes, {}, mesh.triangles, _MESH_COMMENT)
        identification.pixels.save(files.enter_context(whole_file(pixels_path)))
        toml.write_text(_comment(identification) + sensor_to_toml(sensor), encoding="utf-8")
    return sensor


def _described(identification: Identification, path: Path, origin: Origin | None) -> Sensor:
    sensor, tension = identification.sensor, identification.tension.tension
    membrane = sensor.membrane
    if membrane.mesh_file is not None:
        membrane = membrane.model_copy(update={"mesh_file": path.with_suffix(".ply").name})
    calibration = Calibration(
        pixels_file=path.with_suffix(".npz").name,
        recording=origin.recording if origin else identification.source_name,
        recording_sha256=origin.recording_sha256 if origin else None,
        report=origin.report if origin else None,
        date=origin.date if origin else None,
        tension_interval_n_per_m=(round(tension.low, 3), round(tension.high, 3)),
        **_intervals(identification),
    )
    return sensor.model_copy(
        update={
            "membrane": membrane,
            "calibration": calibration,
            "folder": path.parent,
            "file": path.name,
        }
    )


def _intervals(found: Identification) -> dict[str, Any]:
    """What the file keeps of gauge pressure and λ beside their values."""
    keys: dict[str, Any] = {}
    if (gauge := found.gauge) is not None:
        keys["gauge_interval_pa"] = round(gauge.low, 1), round(gauge.high, 1)
        keys["gauge_from"] = found.gauge_rests_on
    if (rubber := found.rubber) is not None and (stretch := rubber.prestretch) is not None:
        keys["prestretch_interval"] = round(stretch.low, 4), round(stretch.high, 4)
        keys["prestretch_from"] = rubber.prestretch_rests_on
    return keys


def _comment(identification: Identification) -> str:
    """Where the numbers come from, as comment lines."""
    fits, surfaces, tension = (
        identification.fits,
        identification.surfaces,
        identification.tension,
    )
    free = identification.samples.frames
    axes = "/".join(f"{1e3 * x:.1f}" for x in fits.cap.semi_axes_m)
    misses = {name: f"{1e3 * rms:.3g} mm" for name, rms in surfaces.left_out_rms_m.items()}
    lines = [
        f"Identified from {identification.source_name}, contact-free frames {free[0]}–{free[-1]}.",
        "B: origin at the centre of the rim plane; the rim plane and the axes are the drawing's.",
        "Rms by which parts of the cloud that a fit had not seen are missed: sphere"
        f" {misses['sphere']},",
        f"ellipsoid of semi-axes {axes} mm {misses['ellipsoid']}, free form"
        f" {misses['free-form']}. Chosen: {surfaces.chosen}.",
        "γ0 is Young–Laplace's, summed over the surface so that its bumps do not bias it;",
        f"100 Pa more of gauge pressure would make it {100 * tension.per_pascal:.2f} N/m larger.",
    ]
    lines += [f"{each.name}: {each.value} ({each.told_by})." for each in parameters(identification)]
    return "".join(f"# {line}\n" for line in lines) + "\n"
