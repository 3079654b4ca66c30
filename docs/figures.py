"""Make the figures of the pages: `.venv/bin/python docs/figures.py FOLDER [punyo_press_a]`.

The recording is needed for the figure of the real press alone.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import bubbleviz as bv
from bubbleviz.files import whole_file

SENSOR = "pico_flexx_75mm"
DEPTHS_M = np.linspace(0.002, 0.016, 6)


def written(figure: Figure, path: Path) -> None:
    """Write a figure, whole or not at all."""
    with whole_file(path) as temporary:
        figure.savefig(temporary, metadata={"Date": None})
    print(f"wrote {path}")


def gas_law(path: Path) -> None:
    """Gas pressure over press depth, with the change of volume and with a third of it (Eq. 9)."""
    sensor = bv.load_sensor(SENSOR)
    figure = Figure(figsize=(6.0, 3.2), layout="constrained")
    axes = figure.subplots()
    poses = np.tile(np.eye(4), (len(DEPTHS_M), 1, 1))
    assert sensor.membrane.height_m is not None
    poses[:, 2, 3] = sensor.membrane.height_m - DEPTHS_M
    for model, label in (("exact", "ΔV = Aᵀu"), ("paper", "ΔV = Aᵀu / 3, the paper's Eq. 9")):
        pneumatics = sensor.pneumatics.model_copy(update={"volume_model": model})
        press = bv.simulate(sensor.model_copy(update={"pneumatics": pneumatics}), "cylinder", poses)
        change = [press.truth(k).gas_pressure_change_pa for k in range(len(press))]
        axes.plot(1e3 * DEPTHS_M, change, "o-", label=label)
    axes.set(xlabel="press depth of a cylinder, mm", ylabel="change of gas pressure, Pa")
    axes.grid(alpha=0.3)
    axes.legend()
    written(figure, path)


def real_press(recording: Path, path: Path) -> None:
    """Force found and measured in the real press."""
    columns = bv.estimate(bv.open(recording)).columns()
    figure = Figure(figsize=(6.0, 3.2), layout="constrained")
    axes = figure.subplots()
    axes.plot(columns["time_s"], columns["measured_force_n"], color="0.6", label="wrench sensor")
    axes.plot(columns["time_s"], columns["force_magnitude_n"], label="found")
    axes.set(xlabel="time, s", ylabel="force, N")
    axes.grid(alpha=0.3)
    axes.legend()
    written(figure, path)


def main() -> None:
    """Make those that can be made."""
    folder = Path(sys.argv[1])
    gas_law(folder / "gas-law.svg")
    if len(sys.argv) > 2:
        real_press(Path(sys.argv[2]), folder / "real-press.svg")


if __name__ == "__main__":
    main()
