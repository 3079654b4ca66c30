"""Benchmarks of the window: frame rate, start, seek, two cameras, and monkey tests."""
