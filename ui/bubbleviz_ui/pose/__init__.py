"""Pose panel: object, initial pose, registration and tracking."""
