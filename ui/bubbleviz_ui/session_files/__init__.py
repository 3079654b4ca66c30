"""The session in files: what of the window is kept, and how it comes back."""
