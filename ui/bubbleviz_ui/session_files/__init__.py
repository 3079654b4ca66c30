"""Session files: saving and restoring the state of the window."""
