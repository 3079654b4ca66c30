"""The window: draws what `bubbleviz` computed; no numerics of its own."""
