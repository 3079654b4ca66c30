"""What measures the window, and what judges methods; not installed."""
