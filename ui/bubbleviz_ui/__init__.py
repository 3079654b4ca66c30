"""The window: shows results of `bubbleviz`; no numerics of its own."""
