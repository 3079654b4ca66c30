"""Metadata of a rosbag2: metadata.yaml and its copy in the MCAP file."""

from __future__ import annotations

import io
from dataclasses import dataclass, field
from typing import Any


@dataclass
class BagFacts:
    """Counts and times of a rosbag2 with one file.

    Attributes
    ----------
    file : str
        Name of its one file.
    """

    file: str
    _types: dict[str, tuple[str, str]] = field(default_factory=dict)
    _counts: dict[str, int] = field(default_factory=dict)
    _first_ns: int = 2**63 - 1
    _last_ns: int = 0

    def describe(self, topic: str, kind: str, type_hash: str) -> None:
        """Take note of a topic."""
        self._types[topic] = (kind, type_hash)

    def add(self, topic: str, log_ns: int) -> None:
        """Count a message."""
        self._counts[topic] = self._counts.get(topic, 0) + 1
        self._first_ns, self._last_ns = min(log_ns, self._first_ns), max(log_ns, self._last_ns)

    def information(self) -> dict[str, Any]:
        """The section `rosbag2_bagfile_information` of metadata.yaml, version 9."""
        count = sum(self._counts.values())
        start = {"nanoseconds_since_epoch": self._first_ns if count else 0}
        duration = {"nanoseconds": self._last_ns - self._first_ns if count else 0}
        return {
            "version": 9,
            "storage_identifier": "mcap",
            "relative_file_paths": [self.file],
            "duration": duration,
            "starting_time": start,
            "message_count": count,
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": topic,
                        "type": kind,
                        "serialization_format": "cdr",
                        "offered_qos_profiles": [],
                        "type_description_hash": type_hash,
                    },
                    "message_count": self._counts.get(topic, 0),
                }
                for topic, (kind, type_hash) in self._types.items()
            ],
            "compression_format": "",
            "compression_mode": "",
            "files": [
                {
                    "path": self.file,
                    "starting_time": dict(start),
                    "duration": dict(duration),
                    "message_count": count,
                }
            ],
            "custom_data": None,
            "ros_distro": "bubbleviz",
        }

    def yaml(self) -> str:
        """The section as YAML, as rosbag2 keeps it inside the MCAP file."""
        return _yaml(self.information())


def metadata_yaml(facts: BagFacts) -> str:
    """Text of metadata.yaml."""
    return _yaml({"rosbag2_bagfile_information": facts.information()})


def _yaml(content: dict[str, Any]) -> str:
    from ruamel.yaml import YAML  # rosbags brings it and reads with it

    stream = io.StringIO()
    writer = YAML(typ="safe")
    writer.default_flow_style = False
    writer.width = 1000
    writer.dump(content, stream)
    return stream.getvalue()
