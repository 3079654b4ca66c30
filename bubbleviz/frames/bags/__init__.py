"""Bags of messages with random access: rosbag2 (MCAP, SQLite) and ROS 1, on top of rosbags.

rosbags finds the topics and decodes messages; what it does not have is an index by message,
which is what the storages here add, so that opening a long recording decompresses no images.
"""

from bubbleviz.frames.bags.bag import Bag, Messages, Topic

__all__ = ["Bag", "Messages", "Topic"]
