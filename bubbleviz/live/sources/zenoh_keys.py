"""How ROS 2 topics are named in Zenoh, in the two ways that are in use.

`rmw_zenoh` publishes `/cam/depth` as `0/cam/depth/sensor_msgs::msg::dds_::Image_/RIHS01_…` (domain,
topic, type, hash of the type) and announces it by the liveliness token
`@ros2_lv/0/<session>/<node id>/<id>/MP/<enclave>/<namespace>/<node>/<topic>/<type>/<hash>/<qos>`,
`%` for `/` within a part. The bridge `zenoh-bridge-ros2dds` publishes it as `cam/depth`, and
announces `@/<session>/@ros2_lv/MP/<key>/<type>/<qos>` (before 1.0: `@ros2_lv/<session>/MP/…`), `§`
for `/`.
"""

from __future__ import annotations

import struct
from typing import Literal, NamedTuple

TOKENS = ("@ros2_lv/**", "@/*/@ros2_lv/**")
"""Where publishers are announced."""

Layout = Literal["rmw", "dds"]

_DDS_SLASH = "§"
_ATTACHMENT = struct.Struct("<qqB16s")
_NAMED = (b"sequence_number", b"source_gid")


class Announced(NamedTuple):
    """A published topic and its key layout."""

    topic: str
    type: str
    layout: Layout


class Attachment(NamedTuple):
    """What `rmw_zenoh` sends with a message."""

    sequence: int
    stamp_ns: int
    publisher: bytes


def parse_token(key: str, domain: int) -> Announced | None:
    """Publisher that a liveliness token announces; None where it announces something else."""
    parts = key.split("/")
    if parts[0] == "@" and len(parts) >= 6 and parts[2] == "@ros2_lv":
        return _bridged(parts[3:])
    if parts[0] != "@ros2_lv" or len(parts) < 5:
        return None
    if parts[2] in ("MP", "MS", "SS", "SC", "AS", "AC"):
        return _bridged(parts[2:])
    if len(parts) < 12 or parts[1] != str(domain) or parts[5] != "MP":
        return None
    kind = ros_type(parts[10])
    return None if kind is None else Announced(_topic(parts[9].replace("%", "/")), kind, "rmw")


def _bridged(parts: list[str]) -> Announced | None:
    if len(parts) < 3 or parts[0] != "MP":
        return None
    key, kind = (part.replace(_DDS_SLASH, "/") for part in parts[1:3])
    return Announced(_topic(key), kind, "dds")


def _topic(key: str) -> str:
    return "/" + key.strip("/")


def subscription(topic: str, layout: Layout, domain: int) -> str:
    """Key expression that a topic's messages come under, whatever their type."""
    name = topic.strip("/")
    return f"{domain}/{name}/*/*" if layout == "rmw" else name


def type_of(key: str) -> str | None:
    """Type that the key of a message in rmw_zenoh's layout tells; None where it tells none."""
    parts = key.split("/")
    return ros_type(parts[-2]) if len(parts) >= 4 else None


def ros_type(mangled: str) -> str | None:
    """`sensor_msgs/msg/Image` of `sensor_msgs::msg::dds_::Image_`; None of anything else."""
    parts = mangled.split("::")
    if len(parts) != 4 or parts[2] != "dds_" or not parts[3].endswith("_"):
        return None
    return f"{parts[0]}/{parts[1]}/{parts[3][:-1]}"


def dds_type(kind: str) -> str:
    """`sensor_msgs::msg::dds_::Image_` of `sensor_msgs/msg/Image`."""
    package, space, name = kind.split("/")
    return f"{package}::{space}::dds_::{name}_"


def publication(topic: str, kind: str, type_hash: str, layout: Layout, domain: int) -> str:
    """Key that messages of a topic are published under."""
    name = topic.strip("/")
    return f"{domain}/{name}/{dds_type(kind)}/{type_hash}" if layout == "rmw" else name


def announcement(
    topic: str, kind: str, type_hash: str, layout: Layout, domain: int, session: str, number: int
) -> str:
    """Liveliness token of a publisher; the default quality of service."""
    if layout == "dds":
        key, slashed = topic.strip("/"), kind.replace("/", _DDS_SLASH)
        return f"@/{session}/@ros2_lv/MP/{key.replace('/', _DDS_SLASH)}/{slashed}/:::"
    mangled = topic.replace("/", "%")
    node = f"@ros2_lv/{domain}/{session}/0/{number}/MP/%/%/bubbleviz"
    return f"{node}/{mangled}/{dds_type(kind)}/{type_hash}/::,10:,:,:,,"


def pack_attachment(attachment: Attachment) -> bytes:
    """Attachment as rmw_zenoh 0.2.4 and later expects it: a subscriber there insists on one."""
    sequence, stamp, publisher = attachment
    return _ATTACHMENT.pack(sequence, stamp, 16, publisher)


def unpack_attachment(data: bytes | None) -> Attachment | None:
    """Attachment in the present or the former form, which names its fields; None in any other."""
    if data is None:
        return None
    if len(data) == _ATTACHMENT.size:
        sequence, stamp, length, publisher = _ATTACHMENT.unpack(data)
        return Attachment(sequence, stamp, publisher) if length == 16 else None
    if len(data) == 77 and all(name in data for name in _NAMED):
        (sequence,) = struct.unpack_from("<q", data, 16)
        (stamp,) = struct.unpack_from("<q", data, 41)
        return Attachment(sequence, stamp, data[61:])
    return None
