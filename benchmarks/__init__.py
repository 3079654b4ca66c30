"""Benchmarks of the window and of methods; not installed."""
