"""Import of images and other recordings."""
