"""RViz2 with the results of `bubbleviz watch`, over Zenoh.

    ros2 launch examples/ros2/bubbleviz.launch.py mount:=tool0 camera:=camera_link z:=0.05
    bubbleviz watch --source zenoh: --sensor mine.toml --connect tcp/127.0.0.1:7447

`watch` places the frame `bubble` in that of the depth images; x, y, z, roll, pitch, yaw place the
camera at its mount on the robot. Where the robot's own router is used, `router:=false` after
`export ZENOH_CONFIG_OVERRIDE='mode="client";connect/endpoints=["tcp/ROBOT:7447"]'`.
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

POSE = dict.fromkeys(("x", "y", "z", "roll", "pitch", "yaw"), "0.0")
ARGUMENTS = {"router": "true", "mount": "tool0", "camera": "camera_link", **POSE}


def generate_launch_description() -> LaunchDescription:
    """Router, pose of the camera, and RViz."""
    place = {"frame-id": "mount", "child-frame-id": "camera", **{name: name for name in POSE}}
    options = [[f"--{option}", LaunchConfiguration(name)] for option, name in place.items()]
    config = Path(__file__).with_name("bubbleviz.rviz")
    return LaunchDescription(
        [
            *(DeclareLaunchArgument(name, default_value=told) for name, told in ARGUMENTS.items()),
            SetEnvironmentVariable("RMW_IMPLEMENTATION", "rmw_zenoh_cpp"),
            Node(
                package="rmw_zenoh_cpp",
                executable="rmw_zenohd",
                condition=IfCondition(LaunchConfiguration("router")),
            ),
            Node(
                package="tf2_ros",
                executable="static_transform_publisher",
                arguments=[word for option in options for word in option],
            ),
            Node(package="rviz2", executable="rviz2", arguments=["-d", str(config)]),
        ]
    )
