"""Calibration panel: session, pages of the steps, results."""
