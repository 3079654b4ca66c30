"""Solver thread of the window: requests from the model, results back to it."""
