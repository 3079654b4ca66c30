"""Calibration: pixels to trust, reference surface, tension, chamber, and the sensor file."""
