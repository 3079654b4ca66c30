"""What measures the window: pictures a second, start, seek, live soak, a monkey."""
