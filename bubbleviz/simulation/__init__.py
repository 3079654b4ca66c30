"""Simulated sensors: presses with their truth, depth noise, scenes for live streams."""
