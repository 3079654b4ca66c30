"""Defaults shared by the command line and the window; imports nothing, to start fast."""

SYNTHETIC_SENSOR = "pico_flexx_75mm"  # preset of the built-in live sensor, and of studies
TRUTH_SUFFIX = ".npz"  # of files that hold the truth behind a simulated recording
SESSION_SUFFIX = ".bubbleviz"  # of files that hold a session of the window
MOST_COLOUR_DELAY_S = 0.5
"""Largest difference between stamps of colour and depth of one moment; chosen: 15 frames."""
