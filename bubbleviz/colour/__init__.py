"""What the colour camera sees: images decoded when asked for, and the motion in them."""
