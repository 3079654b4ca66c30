"""The launch file and layouts of examples/ros2 against the topics that are published."""

import json
import runpy
import sys
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

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


@pytest.fixture
def ros(monkeypatch):
    """What the launch file calls of ROS 2."""
    called = MagicMock()
    for module, names in {
        "launch": ("LaunchDescription",),
        "launch.actions": ("DeclareLaunchArgument", "SetEnvironmentVariable"),
        "launch.conditions": ("IfCondition",),
        "launch.substitutions": ("LaunchConfiguration",),
        "launch_ros": (),
        "launch_ros.actions": ("Node",),
    }.items():
        only = SimpleNamespace(**{name: getattr(called, name) for name in names})
        monkeypatch.setitem(sys.modules, module, only)
    names = runpy.run_path(str(FOLDER / "bubbleviz.launch.py"))
    names["generate_launch_description"]()
    return called


def first_of(calls):
    """First argument of each of them."""
    return {each.args[0] for each in calls.call_args_list}


def test_launch_file_starts_router_camera_pose_and_rviz(ros):
    nodes = {each.kwargs["executable"]: each.kwargs for each in ros.Node.call_args_list}
    assert nodes.keys() == {"rmw_zenohd", "static_transform_publisher", "rviz2"}
    option, config = nodes["rviz2"]["arguments"]
    assert option == "-d" and Path(config) == FOLDER / "bubbleviz.rviz"
    assert first_of(ros.LaunchConfiguration) == first_of(ros.DeclareLaunchArgument) != set()
    ros.SetEnvironmentVariable.assert_called_once_with("RMW_IMPLEMENTATION", "rmw_zenoh_cpp")
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
