"""Where live messages and results go: a recording, ROS 2 messages, Zenoh."""
