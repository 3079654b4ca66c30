"""Error against run time, numerical stability, speed and pose: studies of one harness."""
