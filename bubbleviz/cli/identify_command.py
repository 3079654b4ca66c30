"""The command `identify`: from contact-free frames to a sensor file; heavy imports inside."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click


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
@click.option(
    "--press/--no-press",
    "held_press",
    default=True,
    help="Let a held press in REC tell λ and gauge pressure where no level does (default).",
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
    surface: Literal["sphere", "ellipsoid", "free-form"] | None,
    nodes: int,
    levels: tuple[Path, ...],
    vented: Path | None,
    held_press: bool,
    obj: str | None,
    pose: str | None,
    pressed: str | None,
    as_json: bool,
) -> None:
    """Identify γ0, reference surface and pixels of an untouched sensor.

    Inflation levels with their gas pressures give λ and the gauge pressure, too; so does, less
    precisely, a press in REC that is held.
    """
    from bubbleviz.commands.identify import identify_recording, known_press

    press = None
    if obj is not None and pose is not None and pressed is not None:
        press = known_press(obj, pose, pressed)
    elif (obj, pose, pressed) != (None, None, None):
        raise click.UsageError("validation needs --object, --pose and --pressed together")
    with _Bar() as bar:
        summary = identify_recording(
            recording,
            sensor,
            out,
            report,
            contact_free=contact_free,
            surface=surface,
            nodes=nodes,
            levels=levels,
            vented=vented,
            held_press=held_press,
            press=press,
            progress=bar,
        )
    click.echo(summary.to_json() if as_json else summary.to_text())


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
