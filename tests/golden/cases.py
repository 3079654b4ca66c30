"""Results that refactoring must not change: `python -m tests.golden.cases` writes them.

Status, force, area and pose of the real press and of three simulated ones. On the processor and
with the libraries that they were made with, they are equal to the last digit.
"""

import json
import platform
from pathlib import Path

import numpy as np
import scipy
from threadpoolctl import threadpool_info

import bubbleviz as bv
from tests.small_press import changed

FILE = Path(__file__).parent / "golden.json"
PRESS = Path(__file__).parents[3] / "shared" / "data" / "punyo_press_a"
DOME = changed(bv.load_sensor("pico_flexx_75mm"), membrane={"nodes": 400, "prestretch": 1.2})
"""Of rubber, on a mesh so coarse that friction is simulated fast."""
SIMULATED = {
    "ball": ("punyo_oval_d405", "sphere", "0.004 0.002 0.025 0 0 0 1", {"noise_sigma_m": 1e-4}),
    "cylinder": ("pico_flexx_75mm", "cylinder", "0 0 0.042 0 0 0 1", {"noise_relative": 0.003}),
    "dragged": (DOME, "sphere", "0.004 0.002 0.042 0 0 0 1", {"friction": 0.8, "drag_m": 4e-3}),
}


def made_with():
    """Processor and libraries, on which the last digits depend."""
    kernels = sorted({str(pool.get("architecture")) for pool in threadpool_info()})
    vectors = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
    parts = [platform.machine(), *kernels, *vectors, np.__version__, scipy.__version__]
    return " ".join(parts)


def real_press():
    """Rows of the real press, frames 0 to 89 played."""
    return _rows(bv.estimate(bv.open(PRESS)[:90], "punyo_oval_d405"))


def simulated(name):
    """Rows of a simulated press; the cylinder's have its pose."""
    sensor, obj, pose, options = SIMULATED[name]
    frames = 10 if "drag_m" in options else 2
    press = list(bv.simulate(sensor, obj, pose, frames=frames, seed=1, **options))
    if name == "cylinder":
        return _rows(bv.track(press, obj, sensor, init=pose))
    return _rows(bv.estimate(press, sensor))


def _rows(run):
    rows = []
    for each in run:
        row = {"status": each.status, "force_n": each.force_n.tolist()}
        row["area_m2"] = float(each.result.patch.area_m2)
        if each.result.pose is not None:
            row["T_B_O"] = each.result.pose.T_B_O.tolist()
        rows.append(row)
    return rows


def main():
    answers = {name: simulated(name) for name in SIMULATED}
    golden = {"made_with": made_with(), "real": real_press(), **answers}
    FILE.write_text(json.dumps(golden, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
