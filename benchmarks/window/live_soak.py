"""A publisher in its own process, and the images of a recording by its count."""

from __future__ import annotations

import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
from mcap.reader import make_reader

from bubbleviz.recordings import IMAGE
from bubbleviz.sensor import Sensor, sensor_to_toml
from bubbleviz.simulation import resized


class Publisher:
    """A process that runs `bubbleviz publish` on a source; killed at the end of its `with`.

    `uri` is the live source that receives its messages.
    """

    def __init__(self, sensor_name: str, source: str) -> None:
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.uri = f"zenoh:{endpoint}"
        words = ["--source", source, "--sensor", sensor_name, "--listen", endpoint]
        command = [sys.executable, "-m", "bubbleviz", "publish", *words]
        self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL)

    def __enter__(self) -> Publisher:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()


def resized_file(sensor: Sensor, size: tuple[int, int], folder: Path, name: str = "sensor") -> str:
    """File of the same sensor and field of view with another image size."""
    other = resized(sensor, *size)
    path = folder / f"{name}.toml"
    path.write_text(sensor_to_toml(other), encoding="utf-8")
    return str(path)


def free_port() -> int:
    """An unused loopback port."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def sequences(path: Path, prefix: str = "") -> np.ndarray:
    """Sequence numbers of the depth images of some topics in a recording, in file order."""
    with path.open("rb") as file:
        numbers = [
            message.sequence
            for schema, channel, message in make_reader(file).iter_messages(log_time_order=False)
            if schema is not None and schema.name == IMAGE and channel.topic.startswith(prefix)
        ]
    return np.array(numbers, np.int64)


def gaps_in(count: np.ndarray) -> tuple[int, int]:
    """Numbers of missing and of repeated values in a sequence."""
    steps = np.diff(np.sort(count))
    return int(np.sum(np.maximum(steps - 1, 0))), int(np.sum(steps == 0))
