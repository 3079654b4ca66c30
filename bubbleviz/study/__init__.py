"""Error against run time, stability, independent oracles."""
