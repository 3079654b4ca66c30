"""Diagnostics of one frame: images, probe, threshold, comparison."""
