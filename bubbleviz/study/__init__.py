"""Studies of error against run time, numerical stability, speed and pose, on one harness."""
