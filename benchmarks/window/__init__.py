"""Benchmarks of the window: frame rate, start, seek, live soak and monkey tests."""
