"""The command `identify`: a recording of the untouched sensor in, a sensor file out."""

from __future__ import annotations

import json
import re
from pathlib import Path

import click

from bubbleviz.errors import InputError


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
@click.option("--json", "as_json", is_flag=True, help="Print JSON, SI units.")
def identify(
    recording: Path,
    sensor: str,
    contact_free: str | None,
    out: Path,
    report: Path | None,
    surface: str | None,
    nodes: int,
    as_json: bool,
) -> None:
    """Identify γ0, reference surface and pixels of a sensor nobody touches."""
    from bubbleviz.calibration.identify import identify as run
    from bubbleviz.calibration.save import check_outputs, save
    from bubbleviz.frames.recording import Recording
    from bubbleviz.sensor import load_sensor

    check_outputs(out, report)
    given = load_sensor(sensor)
    frames = None if contact_free is None else parse_frames(contact_free)
    with Recording(recording) as source, _Bar() as bar:
        found = run(source, given, frames, nodes=nodes, surface=surface, progress=bar)  # type: ignore[arg-type]
        numbers = save(found, source, sensor, out, report, bar)
    if as_json:
        click.echo(json.dumps(numbers, indent=2, ensure_ascii=False))
        return
    verdict = numbers["verdict"]
    click.echo("\n".join([verdict["summary"], *(f"- {line}" for line in verdict["advice"])]))
    click.echo(f"wrote {out}" + (f" and {report / 'report.html'}" if report else ""))


def parse_frames(text: str) -> range:
    """Frames of "A:B", A to B−1; InputError where it is not that."""
    match = re.fullmatch(r"(\d+):(\d+)", text.strip())
    if match is None or int(match[1]) >= int(match[2]):
        raise InputError(f"--contact-free {text}: give A:B with A < B, for example 0:100")
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
