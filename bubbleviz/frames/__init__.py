"""Frames of data: recordings and live sources in, recorder out."""
