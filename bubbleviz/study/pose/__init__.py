"""Pose: error against run time, other registrations, and a nut that turns."""
