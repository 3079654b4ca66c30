"""The calibration session of the window: what was chosen, what came of it, who computes it."""
