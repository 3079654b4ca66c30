"""The dock panels, one a file."""
