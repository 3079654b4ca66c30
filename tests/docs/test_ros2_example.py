"""The launch file and layouts of examples/ros2 against the topics that are published."""

import json
import runpy
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from pages import REPOSITORY
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML

from bubbleviz.live import DIAGNOSTICS, RESULT_TOPICS
from bubbleviz.recordings import RESULTS

STORE = get_typestore(Stores.ROS2_JAZZY)
FOLDER = REPOSITORY / "examples" / "ros2"
PUBLISHED = {f"{RESULTS}{name}": topic.type for name, topic in RESULT_TOPICS.items()}
PUBLISHED["/diagnostics"] = DIAGNOSTICS
SHOWN = {
    "PointCloud2": "sensor_msgs/msg/PointCloud2",
    "MarkerArray": "visualization_msgs/msg/MarkerArray",
    "Wrench": "geometry_msgs/msg/WrenchStamped",
    "PoseWithCovariance": "geometry_msgs/msg/PoseWithCovarianceStamped",
}
"""What the displays of rviz_default_plugins subscribe to."""


class Made:
    """Anything of `launch` or `launch_ros`, with the arguments that it was made with."""

    def __init__(self, *given: Any, **named: Any) -> None:
        self.given, self.named = given, named


@pytest.fixture
def launched(monkeypatch):
    """Nodes of the launch file, by executable, and the names of its arguments."""
    made: dict[str, list[Made]] = {}

    def kind(name):
        def make(*given, **named):
            made.setdefault(name, []).append(Made(*given, **named))
            return made[name][-1]

        return make

    for module, names in {
        "launch": ("LaunchDescription",),
        "launch.actions": ("DeclareLaunchArgument", "SetEnvironmentVariable"),
        "launch.conditions": ("IfCondition",),
        "launch.substitutions": ("LaunchConfiguration",),
        "launch_ros": (),
        "launch_ros.actions": ("Node",),
    }.items():
        stub = ModuleType(module)
        for name in names:
            setattr(stub, name, kind(name))
        monkeypatch.setitem(sys.modules, module, stub)
    names = runpy.run_path(str(FOLDER / "bubbleviz.launch.py"))
    names["generate_launch_description"]()
    return made


def test_launch_file_starts_router_camera_pose_and_rviz(launched):
    nodes = {each.named["executable"]: each.named for each in launched["Node"]}
    assert nodes.keys() == {"rmw_zenohd", "static_transform_publisher", "rviz2"}
    option, config = nodes["rviz2"]["arguments"]
    assert option == "-d" and Path(config) == FOLDER / "bubbleviz.rviz"
    declared = {each.given[0] for each in launched["DeclareLaunchArgument"]}
    assert {each.given[0] for each in launched["LaunchConfiguration"]} == declared
    (environment,) = launched["SetEnvironmentVariable"]
    assert environment.given == ("RMW_IMPLEMENTATION", "rmw_zenoh_cpp")
    words = nodes["static_transform_publisher"]["arguments"]
    assert words[0::2] == [
        *("--frame-id", "--child-frame-id"),
        *("--x", "--y", "--z", "--roll", "--pitch", "--yaw"),
    ]


def test_rviz_shows_published_topics_with_their_types():
    content = YAML(typ="safe").load(FOLDER / "bubbleviz.rviz")["Visualization Manager"]
    assert content["Global Options"]["Fixed Frame"] == "bubble"
    shown = {}
    for display in content["Displays"]:
        package, name = display["Class"].split("/")
        assert package == "rviz_default_plugins"
        if name != "TF":
            shown[display["Topic"]["Value"]] = SHOWN[name]
            assert display["Topic"]["Reliability Policy"] == "Reliable"
    assert shown.items() <= PUBLISHED.items()
    assert {f"{RESULTS}membrane", f"{RESULTS}contact_markers"} < shown.keys()
    (cloud,) = (each for each in content["Displays"] if each["Class"].endswith("PointCloud2"))
    assert cloud["Channel Name"] == "pressure"


def test_foxglove_shows_published_topics_and_plots_existing_fields():
    content = json.loads((FOLDER / "bubbleviz.foxglove.json").read_text())
    panels = content["configById"]
    assert set(panels) == set(panels_of(content["layout"]))
    view, plot = panels["3D!bubble"], panels["Plot!force"]
    assert view["followTf"] == "bubble"
    assert {PUBLISHED[topic] for topic in view["topics"]} <= set(SHOWN.values())
    assert view["topics"][f"{RESULTS}membrane"]["colorField"] == "pressure"
    assert PUBLISHED[panels["DiagnosticSummary!status"]["topicToRender"]] == DIAGNOSTICS
    for path in plot["paths"]:
        topic, *fields = path["value"].split(".")
        kind = PUBLISHED[topic]
        for field in fields:
            annotation = STORE.types[kind].__annotations__[field]
            kind = annotation.replace("__", "/")
        assert kind == "float"


def panels_of(layout):
    """Panels in a layout, whose parts are divided in two."""
    if isinstance(layout, str):
        return [layout]
    return [*panels_of(layout["first"]), *panels_of(layout["second"])]
