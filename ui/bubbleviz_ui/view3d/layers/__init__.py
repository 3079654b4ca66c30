"""The 3-D layers, one a file: each draws one thing and is updated in place."""
