"""The calibration panel, step by step, with its session and its answers."""
