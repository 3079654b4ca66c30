"""What is meant where nothing is named; imports nothing, as the command line does at its start."""

SYNTHETIC_SENSOR = "pico_flexx_75mm"
"""Preset of the built-in live sensor, and of studies."""
TRUTH_SUFFIX = ".npz"
"""Of files that hold the truth behind a simulated recording."""
SESSION_SUFFIX = ".bubbleviz"
"""Of files that hold a session of the window."""
