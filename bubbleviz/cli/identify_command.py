"""The command `identify`: from contact-free frames to a sensor file; heavy imports inside."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bubbleviz.errors import InputError

if TYPE_CHECKING:
    from bubbleviz.calibration.validation import KnownPress


@click.command()
@click.argument("recording", metavar="REC", type=click.Path(path_type=Path))
@click.option("--sensor", required=True, help="Sensor file or preset to start from.")
@click.option("--contact-free", metavar="A:B", help="Frames A to B−1; found where not given.")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="SENSOR.toml.")
@click.option("--report", type=click.Path(path_type=Path), help="New folder for HTML and JSON.")
@click.option(
    "--surface",
    type=click.Choice(["sphere", "ellipsoid", "free-form"]),
    help="In place of the data's choice.",
)
@click.option("--nodes", type=click.IntRange(30, 20_000), default=1000, help="Of the mesh.")
@click.option(
    "--level",
    "levels",
    multiple=True,
    type=click.Path(path_type=Path),
    help="Recording of the untouched sensor at another inflation level; several rectify better.",
)
@click.option(
    "--vented",
    type=click.Path(path_type=Path),
    help="Recording of the open chamber: its gas pressure is the atmospheric one.",
)
@click.option("--object", "obj", help="Known object in REC to validate by: mesh file or preset.")
@click.option("--pose", help='Its T_B_O as "x y z qx qy qz qw" (m, unit quaternion).')
@click.option("--pressed", metavar="A:B", help="Frames A to B−1 in which it is held still.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON, SI units.")
def identify(
    recording: Path,
    sensor: str,
    contact_free: str | None,
    out: Path,
    report: Path | None,
    surface: str | None,
    nodes: int,
    levels: tuple[Path, ...],
    vented: Path | None,
    obj: str | None,
    pose: str | None,
    pressed: str | None,
    as_json: bool,
) -> None:
    """Identify γ0, reference surface and pixels of an untouched sensor.

    Inflation levels with their gas pressures give λ and the gauge pressure, too.
    """
    from bubbleviz.calibration.identification import identify as run
    from bubbleviz.calibration.identification import with_rubber
    from bubbleviz.calibration.rectification import Level, rectify
    from bubbleviz.calibration.rubber.vented import Vented
    from bubbleviz.calibration.save_identification import check_outputs, save
    from bubbleviz.frames.recording import Recording
    from bubbleviz.sensor import load_sensor

    check_outputs(out, report)
    press = _known_press(obj, pose, pressed)
    given = load_sensor(sensor)
    frames = None if contact_free is None else parse_frames("--contact-free", contact_free)
    opened = None
    if vented is not None:
        with Recording(vented) as open_chamber:
            opened = Vented.measure(open_chamber)
        given = opened.set_in(given)
    with Recording(recording) as source, _Bar() as bar:
        found = run(source, given, frames, nodes=nodes, surface=surface, progress=bar)  # type: ignore[arg-type]
        measured = []
        for path in levels:
            with Recording(path) as level:
                measured.append(Level.measure(level, given, nodes, bar))
        found, validation = rectify(found, measured), None
        bar("inflating rubber", 0.0)
        found = with_rubber(found, [each.samples for each in measured if each.samples], opened)
        if press is not None:
            bar("predicting the known press", 0.0)
            validation = press.validate(found.model, source)
        numbers = save(found, source, sensor, out, report, bar, validation)
    if as_json:
        click.echo(json.dumps(numbers, indent=2, ensure_ascii=False))
        return
    verdict = numbers["verdict"]
    click.echo("\n".join([verdict["summary"], *(f"- {line}" for line in verdict["advice"])]))
    click.echo(f"wrote {out}" + (f" and {report / 'report.html'}" if report else ""))


def _known_press(obj: str | None, pose: str | None, pressed: str | None) -> KnownPress | None:
    """What to validate by; a pose that cannot be read is refused before the work."""
    if obj is None and pose is None and pressed is None:
        return None
    if obj is None or pose is None or pressed is None:
        raise click.UsageError("validation needs --object, --pose and --pressed together")
    from bubbleviz.calibration.validation import KnownPress
    from bubbleviz.files.pose_reader import parse_pose
    from bubbleviz.rigid_object import load_object

    load_object(obj), parse_pose(pose)
    frames = parse_frames("--pressed", pressed)
    return KnownPress(obj, pose, frames.start, frames.stop)


def parse_frames(option: str, text: str) -> range:
    """Frames of "A:B", A to B−1; InputError where it is not that."""
    match = re.fullmatch(r"(\d+):(\d+)", text.strip())
    if match is None or int(match[1]) >= int(match[2]):
        raise InputError(f"{option} {text}: give A:B with A < B, for example 0:100")
    return range(int(match[1]), int(match[2]))


class _Bar:
    """Progress bar on a terminal: a step at a time."""

    def __enter__(self) -> _Bar:
        from tqdm import tqdm

        self._bar = tqdm(total=100, unit="%", leave=False, disable=None)
        self._step = ""
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    def __call__(self, step: str, done: float) -> None:
        if self._step != step:
            self._step = step
            self._bar.reset()
            self._bar.set_description(step)
        self._bar.update(100.0 * done - self._bar.n)
