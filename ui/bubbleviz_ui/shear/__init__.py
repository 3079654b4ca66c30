"""What the colour camera tells: texture, traction, slip; its layers, panel and session."""
